#![doc = include_str!("../README.md")]

mod closed_forms;
mod dense_index;
mod kd_tree;
mod moments;
mod normals;
mod pair_moments;
mod reduce;
mod sharpness;
mod voxel_hash;
mod voxel_map;

pub use closed_forms::{ClosedForm, best_transform, helical_motion};
pub use dense_index::DenseIndex;
pub use kd_tree::{KdTree, Neighbour};
pub use moments::{Moments, PlaneFit};
pub use normals::{LocalSurface, local_surface, local_surfaces};
pub use pair_moments::PairMoments;
pub use reduce::{VoxelRepresentative, reduce, reduce_indices};
pub use sharpness::{Neighbourhood, Sharpness, SharpnessOptions, ThinnedCloud, sharpness, spread_sample};
pub use voxel_hash::{VoxelHash, VoxelKey};
pub use voxel_map::VoxelMap;
