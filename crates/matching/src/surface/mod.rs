//! Surfaces as planes in voxels of several sizes, and matching scans to them.
//!
//! Hybrid grids know where space is occupied to about a cell. Where surfaces are flat, the mean and the
//! normal of all hits in a voxel tell where the surface is to a few millimetres. A scan is matched by the
//! distances of its points from these planes (point-to-plane ICP of Chen and Medioni 1992, with the
//! voxels of sizes that halve until what they hold is flat as in Yuan et al., "Efficient and Probabilistic
//! Adaptive Voxel Mapping for Accurate Online LiDAR Odometry", 2022, equations 5 and 8). A sweep, which takes
//! time, is matched together with the way on which it was measured (`way`).

mod bootstrap;
mod cell;
mod leveling;
mod map;
mod matcher;
mod posts;
mod way;

pub use bootstrap::align_coarsely;
pub use leveling::up_direction;
pub use map::{Doubt, Plane, SurfaceMap};
pub use matcher::{
    PosePrior, Sigmas, SurfaceMatch, SurfaceMatcher, SurfaceMatcherOptions, SweptPoint, WayPrior,
    WeakDirections,
};
pub use posts::{PostMap, PostPoint};
pub use way::{Going, StraightPieces, Way, WayCorrection};
