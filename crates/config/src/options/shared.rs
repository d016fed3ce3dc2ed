//! Tables that are used in several places.

use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// A least-squares solver. The key in files is `ceres_solver_options` (or `solver_options`).
    SolverOptions {
        /// Accept steps that increase the cost for a while, which can lead out of a narrow valley. Turn it on
        /// where the optimisation stops in a poor local minimum; single results then vary more.
        use_nonmonotonic_steps: bool = false, "", Bounds::ANY;
        /// Maximum number of iterations of one solution; it stops earlier when the cost no longer falls.
        /// Raise it when the log says that solutions end at this limit.
        max_num_iterations: usize = 20, "iterations", Bounds::at_least(1.0);
        /// Threads for one solution.
        num_threads: usize = 1, "threads", Bounds::within(1.0, 1024.0);
    }
}

options! {
    /// A voxel filter that chooses its edge length itself: the coarsest one that still leaves
    /// `min_num_points` points.
    AdaptiveVoxelFilterOptions {
        /// Maximum edge of the voxels. Raise it to match with fewer points, faster and less exactly.
        max_length: f32 = 0.5, "m", Bounds::above(0.0);
        /// Points that must remain; the edge is shortened until they do. Raise it when matches slip in
        /// places with few features.
        min_num_points: usize = 200, "points", Bounds::at_least(0.0);
        /// Points farther than this from the origin of the cloud are dropped first. Raise it in wide
        /// halls whose walls are farther away.
        max_range: f32 = 50.0, "m", Bounds::above(0.0).or_infinite();
    }
}

options! {
    /// Drops items that are too similar to the last one kept: those within all three limits.
    MotionFilterOptions {
        /// Keep an item after this time even without motion. Raise it to keep fewer items while standing.
        max_time_seconds: f64 = 5.0, "s", Bounds::at_least(0.0).or_infinite();
        /// Keep an item after this distance. Raise it to keep fewer items while driving.
        max_distance_meters: f64 = 0.2, "m", Bounds::at_least(0.0).or_infinite();
        /// Keep an item after this rotation. Raise it to keep fewer items while rotating.
        max_angle_radians: f64 = 1.0_f64.to_radians(), "rad", Bounds::at_least(0.0).or_infinite();
    }
}
