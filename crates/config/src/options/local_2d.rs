//! `trajectory_builder_2d`: local SLAM in 2D.

use super::{
    AdaptiveVoxelFilterOptions, CeresScanMatcher2dOptions, MotionFilterOptions, PoseExtrapolatorOptions,
    RealTimeCorrelativeScanMatcherOptions, Submaps2dOptions,
};
use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// Local SLAM in 2D: from range data to scans inserted into submaps.
    TrajectoryBuilder2dOptions {
        /// Expect an IMU, for gravity and for the rotation between scans. Turn it off when there is none.
        use_imu_data: bool = true, "", Bounds::ANY;
        /// Returns nearer than this are dropped. Raise it when the scanner sees its own platform.
        min_range: f32 = 0.0, "m", Bounds::at_least(0.0);
        /// Returns farther than this count as free space only. Lower it when far returns are noisy.
        max_range: f32 = 30.0, "m", Bounds::above(0.0).or_infinite();
        /// Points below this height are dropped after levelling. Raise it when the scanner sees the floor.
        min_z: f32 = -0.8, "m", Bounds::ANY.or_infinite();
        /// Points above this height are dropped after levelling. Lower it when the scanner sees the ceiling.
        max_z: f32 = 2.0, "m", Bounds::ANY.or_infinite();
        /// Length of the free space that is inserted along rays that exceed `max_range`. Raise it to open
        /// wide halls, lower it when missing returns are not free space (black or glass surfaces).
        missing_data_ray_length: f32 = 5.0, "m", Bounds::at_least(0.0);
        /// Number of range messages accumulated to one scan. Raise it when a revolution of the scanner is
        /// split over several messages.
        num_accumulated_range_data: usize = 1, "messages", Bounds::at_least(1.0);
        /// Edge of the voxels of the first filter, which keeps one point in each. Raise it for speed with
        /// dense scanners.
        voxel_filter_size: f32 = 0.025, "m", Bounds::above(0.0);
        /// Thinning of the cloud used for scan matching.
        adaptive_voxel_filter: AdaptiveVoxelFilterOptions = AdaptiveVoxelFilterOptions::default();
        /// Thinning of the cloud for loop closures in older versions.
        loop_closure_adaptive_voxel_filter: AdaptiveVoxelFilterOptions =
            AdaptiveVoxelFilterOptions { max_length: 0.9, min_num_points: 100, max_range: 50.0 };
        /// Search a window around the prediction before refining. Turn it on without IMU or odometry, or
        /// with a slow scanner.
        use_online_correlative_scan_matching: bool = false, "", Bounds::ANY;
        /// The search around the prediction that `use_online_correlative_scan_matching` turns on.
        real_time_correlative_scan_matcher: RealTimeCorrelativeScanMatcherOptions =
            RealTimeCorrelativeScanMatcherOptions::default();
        /// The match of a scan with the submap, by least squares from the prediction or from the result of
        /// the search around it.
        ceres_scan_matcher: CeresScanMatcher2dOptions = CeresScanMatcher2dOptions::default();
        /// Which scans become nodes and are inserted into submaps.
        motion_filter: MotionFilterOptions = MotionFilterOptions::default();
        /// Time constant of the gravity filter of live pose output.
        imu_gravity_time_constant: f64 = 10.0, "s", Bounds::above(0.0);
        /// Prediction of poses between scan matches; `use_imu_based` must be off in 2D.
        pose_extrapolator: PoseExtrapolatorOptions = PoseExtrapolatorOptions::default();
        /// Submaps: number of scans, kind of grid, insertion of scans.
        submaps: Submaps2dOptions = Submaps2dOptions::default();
    }
}
