//! Refinement of trajectories: nearest neighbours and continuous-time optimisation.
//!
//! Nothing here knows of files. Points are `f32` metres, poses `f64`.

pub mod continuous;
mod error;
mod moments;
pub mod neighbours;
mod point_store;
pub mod registration;
pub mod semi_rigid;
mod sharpness;

pub use error::RefineError;
pub use moments::{Moments, PlaneFit};
pub use point_store::{LeftOutPoints, PointStore, StoredPoint};
pub use sharpness::{Sharpness, SharpnessOptions, sharpness, spread_sample};
