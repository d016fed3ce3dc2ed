//! The optimisation problem: what it knows, and its forms in 2D and in 3D.

mod data;
mod fixes;
mod graph_problem;
mod imu_bias;
mod three_d;
mod two_d;

pub use data::{
    ImuState, LandmarkNode, LandmarkSighting, OptimizationData, OptimizationNode, OptimizationSummary,
    TrajectorySensors,
};
pub use three_d::optimize_3d;
pub use two_d::optimize_2d;
