//! Relations: known motions between two times (Kümmerle et al., "On measuring the accuracy of SLAM
//! algorithms", 2009).

mod binary;
mod generate;
mod loop_closures;
mod metrics;
mod text;
mod time_base;

pub use binary::{read_binary_relations, write_binary_relations};
pub use generate::{
    GenerateOptions, GeneratedRelations, IdInMap, MapConstraint, MapGraph, generate_relations,
};
pub use loop_closures::{RIGHT_WITHIN, at_times_of, loop_closure_relations};
pub use metrics::{RelationError, RelationReport, relation_errors};
pub use text::{read_text_relations, write_text_relations};
pub use time_base::{TimeBaseNotice, in_time_base};

use portolan_geometry::{Rigid3, Time};

use crate::EvaluationError;

/// Known motion between two times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relation {
    /// The earlier time, usually.
    pub time1: Time,
    /// The other time.
    pub time2: Time,
    /// Tracking frame at `time2` seen from that at `time1`.
    pub expected_1_from_2: Rigid3,
    /// Path length along the trajectory between the two times, metres; zero if unknown.
    pub covered_distance: f64,
}

/// Reads relations from the bytes of a file. A file that consists of ASCII alone is text, any other is
/// binary.
///
/// # Errors
/// If the bytes are damaged, or of another format.
pub fn read_relations(bytes: &[u8]) -> Result<Vec<Relation>, EvaluationError> {
    // A binary file of relations contains time stamps, whose bytes are not ASCII.
    if bytes.is_ascii() { read_text_relations(bytes) } else { read_binary_relations(bytes) }
}
