//! The top-level keys of a robot's file: frames, sensors and live output.

use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// Frames, sensors and live output of a robot. In files these keys are at the top level.
    BridgeOptions {
        /// Frame of the map. Recorded transforms below it are results of mapping and are not used.
        map_frame: String = "map".to_owned(), "frame", Bounds::ANY;
        /// Frame whose trajectory is estimated; should be where the IMU is.
        tracking_frame: String = "base_link".to_owned(), "frame", Bounds::ANY;
        /// Child frame of the published pose.
        published_frame: String = "base_link".to_owned(), "frame", Bounds::ANY;
        /// Frame of the local map, published between map and robot when `provide_odom_frame` is on.
        odom_frame: String = "odom".to_owned(), "frame", Bounds::ANY;
        /// Publish the local, continuous pose as a frame of its own.
        provide_odom_frame: bool = true, "", Bounds::ANY;
        /// Publish only x, y and yaw.
        publish_frame_projected_to_2d: bool = false, "", Bounds::ANY;
        /// Use odometry.
        use_odometry: bool = false, "", Bounds::ANY;
        /// Use satellite fixes.
        use_nav_sat: bool = false, "", Bounds::ANY;
        /// Use landmarks.
        use_landmarks: bool = false, "", Bounds::ANY;
        /// Laser scans to use: topic `scan`, or `scan_1` … `scan_n` for more than one.
        num_laser_scans: usize = 0, "topics", Bounds::within(0.0, 1000.0);
        /// Multi-echo laser scans to use: `echoes`, or `echoes_1` … `echoes_n`.
        num_multi_echo_laser_scans: usize = 0, "topics", Bounds::within(0.0, 1000.0);
        /// Number of pieces into which each laser scan is divided in time. Raise it for slow scanners on
        /// moving platforms, together with `num_accumulated_range_data`.
        num_subdivisions_per_laser_scan: usize = 1, "pieces", Bounds::at_least(1.0);
        /// Point clouds to use: `points2`, or `points2_1` … `points2_n`.
        num_point_clouds: usize = 0, "topics", Bounds::within(0.0, 1000.0);
        /// How long to wait for a transform.
        lookup_transform_timeout_sec: f64 = 0.2, "s", Bounds::at_least(0.0).or_infinite();
        /// Period of publishing submaps.
        submap_publish_period_sec: f64 = 0.3, "s", Bounds::ANY.or_infinite();
        /// Period of publishing poses; 0 or less: never.
        pose_publish_period_sec: f64 = 5e-3, "s", Bounds::ANY.or_infinite();
        /// Period of publishing trajectories.
        trajectory_publish_period_sec: f64 = 30e-3, "s", Bounds::ANY.or_infinite();
        /// Fraction of the range messages that is used. Lower it when mapping falls behind.
        rangefinder_sampling_ratio: f64 = 1.0, "ratio", Bounds::UNIT;
        /// Fraction of the odometry that is used. Lower it when its rate is very high.
        odometry_sampling_ratio: f64 = 1.0, "ratio", Bounds::UNIT;
        /// Fraction of the fixed-frame poses (GNSS) that is used.
        fixed_frame_pose_sampling_ratio: f64 = 1.0, "ratio", Bounds::UNIT;
        /// Fraction of the IMU measurements that is used; lower it only when their rate is very high.
        imu_sampling_ratio: f64 = 1.0, "ratio", Bounds::UNIT;
        /// Fraction of the landmarks that is used.
        landmarks_sampling_ratio: f64 = 1.0, "ratio", Bounds::UNIT;
        /// Publish transforms.
        publish_to_tf: bool = true, "", Bounds::ANY => optional;
        /// Publish the pose of the tracking frame as a message.
        publish_tracked_pose: bool = false, "", Bounds::ANY => optional;
        /// Publish poses predicted to the current time instead of the last matched one.
        use_pose_extrapolator: bool = true, "", Bounds::ANY => optional;
        /// Expect IMU, odometry and range messages that are not newer than the last one of their sensor.
        /// They are always skipped and counted; turned on, they do not count as lost data.
        ignore_out_of_order: bool = false, "", Bounds::ANY => optional;
    }
}
