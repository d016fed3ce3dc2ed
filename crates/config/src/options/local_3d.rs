//! `trajectory_builder_3d`: local SLAM in 3D.

use super::{
    AdaptiveVoxelFilterOptions, CeresScanMatcher3dOptions, MotionFilterOptions, PoseExtrapolatorOptions,
    RealTimeCorrelativeScanMatcherOptions, Submaps3dOptions,
};
use crate::bounds::Bounds;
use crate::define::options;

/// Value of `MAX_3D_RANGE` in the shipped files, metres.
const MAX_3D_RANGE: f32 = 60.0;

options! {
    /// Local SLAM in 3D: from range data to scans inserted into submaps.
    TrajectoryBuilder3dOptions {
        /// Returns nearer than this are dropped. Raise it when the scanner sees its own platform.
        min_range: f32 = 1.0, "m", Bounds::at_least(0.0);
        /// Returns farther than this are dropped. Raise it for scanners with a longer range outdoors.
        max_range: f32 = MAX_3D_RANGE, "m", Bounds::above(0.0).or_infinite();
        /// Number of range messages accumulated to one scan. Raise it when a revolution of the scanner is
        /// split over several messages.
        num_accumulated_range_data: usize = 1, "messages", Bounds::at_least(1.0);
        /// Edge of the voxels in which one point is kept: half of it for each message, all of it for the
        /// accumulated scan. Raise it for speed.
        voxel_filter_size: f32 = 0.15, "m", Bounds::above(0.0);
        /// Thinning of the cloud matched against the high-resolution grid.
        high_resolution_adaptive_voxel_filter: AdaptiveVoxelFilterOptions =
            AdaptiveVoxelFilterOptions { max_length: 2.0, min_num_points: 150, max_range: 15.0 };
        /// Thinning of the cloud matched against the low-resolution grid.
        low_resolution_adaptive_voxel_filter: AdaptiveVoxelFilterOptions =
            AdaptiveVoxelFilterOptions { max_length: 4.0, min_num_points: 200, max_range: MAX_3D_RANGE };
        /// Search a window around the prediction before refining. Turn it on for poor IMUs; it is slow.
        use_online_correlative_scan_matching: bool = false, "", Bounds::ANY;
        /// The search around the prediction that `use_online_correlative_scan_matching` turns on.
        real_time_correlative_scan_matcher: RealTimeCorrelativeScanMatcherOptions =
            RealTimeCorrelativeScanMatcherOptions {
                linear_search_window: 0.15,
                angular_search_window: 1.0_f64.to_radians(),
                translation_delta_cost_weight: 1e-1,
                rotation_delta_cost_weight: 1e-1,
            };
        /// The match of a scan with the submap, by least squares from the prediction or from the result of
        /// the search around it.
        ceres_scan_matcher: CeresScanMatcher3dOptions = CeresScanMatcher3dOptions::default();
        /// Which scans become nodes and are inserted into submaps.
        motion_filter: MotionFilterOptions =
            MotionFilterOptions { max_time_seconds: 0.5, max_distance_meters: 0.1, max_angle_radians: 0.004 };
        /// Buckets of the histogram of surface directions over half a turn. Raise it for finer yaw
        /// candidates in the loop search.
        rotational_histogram_size: usize = 120, "buckets", Bounds::within(1.0, 100_000.0);
        /// Time constant of the gravity filter of live pose output.
        imu_gravity_time_constant: f64 = 10.0, "s", Bounds::above(0.0);
        /// Prediction of poses between scan matches.
        pose_extrapolator: PoseExtrapolatorOptions = PoseExtrapolatorOptions::default();
        /// Submaps: number of scans, the two grids, insertion of scans.
        submaps: Submaps3dOptions = Submaps3dOptions::default();
        /// Match intensities too; every range message must then carry one for each point. Turn it on in
        /// tunnels and other places with little geometry.
        use_intensities: bool = false, "", Bounds::ANY;
    }
}
