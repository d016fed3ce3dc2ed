#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod convert;
mod derived_imu;
mod edit;
mod georeference;
mod info;
mod info_text;
mod load_textures;
mod mend;
mod mend_graph;
mod migrate;
mod packed_texture;
mod paint;
mod repair;
mod resample;
mod ros_map;
mod salvage;
mod texture;
mod texture_3d;
mod written;

pub use convert::{
    FileWork, FrozenTrajectories, LoadedMap, LoadedTrajectories, MapConversionError, MapFileSpace,
    MapLoadSettings, WriteReport, builder_options_from_proto, builder_options_to_proto, check_graph,
    encode_grid_2d, encode_hybrid_grid, load_map, read_map, read_map_2d, submap_textures_2d,
    submap_textures_3d, trajectory_options_from_proto, trajectory_options_to_proto, write_graph, write_map,
    write_map_2d,
};
pub use edit::{
    EditError, EditReport, FoundLoop, JoinedMap, LoopResidual, LoopWeights, MapDraft, MapOptimization,
    PoseReplacement, Walls, find_walls,
};
pub use georeference::Georeference;
pub use info::{ConstraintCounts, Extent, GridInfo, MapInfo, SensorInfo, TrajectoryInfo, info};
pub use load_textures::{MapTextures, load_textures, submap_texture};
pub use migrate::{MigrateError, MigrateOptions, MigrateReport, migrate};
pub use packed_texture::PackedTexture;
pub use paint::{
    EvidenceMap, MapArea, PaintError, PaintOptions, PaintedMap, PlacedTexture, paint, sum_evidence,
};
pub use repair::{Repair, RepairError, RepairReport, repair};
pub use ros_map::{ImageName, is_ros_map_yaml_of, ros_map_yaml, write_pgm, write_ros_map};
pub use texture::{MAX_TEXTURE_PIXELS, SubmapTexture, TextureError, texture_2d};
pub use texture_3d::{texture_3d, xray_texture};
