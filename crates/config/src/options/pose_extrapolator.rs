//! `pose_extrapolator`: the prediction of poses between scan matches.

use super::SolverOptions;
use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// Which extrapolator predicts poses, and the options of both.
    PoseExtrapolatorOptions {
        /// Use the extrapolator that optimises over IMU and odometry (3D only) instead of the one that
        /// assumes a constant velocity.
        use_imu_based: bool = false, "", Bounds::ANY;
        /// The extrapolator that assumes a constant velocity.
        constant_velocity: ConstantVelocityPoseExtrapolatorOptions =
            ConstantVelocityPoseExtrapolatorOptions::default();
        /// The extrapolator that optimises.
        imu_based: ImuBasedPoseExtrapolatorOptions = ImuBasedPoseExtrapolatorOptions::default();
    }
}

options! {
    /// The extrapolator that assumes a constant velocity between scan matches.
    ConstantVelocityPoseExtrapolatorOptions {
        /// Time constant of the low-pass filter that takes gravity out of accelerations. Raise it for
        /// platforms that accelerate often, lower it when roll and pitch follow too slowly. In 2D it has an
        /// effect only with `portolan.use_all_odometry = false`; otherwise gravity is estimated by a filter
        /// that takes the motion into account.
        imu_gravity_time_constant: f64 = 10.0, "s", Bounds::above(0.0);
        /// Velocities are computed from poses over this time. Raise it to smooth them when the rate of scans
        /// is high.
        pose_queue_duration: f64 = 0.001, "s", Bounds::at_least(0.0);
    }
}

options! {
    /// The extrapolator that fits poses, IMU and odometry of the last seconds, 3D only.
    ImuBasedPoseExtrapolatorOptions {
        /// Poses and measurements of this time are fitted. Raise it for a smoother, slower estimate.
        pose_queue_duration: f64 = 5.0, "s", Bounds::above(0.0);
        /// Gravity; 0 or less: estimated, starting at 9.8.
        gravity_constant: f64 = 9.806, "m/s²", Bounds::ANY;
        /// Weight of the positions of scan matches. Raise it to follow them more closely.
        pose_translation_weight: f64 = 1.0, "weight", Bounds::at_least(0.0);
        /// Weight of the rotations of scan matches. Raise it to follow them more closely.
        pose_rotation_weight: f64 = 1.0, "weight", Bounds::at_least(0.0);
        /// Weight of measured accelerations. Raise it for good accelerometers.
        imu_acceleration_weight: f64 = 1.0, "weight", Bounds::at_least(0.0);
        /// Weight of measured rotations. Raise it for good gyroscopes.
        imu_rotation_weight: f64 = 1.0, "weight", Bounds::at_least(0.0);
        /// Weight of the translations of odometry. Raise it for good odometry.
        odometry_translation_weight: f64 = 1.0, "weight", Bounds::at_least(0.0);
        /// Weight of the rotations of odometry. Raise it for good odometry.
        odometry_rotation_weight: f64 = 1.0, "weight", Bounds::at_least(0.0);
        /// Solver of the fit.
        solver_options: SolverOptions = SolverOptions { max_num_iterations: 10, ..SolverOptions::default() };
    }
}
