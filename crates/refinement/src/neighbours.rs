//! Nearest neighbours: a static kd-tree, a voxel map that grows, reduction by voxels, normals.

mod kd_tree;
mod normals;
mod reduce;
mod voxel_map;

pub use kd_tree::{KdTree, Neighbour};
pub use normals::{LocalSurface, local_surfaces};
pub use reduce::{VoxelRepresentative, reduce, reduce_indices};
pub use voxel_map::VoxelMap;
