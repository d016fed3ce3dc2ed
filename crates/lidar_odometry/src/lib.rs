#![doc = include_str!("../README.md")]

mod bootstrap;
mod cell;
mod leveling;
mod map;
mod matcher;
mod posts;
#[cfg(test)]
mod testing;
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
