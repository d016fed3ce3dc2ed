//! Reads a map: the header, the pose graph and the options at once, all other messages one by one.

use std::io::Read;
use std::path::Path;

use crate::error::PbstreamError;
use crate::frames::FrameReader;
use crate::message::Message;
use crate::proto::mapping::serialized_data::Data;
use crate::proto::mapping::{AllTrajectoryBuilderOptions, PoseGraph, SerializationHeader};
use crate::reader::{DECODE, DECODE_SUMMARY, Decoded, ReadLimits, Records, Step, open_frames};

/// Numbers of messages that were skipped while reading, because they cannot be used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct IgnoredMessages {
    /// A second pose graph.
    pub pose_graphs: u64,
    /// A second set of options.
    pub options: u64,
    /// Messages of unknown kinds.
    pub unknown: u64,
}

/// Reads a map in the order of the format: header, pose graph and options are available after opening, the
/// other messages follow one by one. They are decoded ahead on all cores.
pub struct MapReader {
    header: SerializationHeader,
    pose_graph: PoseGraph,
    options: AllTrajectoryBuilderOptions,
    records: Records<Decoded>,
    ignored: IgnoredMessages,
}

/// One message of a map after the first three.
#[derive(Clone, Debug, PartialEq)]
pub struct MapMessage {
    /// Number of the record; the header is 0.
    pub index: u64,
    /// Position of the record in the file.
    pub offset: u64,
    /// Size of the uncompressed message, bytes.
    pub size: usize,
    /// Number of cells of a 2D grid that were counted but not decoded; see [`MapReader::open_for_summary`].
    pub cells: u64,
    /// The content; never a pose graph or options.
    pub data: Data,
}

impl MapReader {
    /// Opens a map with the default limits.
    ///
    /// If the file is not a pbstream, has an unknown version or is damaged, or if pose graph or options are
    /// missing, out of order or not for the same number of trajectories.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, PbstreamError> {
        Self::open_with(path, ReadLimits::default())
    }

    /// Opens a map.
    ///
    /// # Errors
    /// As for [`MapReader::open`].
    pub fn open_with(path: impl AsRef<Path>, limits: ReadLimits) -> Result<Self, PbstreamError> {
        Self::start(open_frames(path.as_ref(), limits)?, limits, DECODE)
    }

    /// Opens a map for a summary with little memory: submaps have no cells in their 2D grids, nodes have no
    /// content.
    ///
    /// # Errors
    /// As for [`MapReader::open`].
    pub fn open_for_summary(path: impl AsRef<Path>, limits: ReadLimits) -> Result<Self, PbstreamError> {
        Self::start(open_frames(path.as_ref(), limits)?, limits, DECODE_SUMMARY)
    }

    /// Reads from any source; `length` is its whole length in bytes if it is known.
    ///
    /// # Errors
    /// As for [`MapReader::open`].
    pub fn from_source(
        source: impl Read + Send + 'static,
        length: Option<u64>,
        limits: ReadLimits,
    ) -> Result<Self, PbstreamError> {
        Self::start(FrameReader::new(Box::new(source), length, limits.max_compressed_bytes)?, limits, DECODE)
    }

    /// Reads from any source for a summary, as [`MapReader::open_for_summary`].
    ///
    /// # Errors
    /// As for [`MapReader::open`].
    pub fn from_source_for_summary(
        source: impl Read + Send + 'static,
        length: Option<u64>,
        limits: ReadLimits,
    ) -> Result<Self, PbstreamError> {
        let frames = FrameReader::new(Box::new(source), length, limits.max_compressed_bytes)?;
        Self::start(frames, limits, DECODE_SUMMARY)
    }

    fn start(frames: FrameReader, limits: ReadLimits, step: Step<Decoded>) -> Result<Self, PbstreamError> {
        let mut records = Records::new(frames, limits, step);
        let header = match records.next_record()?.map(|decoded| decoded.message) {
            Some(Message::Header(header)) => header,
            _ => return Err(PbstreamError::MissingHeader),
        };
        check_version(&header)?;
        let pose_graph = match records.next_record()?.map(|decoded| decoded.message) {
            Some(Message::Data(data)) => match *data {
                Data::PoseGraph(pose_graph) => pose_graph,
                other => {
                    return Err(PbstreamError::PoseGraphOrder { tag: crate::message::kind_of(&other).tag() });
                }
            },
            Some(other) => return Err(PbstreamError::PoseGraphOrder { tag: other.kind().tag() }),
            None => return Err(PbstreamError::MissingPoseGraph),
        };
        let options = match records.next_record()?.map(|decoded| decoded.message) {
            Some(Message::Data(data)) => match *data {
                Data::AllTrajectoryBuilderOptions(options) => options,
                other => {
                    return Err(PbstreamError::OptionsOrder { tag: crate::message::kind_of(&other).tag() });
                }
            },
            Some(other) => return Err(PbstreamError::OptionsOrder { tag: other.kind().tag() }),
            None => return Err(PbstreamError::MissingOptions),
        };
        let counts = (options.options_with_sensor_ids.len(), pose_graph.trajectory.len());
        if counts.0 != counts.1 {
            return Err(PbstreamError::OptionsCount { options: counts.0, trajectories: counts.1 });
        }
        Ok(Self { header, pose_graph, options, records, ignored: IgnoredMessages::default() })
    }

    /// The first message.
    pub fn header(&self) -> &SerializationHeader {
        &self.header
    }

    /// The second message: global poses and constraints.
    pub fn pose_graph(&self) -> &PoseGraph {
        &self.pose_graph
    }

    /// Takes the pose graph out of the reader, which has an empty one afterwards.
    pub fn take_pose_graph(&mut self) -> PoseGraph {
        std::mem::take(&mut self.pose_graph)
    }

    /// The third message: one entry for each trajectory of the pose graph, in its order.
    pub fn options(&self) -> &AllTrajectoryBuilderOptions {
        &self.options
    }

    /// The configuration that the map was made with, as JSON; empty unless Portolan made it.
    pub fn configuration(&self) -> &str {
        let in_options = &self.options.portolan_configuration;
        if in_options.is_empty() { &self.header.portolan_configuration } else { in_options }
    }

    /// The next message after the first three, or none at the end. Further pose graphs, options and unknown
    /// kinds are skipped and counted in [`MapReader::ignored`].
    ///
    /// # Errors
    /// If the source cannot be read, or the next message is damaged or larger than the limits.
    pub fn next_message(&mut self) -> Result<Option<MapMessage>, PbstreamError> {
        while let Some(Decoded { index, offset, size, cells, message }) = self.records.next_record()? {
            match message {
                Message::Data(data) => match *data {
                    Data::PoseGraph(_) => {
                        self.ignored.pose_graphs += 1;
                        tracing::warn!(
                            index,
                            "Found multiple serialized `PoseGraph`. Serialized stream \
                                               likely corrupt! Keeping the first one."
                        );
                    }
                    Data::AllTrajectoryBuilderOptions(_) => {
                        self.ignored.options += 1;
                        tracing::warn!(
                            index,
                            "Found multiple serialized `AllTrajectoryBuilderOptions`. \
                                               Serialized stream likely corrupt! Keeping the first ones."
                        );
                    }
                    data => return Ok(Some(MapMessage { index, offset, size, cells, data })),
                },
                Message::Unknown(tag) => {
                    self.ignored.unknown += 1;
                    tracing::warn!(index, "Skipping unknown message type in stream: field tag {tag}");
                }
                Message::Header(_) => {}
            }
        }
        Ok(None)
    }

    /// Numbers of messages that were skipped so far.
    pub fn ignored(&self) -> IgnoredMessages {
        self.ignored
    }

    /// Bytes read from the file so far, including messages that were read ahead; for progress.
    pub fn bytes_read(&self) -> u64 {
        self.records.bytes_read()
    }

    /// The length of the file, if known.
    pub fn length(&self) -> Option<u64> {
        self.records.length()
    }
}

/// Rejects all versions except 1 and 2.
pub(crate) fn check_version(header: &SerializationHeader) -> Result<(), PbstreamError> {
    match header.format_version {
        1 | 2 => Ok(()),
        version => Err(PbstreamError::Version { version }),
    }
}
