#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod check;
mod check_data;
mod check_graph;
pub mod codes;
mod decoded_size;
mod error;
mod exact_numbers;
mod frames;
mod grid_check;
mod gzip;
mod map_reader;
mod message;
mod ordered;
mod point_cloud;
mod pose;
pub mod proto;
mod reader;
mod text_format;
pub mod wire;
mod writer;

pub use check::{Finding, FindingKind, Severity, bad_starts, start_of, validate, validate_pose_graph};
pub use codes::{
    CodeRange, MAX_CODE, MAX_CORRESPONDENCE_COST, MAX_PROBABILITY, MIN_CORRESPONDENCE_COST, MIN_PROBABILITY,
    correspondence_cost_bounds, log_odds_byte,
};
pub use error::{PbstreamError, RecordError};
pub use frames::MAGIC;
pub use grid_check::{GridReport, check_grid_2d, check_hybrid_grid, mend_grid_2d, mend_hybrid_grid};
pub use gzip::{GzipError, gunzip, gzip};
pub use map_reader::{IgnoredMessages, MapMessage, MapReader};
pub use message::{Message, MessageKind, RawMessage, decode_data, kind_of};
pub use point_cloud::{PointCloudError, compress as compress_points, decompress as decompress_points};
pub use pose::{IdInFile, is_rotation, node_id, pose_from_proto, pose_to_proto, submap_id, submap_poses};
pub use reader::{PbstreamReader, ReadLimits, must_be_a_file};
pub use text_format::{mapping_to_text, message_to_text, pose_graph_to_text};
pub use writer::{FORMAT_VERSION, PbstreamWriter};
