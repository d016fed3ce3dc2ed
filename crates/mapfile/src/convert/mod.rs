//! Converts between map files and maps in memory (`formats.md` §2.1, §2.2, §4).
//!
//! 2D and 3D share one writer and one reader ([`MapFileSpace`]); only the content of submaps differs.

mod error;
mod grid;
mod hybrid_grid;
mod option_message;
// One message has a deprecated field, which is read but not written.
#[allow(deprecated)]
mod option_tables;
mod planes;
mod pose_graph;
mod read;
mod sensors;
mod textures;
mod trajectory_options;
mod values;
mod work;
mod write;

pub use error::MapConversionError;
pub use grid::{MapFileSpace, encode_grid_2d};
pub use hybrid_grid::encode_hybrid_grid;
pub(crate) use read::node_data;
pub use read::{
    FrozenTrajectories, LoadedMap, LoadedTrajectories, MapLoadSettings, load_map, read_map, read_map_2d,
};
pub(crate) use sensors::{imu_from_proto, imu_state_from_proto};
pub use textures::{submap_textures_2d, submap_textures_3d};
pub use trajectory_options::{
    builder_options_from_proto, builder_options_to_proto, trajectory_options_from_proto,
    trajectory_options_to_proto,
};
pub use work::FileWork;
pub use write::{WriteReport, check_graph, write_graph, write_map, write_map_2d};
