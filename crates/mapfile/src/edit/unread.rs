//! Keeps the parts of pose graph and options of a file that are not edited as bytes, so that fields of other
//! programs survive.

use std::path::Path;

use portolan_pbstream::MessageKind;
use portolan_pbstream::PbstreamError;
use portolan_pbstream::wire::{
    Fields, WireValue, joined, last_varint, put_bytes_field, put_varint_field, without_field,
};
use portolan_pbstream::{PbstreamReader, ReadLimits};

/// Field numbers of the schema.
const CONSTRAINTS_TRAJECTORIES_LANDMARKS: [u32; 3] = [2, 4, 5];
const OPTIONS_WITH_SENSOR_IDS: u32 = 1;
const PORTOLAN_CONFIGURATION: u32 = 1000;
const TRAJECTORY_BUILDER_OPTIONS: u32 = 2;
const INITIAL_TRAJECTORY_POSE: u32 = 4;
const TO_TRAJECTORY_ID: u32 = 2;

/// Options and sensors of one trajectory, as bytes of the file.
#[derive(Clone, Debug, Default)]
pub(super) struct TrajectoryOptions(Vec<u8>);

impl TrajectoryOptions {
    /// Number of the trajectory that the start is relative to.
    pub fn start_relative_to(&self) -> Option<i32> {
        let builder = joined(&self.0, TRAJECTORY_BUILDER_OPTIONS);
        let has_start = Fields::new(&builder).any(|f| matches!(f, Ok((INITIAL_TRAJECTORY_POSE, _))));
        // Numbers are int32: the low half of the varint.
        has_start.then(|| last_varint(&joined(&builder, INITIAL_TRAJECTORY_POSE), TO_TRAJECTORY_ID) as i32)
    }

    /// Makes the start relative to another trajectory; none removes the start.
    pub fn set_start_relative_to(&mut self, trajectory_id: Option<i32>) {
        let builder = joined(&self.0, TRAJECTORY_BUILDER_OPTIONS);
        let mut new = without_field(&builder, INITIAL_TRAJECTORY_POSE);
        if let Some(id) = trajectory_id {
            let mut start = without_field(&joined(&builder, INITIAL_TRAJECTORY_POSE), TO_TRAJECTORY_ID);
            put_varint_field(&mut start, TO_TRAJECTORY_ID, id.cast_unsigned().into());
            put_bytes_field(&mut new, INITIAL_TRAJECTORY_POSE, &start);
        }
        self.0 = without_field(&self.0, TRAJECTORY_BUILDER_OPTIONS);
        put_bytes_field(&mut self.0, TRAJECTORY_BUILDER_OPTIONS, &new);
    }
}

/// The messages of pose graph and options without the parts that the draft holds.
#[derive(Clone, Debug, Default)]
pub(super) struct Unread {
    in_pose_graph: Vec<u8>,
    in_options: Vec<u8>,
    beside_pose_graph: Vec<u8>,
    beside_options: Vec<u8>,
}

impl Unread {
    /// Reads them from a file, with the options of its trajectories in their order.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn read(path: &Path, limits: ReadLimits) -> Result<(Self, Vec<TrajectoryOptions>), PbstreamError> {
        let (mut unread, mut all) = (Self::default(), Vec::new());
        let (graph_tag, options_tag) = (MessageKind::PoseGraph.tag(), MessageKind::Options.tag());
        let mut reader = PbstreamReader::open_with(path, limits)?;
        while let Some(raw) = reader.next_message()? {
            match raw.kind() {
                MessageKind::Header => {}
                MessageKind::PoseGraph => {
                    let graph = joined(&raw.bytes, graph_tag);
                    unread.in_pose_graph = CONSTRAINTS_TRAJECTORIES_LANDMARKS
                        .iter()
                        .fold(graph, |rest, number| without_field(&rest, *number));
                    unread.beside_pose_graph = without_field(&raw.bytes, graph_tag);
                }
                MessageKind::Options => {
                    let options = joined(&raw.bytes, options_tag);
                    for field in Fields::new(&options).map_while(Result::ok) {
                        if let (OPTIONS_WITH_SENSOR_IDS, WireValue::Bytes(bytes)) = field {
                            all.push(TrajectoryOptions(bytes.to_vec()));
                        }
                    }
                    let rest = without_field(&options, OPTIONS_WITH_SENSOR_IDS);
                    unread.in_options = without_field(&rest, PORTOLAN_CONFIGURATION);
                    unread.beside_options = without_field(&raw.bytes, options_tag);
                    break;
                }
                _ => break,
            }
        }
        Ok((unread, all))
    }

    /// The message of a pose graph.
    pub fn pose_graph_message(&self, mut graph: Vec<u8>) -> Vec<u8> {
        graph.extend_from_slice(&self.in_pose_graph);
        message(MessageKind::PoseGraph, &graph, &self.beside_pose_graph)
    }

    /// The message of the options, with the configuration of the map as JSON (or empty).
    pub fn options_message(&self, options: &[TrajectoryOptions], configuration: &str) -> Vec<u8> {
        let mut content = Vec::new();
        for TrajectoryOptions(bytes) in options {
            put_bytes_field(&mut content, OPTIONS_WITH_SENSOR_IDS, bytes);
        }
        content.extend_from_slice(&self.in_options);
        if !configuration.is_empty() {
            put_bytes_field(&mut content, PORTOLAN_CONFIGURATION, configuration.as_bytes());
        }
        message(MessageKind::Options, &content, &self.beside_options)
    }
}

fn message(kind: MessageKind, content: &[u8], beside: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(content.len() + beside.len() + 12);
    put_bytes_field(&mut bytes, kind.tag(), content);
    bytes.extend_from_slice(beside);
    bytes
}
