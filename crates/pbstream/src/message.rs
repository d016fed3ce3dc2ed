//! One message of a map: its bytes, its kind, its content.

use prost::Message as _;

use crate::decoded_size::{MAX_DECODED_BYTES, decoded_size};
use crate::error::RecordError;
use crate::proto::mapping::serialized_data::Data;
use crate::proto::mapping::{SerializationHeader, SerializedData};
use crate::wire::Fields;

/// One message as bytes. This layer below the decoded messages keeps everything that is unknown here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawMessage {
    /// Number of the record; the header is 0.
    pub index: u64,
    /// Position of the record in the file.
    pub offset: u64,
    /// The serialised message, uncompressed.
    pub bytes: Vec<u8>,
}

/// A decoded message.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// The first message of a file.
    Header(SerializationHeader),
    /// A message of a known kind.
    Data(Box<Data>),
    /// A message of an unknown kind; the number is its field tag, 0 if the message is empty.
    Unknown(u32),
}

/// Kind of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MessageKind {
    /// The first message of a file.
    Header,
    /// Poses and constraints.
    PoseGraph,
    /// Options of all trajectories.
    Options,
    /// A submap with its grids.
    Submap,
    /// A node with its point clouds.
    Node,
    /// Estimates for a trajectory.
    TrajectoryData,
    /// An IMU sample.
    ImuData,
    /// An odometry pose.
    OdometryData,
    /// A pose in a fixed frame.
    FixedFramePoseData,
    /// A landmark observation.
    LandmarkData,
    /// Another kind: the field tag, 0 if there is none.
    Unknown(u32),
}

impl MessageKind {
    /// The kind with this field tag in `SerializedData`.
    pub fn from_tag(tag: u32) -> Self {
        match tag {
            1 => Self::PoseGraph,
            2 => Self::Options,
            3 => Self::Submap,
            4 => Self::Node,
            5 => Self::TrajectoryData,
            6 => Self::ImuData,
            7 => Self::OdometryData,
            8 => Self::FixedFramePoseData,
            9 => Self::LandmarkData,
            other => Self::Unknown(other),
        }
    }

    /// The field tag in `SerializedData`; 0 for the header.
    pub fn tag(self) -> u32 {
        match self {
            Self::Header => 0,
            Self::PoseGraph => 1,
            Self::Options => 2,
            Self::Submap => 3,
            Self::Node => 4,
            Self::TrajectoryData => 5,
            Self::ImuData => 6,
            Self::OdometryData => 7,
            Self::FixedFramePoseData => 8,
            Self::LandmarkData => 9,
            Self::Unknown(tag) => tag,
        }
    }

    /// The name as tools print it: the name of the field.
    pub fn name(self) -> &'static str {
        match self {
            Self::Header => "header",
            Self::PoseGraph => "pose_graph",
            Self::Options => "all_trajectory_builder_options",
            Self::Submap => "submap",
            Self::Node => "node",
            Self::TrajectoryData => "trajectory_data",
            Self::ImuData => "imu_data",
            Self::OdometryData => "odometry_data",
            Self::FixedFramePoseData => "fixed_frame_pose_data",
            Self::LandmarkData => "landmark_data",
            Self::Unknown(_) => "unknown",
        }
    }
}

impl RawMessage {
    /// The kind of the message, without decoding it. If several kinds are present, the last known one counts,
    /// as in protobuf.
    pub fn kind(&self) -> MessageKind {
        if self.index == 0 {
            return MessageKind::Header;
        }
        let mut kind = MessageKind::Unknown(0);
        for (tag, _) in Fields::new(&self.bytes).map_while(Result::ok) {
            let found = MessageKind::from_tag(tag);
            if !matches!(found, MessageKind::Unknown(_)) || matches!(kind, MessageKind::Unknown(_)) {
                kind = found;
            }
        }
        kind
    }

    /// Decodes the message.
    ///
    /// # Errors
    /// If it is not a valid message, or would need far more memory than it has bytes.
    pub fn decode(&self) -> Result<Message, RecordError> {
        if self.index == 0 {
            return Ok(SerializationHeader::decode(&*self.bytes).map(Message::Header)?);
        }
        Ok(match decode_data(&self.bytes)? {
            Some(data) => Message::Data(Box::new(data)),
            None => Message::Unknown(self.kind().tag()),
        })
    }
}

/// Decodes any message except the header; none if its kind is unknown.
pub fn decode_data(bytes: &[u8]) -> Result<Option<Data>, RecordError> {
    let needed = decoded_size(bytes);
    if needed > MAX_DECODED_BYTES {
        return Err(RecordError::DecodedTooLarge { needed, limit: MAX_DECODED_BYTES });
    }
    Ok(SerializedData::decode(bytes)?.data)
}

impl Message {
    /// The kind of the message.
    pub fn kind(&self) -> MessageKind {
        match self {
            Self::Header(_) => MessageKind::Header,
            Self::Unknown(tag) => MessageKind::Unknown(*tag),
            Self::Data(data) => kind_of(data),
        }
    }
}

/// The kind of decoded data.
pub fn kind_of(data: &Data) -> MessageKind {
    match data {
        Data::PoseGraph(_) => MessageKind::PoseGraph,
        Data::AllTrajectoryBuilderOptions(_) => MessageKind::Options,
        Data::Submap(_) => MessageKind::Submap,
        Data::Node(_) => MessageKind::Node,
        Data::TrajectoryData(_) => MessageKind::TrajectoryData,
        Data::ImuData(_) => MessageKind::ImuData,
        Data::OdometryData(_) => MessageKind::OdometryData,
        Data::FixedFramePoseData(_) => MessageKind::FixedFramePoseData,
        Data::LandmarkData(_) => MessageKind::LandmarkData,
    }
}
