//! Maps as documents: pbstream files and their messages, pictures of submaps, ROS map export.

mod check;
mod check_data;
mod check_graph;
mod codes;
mod convert;
mod decoded_size;
mod derived_imu;
mod edit;
mod error;
mod exact_numbers;
mod frames;
mod grid_check;
mod gzip;
mod info;
mod info_text;
mod load_textures;
mod map_reader;
mod mend;
mod mend_graph;
mod message;
mod migrate;
mod ordered;
mod packed_texture;
mod paint;
mod point_cloud;
mod pose;
pub mod proto;
mod reader;
mod repair;
mod resample;
mod ros_map;
mod salvage;
mod text_format;
mod texture;
mod texture_3d;
mod wire;
mod writer;

pub use check::{Finding, FindingKind, Severity, validate};
pub use codes::{
    CodeRange, MAX_CODE, MAX_CORRESPONDENCE_COST, MAX_PROBABILITY, MIN_CORRESPONDENCE_COST, MIN_PROBABILITY,
    correspondence_cost_bounds, log_odds_byte,
};
pub use convert::{
    FrozenTrajectories, LoadedMap, LoadedTrajectories, MapConversionError, MapLoadSettings, MapSpace,
    WriteReport, builder_options_from_proto, builder_options_to_proto, encode_grid_2d, encode_hybrid_grid,
    load_map, read_map, read_map_2d, submap_textures_2d, submap_textures_3d, trajectory_options_from_proto,
    trajectory_options_to_proto, write_graph, write_map, write_map_2d,
};
pub use edit::{
    EditError, EditReport, FoundLoop, JoinedMap, LoopResidual, LoopWeights, MapDraft, MapOptimization,
    PoseReplacement, Walls, find_walls,
};
pub use error::{PbstreamError, RecordError};
pub use gzip::{GzipError, gunzip, gzip};
pub use info::{ConstraintCounts, Extent, GridInfo, MapInfo, SensorInfo, TrajectoryInfo, info};
pub use load_textures::{MapTextures, load_textures, submap_texture};
pub use map_reader::{IgnoredMessages, MapMessage, MapReader};
pub use message::{Message, MessageKind, RawMessage, kind_of};
pub use migrate::{MigrateError, MigrateOptions, MigrateReport, migrate};
pub use packed_texture::PackedTexture;
pub use paint::{
    EvidenceMap, MapArea, PaintError, PaintOptions, PaintedMap, PlacedTexture, paint, sum_evidence,
};
pub use point_cloud::{PointCloudError, compress as compress_points, decompress as decompress_points};
pub use pose::{IdInFile, node_id, pose_from_proto, pose_to_proto, submap_id, submap_poses};
pub use reader::{PbstreamReader, ReadLimits};
pub use repair::{Repair, RepairError, RepairReport, repair};
pub use ros_map::{ImageName, ros_map_yaml, write_pgm, write_ros_map};
pub use text_format::{message_to_text, pose_graph_to_text};
pub use texture::{MAX_TEXTURE_PIXELS, SubmapTexture, TextureError, texture_2d};
pub use texture_3d::{texture_3d, xray_texture};
pub use wire::{Fields, WireError, WireValue};
pub use writer::{FORMAT_VERSION, PbstreamWriter};
