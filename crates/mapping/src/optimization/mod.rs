//! The optimisation problem: what it knows, and its 2D form.

mod data;
mod interpolation;
mod two_d;

pub use data::{
    LandmarkNode, LandmarkSighting, OptimizationData, OptimizationNode, OptimizationSummary,
    TrajectorySensors,
};
pub use two_d::optimize_2d;
