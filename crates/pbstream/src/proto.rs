//! The protobuf messages of maps, generated from `proto/` (`spec: formats.md §3, §3a`).
//!
//! One module for each protobuf package: `cartographer.mapping.proto` is [`mapping`]. Field names, units and
//! frames are explained in the `.proto` files.

#[allow(missing_docs, deprecated, clippy::all, clippy::pedantic, rustdoc::all)]
mod generated {
    include!(concat!(env!("OUT_DIR"), "/messages.rs"));
}

pub use generated::cartographer::common::proto as common;
pub use generated::cartographer::ground_truth::proto as ground_truth;
pub use generated::cartographer::mapping::constraints::proto as constraints;
pub use generated::cartographer::mapping::optimization::proto as optimization;
pub use generated::cartographer::mapping::proto as mapping;
pub use generated::cartographer::mapping::scan_matching::proto as scan_matching;
pub use generated::cartographer::sensor::proto as sensor;

/// Vectors and poses.
pub mod transform {
    pub use super::generated::cartographer::transform::proto::*;
    pub use crate::exact_numbers::*;
}

/// The compiled schema as a serialised `FileDescriptorSet`.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
