//! Options of the scan matchers, which are used in local SLAM and in the search for constraints.

use super::SolverOptions;
use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// The correlative matcher of local SLAM: tries every pose in a window around the prediction.
    RealTimeCorrelativeScanMatcherOptions {
        /// Half width of the window in every direction. Raise it when the prediction is poor (no odometry,
        /// slow scanner); the cost grows with its square in 2D and its cube in 3D. Windows are limited where
        /// a search would take more than about two seconds for each scan.
        linear_search_window: f64 = 0.1, "m", Bounds::at_least(0.0);
        /// Half width of the window in rotation. Raise it when rotations are lost between two scans.
        angular_search_window: f64 = 20.0_f64.to_radians(), "rad", Bounds::at_least(0.0);
        /// How much a distance from the prediction lowers a score. Raise it to trust the predicted
        /// translation more (good odometry, long corridors).
        translation_delta_cost_weight: f64 = 1e-1, "1/m", Bounds::at_least(0.0);
        /// How much a rotation from the prediction lowers a score. Raise it to trust the predicted heading
        /// more (good gyroscope).
        rotation_delta_cost_weight: f64 = 1e-1, "1/rad", Bounds::at_least(0.0);
    }
}

options! {
    /// The matcher in 2D that refines a pose by least squares against the smoothed grid.
    CeresScanMatcher2dOptions {
        /// Weight of the agreement with the grid. Raise it to follow the scan against the prediction.
        occupied_space_weight: f64 = 1.0, "weight", Bounds::above(0.0);
        /// Weight of staying at the predicted position. Raise it when the map slides along corridors
        /// although the prediction is good.
        translation_weight: f64 = 10.0, "weight", Bounds::above(0.0);
        /// Weight of staying at the initial heading. Raise it when the map twists although the prediction
        /// is good.
        rotation_weight: f64 = 40.0, "weight", Bounds::above(0.0);
        /// Solver of the match.
        ceres_solver_options: SolverOptions = SolverOptions::default();
    }
}

options! {
    /// Agreement of measured intensities with those of the submap, 3D only.
    IntensityCostFunctionOptions {
        /// Weight of the agreement. Raise it where intensities constrain more than shapes (tunnels, markings).
        weight: f64 = 0.5, "weight", Bounds::at_least(0.0);
        /// Differences beyond this count linearly instead of squared. Raise it when intensities are
        /// reliable.
        huber_scale: f64 = 0.3, "intensity", Bounds::above(0.0);
        /// Points with a higher intensity are ignored (reflectors saturate). Raise it for scanners with a
        /// larger intensity scale.
        intensity_threshold: f32 = 40.0, "intensity", Bounds::ANY.or_infinite();
    }
}

options! {
    /// The matcher in 3D that refines a pose by least squares against the high-resolution grid (index 0)
    /// and the low-resolution grid (index 1).
    CeresScanMatcher3dOptions {
        /// Weight of the agreement with the high-resolution grid. Raise it to follow fine structure.
        occupied_space_weight_0: f64 = 1.0, "weight", Bounds::above(0.0);
        /// Weight of the agreement with the low-resolution grid. Raise it when matches jump in sparse
        /// surroundings.
        occupied_space_weight_1: f64 = 6.0, "weight", Bounds::above(0.0);
        /// Agreement of intensities with the high-resolution grid; used with `use_intensities`.
        intensity_cost_function_options_0: Option<IntensityCostFunctionOptions> =
            Some(IntensityCostFunctionOptions::default());
        /// Agreement of intensities with the low-resolution grid.
        intensity_cost_function_options_1: Option<IntensityCostFunctionOptions> = None;
        /// Weight of staying at the predicted position. Raise it when the map slides although the
        /// prediction is good.
        translation_weight: f64 = 5.0, "weight", Bounds::above(0.0);
        /// Weight of staying at the initial rotation. Raise it when the IMU is good.
        rotation_weight: f64 = 4e2, "weight", Bounds::above(0.0);
        /// Change only the yaw and the position, and take roll and pitch from the prediction. Turn it on
        /// when gravity is measured much better than scans constrain it.
        only_optimize_yaw: bool = false, "", Bounds::ANY;
        /// Solver of the match.
        ceres_solver_options: SolverOptions = SolverOptions { max_num_iterations: 12, ..SolverOptions::default() };
    }
}

impl CeresScanMatcher3dOptions {
    /// The weights by grid: high resolution, low resolution.
    pub fn occupied_space_weights(&self) -> [f64; 2] {
        [self.occupied_space_weight_0, self.occupied_space_weight_1]
    }

    /// The intensity tables of the grids 0, 1 up to the first one that is absent.
    pub fn intensity_cost_functions(&self) -> impl Iterator<Item = &IntensityCostFunctionOptions> {
        [&self.intensity_cost_function_options_0, &self.intensity_cost_function_options_1]
            .into_iter()
            .map_while(Option::as_ref)
    }
}

options! {
    /// The branch-and-bound matcher in 2D that looks for loop closures.
    FastCorrelativeScanMatcher2dOptions {
        /// Half width of the window around the estimated pose. Raise it when drift between two visits is
        /// larger than this; wrong closures and time grow with it.
        linear_search_window: f64 = 7.0, "m", Bounds::at_least(0.0);
        /// Half width of the window in rotation. Raise it when the heading drifts more than this between
        /// two visits.
        angular_search_window: f64 = 30.0_f64.to_radians(), "rad", Bounds::at_least(0.0);
        /// Number of precomputed grids in Cartographer, each with twice the cell of the one before.
        /// Portolan chooses the sizes of its search itself; the number decides only which of several places
        /// with exactly the same score is taken.
        branch_and_bound_depth: usize = 7, "grids", Bounds::within(1.0, 20.0);
    }
}

options! {
    /// The branch-and-bound matcher in 3D that looks for loop closures.
    FastCorrelativeScanMatcher3dOptions {
        /// The search starts with boxes of 2^(this − 1) cells, 64 at most. Raise it for larger windows; more
        /// memory, fewer steps. The best match does not depend on it.
        branch_and_bound_depth: usize = 8, "grids", Bounds::within(1.0, 20.0);
        /// How many of these grids keep the full resolution; each further one halves it. Raise it for
        /// tighter bounds at the price of memory.
        full_resolution_depth: usize = 3, "grids", Bounds::within(1.0, 20.0);
        /// Yaws whose histograms agree less than this are not tried. Raise it to search faster, lower it
        /// when true closures are missed.
        min_rotational_score: f64 = 0.77, "score", Bounds::within(-1.0, 1.0);
        /// A match must reach this score in the low-resolution grid too. Raise it against wrong closures.
        min_low_resolution_score: f64 = 0.55, "score", Bounds::within(-1.0, 1.0);
        /// Half width of the window in x and y. Raise it when drift is larger than this.
        linear_xy_search_window: f64 = 5.0, "m", Bounds::at_least(0.0);
        /// Half width of the window in z. Raise it when the height drifts more than this.
        linear_z_search_window: f64 = 1.0, "m", Bounds::at_least(0.0);
        /// Half width of the window in yaw. Raise it when the heading drifts more than this.
        angular_search_window: f64 = 15.0_f64.to_radians(), "rad", Bounds::at_least(0.0);
    }
}
