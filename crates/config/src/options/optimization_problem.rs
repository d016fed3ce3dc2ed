//! `optimization_problem`: residuals and weights of the pose graph.

use super::SolverOptions;
use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// The least-squares problem over all nodes, submaps and landmarks.
    OptimizationProblemOptions {
        /// Residuals of loop closures and landmarks beyond this count linearly instead of squared. Raise
        /// it to pull harder on distant loops; lower it when single wrong closures bend the map.
        huber_scale: f64 = 1e1, "weighted residual", Bounds::above(0.0);
        /// In 3D, weight of the accelerations measured by the IMU. Raise it when the accelerometer is good.
        acceleration_weight: f64 = 1.1e2, "weight", Bounds::at_least(0.0);
        /// In 3D, weight of the rotations measured by the IMU. Raise it when the gyroscope is good.
        rotation_weight: f64 = 1.6e4, "weight", Bounds::at_least(0.0);
        /// Weight of the translation that local SLAM found between consecutive nodes (2D, and 3D with
        /// `fix_z_in_3d`). Raise it when scan matching is more reliable than loop closures.
        local_slam_pose_translation_weight: f64 = 1e5, "weight", Bounds::at_least(0.0);
        /// Weight of the rotation that local SLAM found between consecutive nodes. Raise it as above.
        local_slam_pose_rotation_weight: f64 = 1e5, "weight", Bounds::at_least(0.0);
        /// Weight of the translation that odometry measured between consecutive nodes (2D, 3D without an IMU,
        /// and 3D with `fix_z_in_3d`). Lower it when wheels slip.
        odometry_translation_weight: f64 = 1e5, "weight", Bounds::at_least(0.0);
        /// Weight of the rotation that odometry measured between consecutive nodes, as above. Lower it when
        /// wheels slip in turns.
        odometry_rotation_weight: f64 = 1e5, "weight", Bounds::at_least(0.0);
        /// Weight of the position of fixed-frame poses (GNSS). Raise it for good receivers.
        fixed_frame_pose_translation_weight: f64 = 1e1, "weight", Bounds::at_least(0.0);
        /// Weight of the rotation of fixed-frame poses. Set it to 0 when they carry no rotation.
        fixed_frame_pose_rotation_weight: f64 = 1e2, "weight", Bounds::at_least(0.0);
        /// Let fixed-frame poses be wrong by a tolerance without cost. Turn it on for receivers whose
        /// error is a slowly moving offset.
        fixed_frame_pose_use_tolerant_loss: bool = false, "", Bounds::ANY;
        /// The squared residual from which the tolerant loss begins to count. Raise it for larger offsets.
        fixed_frame_pose_tolerant_loss_param_a: f64 = 1.0, "squared residual", Bounds::at_least(0.0);
        /// How softly the tolerant loss begins. Raise it for a wider transition.
        fixed_frame_pose_tolerant_loss_param_b: f64 = 1.0, "squared residual", Bounds::above(0.0);
        /// Log the full report of the solver after each optimisation.
        log_solver_summary: bool = false, "", Bounds::ANY;
        /// In 3D, estimate the orientation of the IMU in the tracking frame. Turn it off when the mounting is
        /// known exactly.
        use_online_imu_extrinsics_in_3d: bool = true, "", Bounds::ANY;
        /// In 3D, keep all heights and use odometry and local SLAM instead of the IMU. Turn it on for robots
        /// on flat floors.
        fix_z_in_3d: bool = false, "", Bounds::ANY;
        /// Solver of the problem.
        ceres_solver_options: SolverOptions =
            SolverOptions { use_nonmonotonic_steps: false, max_num_iterations: 50, num_threads: 7 };
    }
}
