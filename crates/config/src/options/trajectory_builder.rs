//! `trajectory_builder`: options of one trajectory.

use super::{MotionFilterOptions, TrajectoryBuilder2dOptions, TrajectoryBuilder3dOptions};
use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// One trajectory: local SLAM of both dimensions and the handling of its sensors.
    TrajectoryBuilderOptions {
        /// Local SLAM in 2D.
        trajectory_builder_2d: TrajectoryBuilder2dOptions = TrajectoryBuilder2dOptions::default();
        /// Local SLAM in 3D.
        trajectory_builder_3d: TrajectoryBuilder3dOptions = TrajectoryBuilder3dOptions::default();
        /// Keep only the newest submaps, to localise in a loaded map; absent: keep all.
        pure_localization_trimmer: Option<PureLocalizationTrimmerOptions> = None;
        /// Bring fixed-frame poses (GNSS) into time order with the other sensors. Turn it off when they are
        /// rare or late.
        collate_fixed_frame: bool = true, "", Bounds::ANY;
        /// Bring landmarks into time order with the other sensors. Turn it on when they are regular.
        collate_landmarks: bool = false, "", Bounds::ANY;
        /// Thins the odometry that enters the pose graph; absent: all of it enters.
        pose_graph_odometry_motion_filter: Option<MotionFilterOptions> = None;
    }
}

options! {
    /// Pure localisation: which submaps of the running trajectory are kept.
    PureLocalizationTrimmerOptions {
        /// Number of newest submaps to keep. Raise it to keep more of what the loaded map does not show.
        max_submaps_to_keep: usize = 3, "submaps", Bounds::at_least(2.0);
    }
}
