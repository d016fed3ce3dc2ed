//! Messages of recordings, independent of the container and of ROS 1 or ROS 2.
//!
//! Values are the same as in the message, including frames, units and NaN. Validation and conversion to
//! measurements in the tracking frame happen later.

use std::sync::Arc;

use portolan_geometry::Time;

/// Stamp and frame of a message.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Time of measurement.
    pub stamp: Time,
    /// Frame of its values (without a leading slash).
    pub frame_id: Arc<str>,
}

/// One message of a recording.
#[derive(Clone, Debug)]
pub struct RecordedMessage {
    /// Topic it was recorded on.
    pub topic: Arc<str>,
    /// Time of recording (not of measurement).
    pub log_time: Time,
    /// Its content.
    pub message: Message,
}

/// The types of messages that mapping uses.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// `sensor_msgs/LaserScan`.
    LaserScan(LaserScan),
    /// `sensor_msgs/MultiEchoLaserScan`.
    MultiEchoLaserScan(MultiEchoLaserScan),
    /// `sensor_msgs/PointCloud2`.
    PointCloud2(PointCloud2),
    /// `sensor_msgs/Imu`.
    Imu(Imu),
    /// `nav_msgs/Odometry`.
    Odometry(Odometry),
    /// `sensor_msgs/NavSatFix`.
    NavSatFix(NavSatFix),
    /// `tf2_msgs/TFMessage` (`is_static` from the topic: `/tf_static`).
    Tf(TfMessage),
    /// `geometry_msgs/PoseStamped`.
    PoseStamped(PoseStamped),
    /// `geometry_msgs/TransformStamped`: only written; readers list it as an unsupported type.
    TransformStamped(TransformStamped),
    /// `cartographer_ros_msgs/LandmarkList`.
    LandmarkList(LandmarkList),
    /// Packets as sent by a sensor. If `portolan-recording` opens a recording, it replaces them by the clouds
    /// and IMU samples that they contain.
    SensorPackets(SensorPackets),
    /// A type that is listed but not supported.
    Other {
        /// Its name, as `package/Type` (ROS 2's `/msg/` removed).
        type_name: Arc<str>,
        /// Size of the serialised message, bytes.
        bytes: usize,
    },
}

/// `sensor_msgs/LaserScan`: metres, radians, seconds. `R` is the reading of a beam: one range, or several.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // the fields are those of the ROS message
pub struct LaserScan<R = f32> {
    pub header: Header,
    pub angle_min: f32,
    pub angle_max: f32,
    pub angle_increment: f32,
    pub time_increment: f32,
    pub scan_time: f32,
    pub range_min: f32,
    pub range_max: f32,
    pub ranges: Vec<R>,
    pub intensities: Vec<R>,
}

/// `sensor_msgs/MultiEchoLaserScan`: like a laser scan with several ranges per beam.
pub type MultiEchoLaserScan = LaserScan<Vec<f32>>;

impl<R> LaserScan<R> {
    /// The same scan with other readings.
    pub fn with_readings<T>(&self, ranges: Vec<T>, intensities: Vec<T>) -> LaserScan<T> {
        LaserScan {
            header: self.header.clone(),
            angle_min: self.angle_min,
            angle_max: self.angle_max,
            angle_increment: self.angle_increment,
            time_increment: self.time_increment,
            scan_time: self.scan_time,
            range_min: self.range_min,
            range_max: self.range_max,
            ranges,
            intensities,
        }
    }
}

/// Type of one field of a point cloud; the discriminants are those of `sensor_msgs/PointField`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
#[repr(u8)]
pub enum FieldType {
    Int8 = 1,
    Uint8 = 2,
    Int16 = 3,
    Uint16 = 4,
    Int32 = 5,
    Uint32 = 6,
    Float32 = 7,
    Float64 = 8,
}

impl FieldType {
    /// Bytes of one value.
    pub fn size_bytes(self) -> usize {
        match self {
            Self::Int8 | Self::Uint8 => 1,
            Self::Int16 | Self::Uint16 => 2,
            Self::Int32 | Self::Uint32 | Self::Float32 => 4,
            Self::Float64 => 8,
        }
    }
}

/// One field of a point.
#[derive(Clone, Debug, PartialEq)]
pub struct PointField {
    /// `x`, `y`, `z`, `intensity`, `time`, …
    pub name: String,
    /// Offset from the start of a point, bytes.
    pub offset: u32,
    /// `None` for a code that the format does not define.
    pub field_type: Option<FieldType>,
    /// Number of elements.
    pub count: u32,
}

/// `sensor_msgs/PointCloud2` with its bytes unchanged.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // the fields are those of the ROS message
pub struct PointCloud2 {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub fields: Vec<PointField>,
    pub is_bigendian: bool,
    pub point_step: u32,
    pub row_step: u32,
    pub data: Vec<u8>,
    pub is_dense: bool,
}

/// `sensor_msgs/Imu`.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // the fields are those of the ROS message
pub struct Imu {
    pub header: Header,
    pub orientation_xyzw: [f64; 4],
    pub orientation_covariance: [f64; 9],
    pub angular_velocity: [f64; 3],
    pub angular_velocity_covariance: [f64; 9],
    pub linear_acceleration: [f64; 3],
    pub linear_acceleration_covariance: [f64; 9],
}

/// Position (metres) and quaternion (x, y, z, w) as in a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Metres.
    pub position: [f64; 3],
    /// x, y, z, w; not validated.
    pub orientation_xyzw: [f64; 4],
}

/// `nav_msgs/Odometry`.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    /// Stamp and the odometry frame.
    pub header: Header,
    /// Frame that the pose is of.
    pub child_frame_id: Arc<str>,
    /// Pose of the child frame in the odometry frame.
    pub pose: Pose,
    /// Row-major 6×6, as in the message.
    pub pose_covariance: Vec<f64>,
    /// Linear velocity, m/s.
    pub linear_velocity: [f64; 3],
    /// Angular velocity, rad/s.
    pub angular_velocity: [f64; 3],
    /// Row-major 6×6, as in the message.
    pub twist_covariance: Vec<f64>,
}

/// `sensor_msgs/NavSatFix`: degrees and metres.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs)] // the fields are those of the ROS message
pub struct NavSatFix {
    pub header: Header,
    /// Negative values mean that there is no fix.
    pub status: i8,
    pub service: u16,
    pub latitude_degrees: f64,
    pub longitude_degrees: f64,
    pub altitude: f64,
    pub position_covariance: [f64; 9],
    pub position_covariance_type: u8,
}

/// One transform of the tf tree.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformStamped {
    /// Stamp and parent frame.
    pub header: Header,
    /// Child frame.
    pub child_frame_id: Arc<str>,
    /// `parent_from_child`.
    pub transform: Pose,
}

/// `tf2_msgs/TFMessage`.
#[derive(Clone, Debug, PartialEq)]
pub struct TfMessage {
    /// Whether it came on `/tf_static`.
    pub is_static: bool,
    /// Its transforms.
    pub transforms: Vec<TransformStamped>,
}

/// `geometry_msgs/PoseStamped`.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseStamped {
    /// Stamp and frame.
    pub header: Header,
    /// Pose in that frame.
    pub pose: Pose,
}

/// One entry of `cartographer_ros_msgs/LandmarkList`.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkEntry {
    /// Id of the landmark.
    pub id: String,
    /// Pose of the landmark in the frame of the list.
    pub tracking_from_landmark: Pose,
    /// 1/m.
    pub translation_weight: f64,
    /// 1/rad.
    pub rotation_weight: f64,
}

/// `cartographer_ros_msgs/LandmarkList`.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkList {
    /// Stamp and frame.
    pub header: Header,
    /// The observed landmarks.
    pub landmarks: Vec<LandmarkEntry>,
}

/// Kind of packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketKind {
    /// `velodyne_msgs/VelodyneScan`.
    Velodyne,
    /// `ouster_ros/PacketMsg`: lidar or IMU.
    Ouster,
    /// `std_msgs/String` with the metadata of an Ouster (JSON).
    OusterMetadata,
}

impl PacketKind {
    /// The ROS type, as `package/Type`.
    pub fn type_name(self) -> &'static str {
        match self {
            Self::Velodyne => "velodyne_msgs/VelodyneScan",
            Self::Ouster => "ouster_ros/PacketMsg",
            Self::OusterMetadata => "std_msgs/String",
        }
    }
}

/// Packets as sent by a sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorPackets {
    /// Kind of packets.
    pub kind: PacketKind,
    /// Stamp and frame, if the message has them.
    pub header: Option<Header>,
    /// Time of arrival, if the message has it, and bytes of each packet.
    pub packets: Vec<(Option<Time>, Vec<u8>)>,
}

impl Message {
    /// The ROS type, as `package/Type`.
    pub fn type_name(&self) -> &str {
        match self {
            Self::LaserScan(_) => "sensor_msgs/LaserScan",
            Self::MultiEchoLaserScan(_) => "sensor_msgs/MultiEchoLaserScan",
            Self::PointCloud2(_) => "sensor_msgs/PointCloud2",
            Self::Imu(_) => "sensor_msgs/Imu",
            Self::Odometry(_) => "nav_msgs/Odometry",
            Self::NavSatFix(_) => "sensor_msgs/NavSatFix",
            Self::Tf(_) => "tf2_msgs/TFMessage",
            Self::PoseStamped(_) => "geometry_msgs/PoseStamped",
            Self::TransformStamped(_) => "geometry_msgs/TransformStamped",
            Self::LandmarkList(_) => "cartographer_ros_msgs/LandmarkList",
            Self::SensorPackets(m) => m.kind.type_name(),
            Self::Other { type_name, .. } => type_name,
        }
    }

    /// Stamp and frame, if the type has them.
    pub fn header(&self) -> Option<&Header> {
        match self {
            Self::LaserScan(m) => Some(&m.header),
            Self::MultiEchoLaserScan(m) => Some(&m.header),
            Self::PointCloud2(m) => Some(&m.header),
            Self::Imu(m) => Some(&m.header),
            Self::Odometry(m) => Some(&m.header),
            Self::NavSatFix(m) => Some(&m.header),
            Self::PoseStamped(m) => Some(&m.header),
            Self::TransformStamped(m) => Some(&m.header),
            Self::LandmarkList(m) => Some(&m.header),
            Self::SensorPackets(m) => m.header.as_ref(),
            Self::Tf(_) | Self::Other { .. } => None,
        }
    }
}
