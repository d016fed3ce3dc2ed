//! Reads and writes files of point clouds in batches, so that memory does not depend on their size.
//!
//! | format | reading | writing |
//! |---|---|---|
//! | PLY | ascii, binary of both byte orders | ascii, binary |
//! | PCD | ascii, binary, binary_compressed | ascii, binary, binary_compressed |
//! | XYZ, PTS, CSV and other text | columns by their header or number | with a header line |
//! | LAS, LAZ | all point formats | 1.4, formats 0 to 3 |
//! | E57 | all scans, placed by their poses | one scan |
//! | uos folders | `scan000.3d`, `.pose`, `.frames` | – |
//!
//! Points have a position in double precision (or single precision with an offset) and, if the file has them,
//! intensity, time and colour. Written files appear under their name when they are complete.
//!
//! ```
//! use portolan_pointcloud::{Attributes, PointCloud, WriteOptions, create, open};
//! # fn main() -> Result<(), portolan_pointcloud::CloudError> {
//! # let folder = tempfile::tempdir().unwrap();
//! let path = folder.path().join("map.ply");
//! let mut cloud = PointCloud::new(Attributes { intensity: true, ..Attributes::default() });
//! cloud.push([1.0, 2.0, 3.0], 0.5, 0.0, [0; 3]);
//! let mut writer = create(&path, cloud.attributes(), &WriteOptions::default())?;
//! writer.write(&cloud)?;
//! writer.finish()?;
//! let mut reader = open(&path)?;
//! let mut batch = PointCloud::default();
//! while reader.next_batch(&mut batch)? {
//!     assert_eq!(batch.position(0), [1.0, 2.0, 3.0]);
//! }
//! # Ok(())
//! # }
//! ```
#![cfg_attr(not(test), warn(clippy::indexing_slicing))]

mod caught;
mod cloud;
mod e57;
mod error;
mod fields;
mod format;
mod input;
mod las;
mod occupied;
mod output;
mod pcd;
mod ply;
mod ply_header;
mod thin;
mod uos;
mod xyz;

pub use caught::is_panic_caught;
pub use cloud::{Attributes, PointCloud, Positions};
pub use error::CloudError;
pub use fields::Scalar;
pub use format::{
    CloudFormat, CloudReader, CloudWriter, Encoding, Precision, WriteOptions, Written, create, open,
};
pub use occupied::OccupiedVoxels;
pub use ply_header::{PlyElement, PlyHeader, PlyHeaderError, PlyHeaderLines, PlyProperty, PlyStorage};
pub use thin::{CELLS_IN_MEMORY, ThinnedCloud, VoxelPoint, VoxelThinner};
pub use uos::{UosFolder, UosFrame, UosScan, uos_frames_text, uos_pose_text};

/// Maximum number of points of a batch.
pub const BATCH_POINTS: usize = 1 << 16;
