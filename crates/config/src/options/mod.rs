//! The options as plain structs; field names are the keys of the Lua files.

mod bridge;
mod constraint_builder;
mod local_2d;
mod local_3d;
mod map_builder;
mod optimization_problem;
mod portolan;
mod pose_extrapolator;
mod pose_graph;
mod scan_matching;
mod shared;
mod submaps_2d;
mod submaps_3d;
mod trajectory_builder;

pub use bridge::BridgeOptions;
pub use constraint_builder::ConstraintBuilderOptions;
pub use local_2d::TrajectoryBuilder2dOptions;
pub use local_3d::TrajectoryBuilder3dOptions;
pub use map_builder::{MapBuilderOptions, MapBuilderServerOptions};
pub use optimization_problem::OptimizationProblemOptions;
pub use portolan::PortolanOptions;
pub use pose_extrapolator::{
    ConstantVelocityPoseExtrapolatorOptions, ImuBasedPoseExtrapolatorOptions, PoseExtrapolatorOptions,
};
pub use pose_graph::{OverlappingSubmapsTrimmer2dOptions, PoseGraphOptions};
pub use scan_matching::{
    CeresScanMatcher2dOptions, CeresScanMatcher3dOptions, FastCorrelativeScanMatcher2dOptions,
    FastCorrelativeScanMatcher3dOptions, IntensityCostFunctionOptions, RealTimeCorrelativeScanMatcherOptions,
};
pub use shared::{AdaptiveVoxelFilterOptions, MotionFilterOptions, SolverOptions};
pub use submaps_2d::{
    GridOptions2d, GridType2d, NormalEstimation2dOptions, ProbabilityGridRangeDataInserter2dOptions,
    RangeDataInserter2dOptions, RangeDataInserterType2d, Submaps2dOptions, TsdfRangeDataInserter2dOptions,
};
pub use submaps_3d::{RangeDataInserter3dOptions, Submaps3dOptions};
pub use trajectory_builder::{PureLocalizationTrimmerOptions, TrajectoryBuilderOptions};

use crate::define::options;

options! {
    /// All options: the table that the Lua file of a robot returns.
    Options {
        /// Options common to all trajectories of a map.
        map_builder: MapBuilderOptions = MapBuilderOptions::default();
        /// One trajectory.
        trajectory_builder: TrajectoryBuilderOptions = TrajectoryBuilderOptions::default();
        /// Frames, sensors and live output; their keys are at the top level.
        bridge: BridgeOptions = BridgeOptions::default() => flattened;
        /// Options that only Portolan has.
        portolan: PortolanOptions = PortolanOptions::default() => optional;
    }
}

impl Options {
    /// The defaults for 2D mapping with one laser scanner.
    pub fn for_2d() -> Self {
        let mut options = Self::default();
        options.map_builder.use_trajectory_builder_2d = true;
        options.bridge.num_laser_scans = 1;
        options
    }

    /// The defaults for 3D mapping with one scanner that provides point clouds.
    pub fn for_3d() -> Self {
        let mut options = Self::default();
        options.map_builder.use_trajectory_builder_3d = true;
        options.bridge.num_point_clouds = 1;
        options
    }
}
