#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod connectivity;
mod constraint;
mod data;
mod degeneracy;
mod fixes;
mod graph_problem;
mod id;
mod imu_bias;
mod policy;
mod remembered;
mod three_d;
mod two_d;

pub use connectivity::TrajectoryConnectivity;
pub use constraint::{Constraint, ConstraintTag, OpenShift};
pub use data::{
    FixedFrameOrigin, ImuState, LandmarkNode, LandmarkSighting, OptimizationData, OptimizationNode,
    OptimizationSummary, TrajectorySensors,
};
pub use fixes::unused_fixes;
pub use id::{IndexedId, NodeId, SubmapId, TrajectoryId, of_trajectory};
pub use policy::SensorPolicy;
pub use remembered::remembered_optimum;
pub use three_d::optimize_3d;
pub use two_d::optimize_2d;
