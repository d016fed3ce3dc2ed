//! Refinement of trajectories: nearest neighbours and continuous-time optimisation.
//!
//! Nothing here knows of files. Points are `f32` metres, poses `f64`.

mod moments;
pub mod neighbours;

pub use moments::{Moments, PlaneFit};
