//! `constraint_builder`: the search for loop closures.

use super::{
    CeresScanMatcher2dOptions, CeresScanMatcher3dOptions, FastCorrelativeScanMatcher2dOptions,
    FastCorrelativeScanMatcher3dOptions, SolverOptions,
};
use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// Which nodes are matched against which submaps, and the weights of the constraints.
    ConstraintBuilderOptions {
        /// Fraction of the nodes near a submap that are matched against it. Raise it to find more loop
        /// closures, lower it when mapping falls behind the sensor.
        sampling_ratio: f64 = 0.3, "ratio", Bounds::UNIT;
        /// Nodes farther than this from the origin of a submap, or in 3D with planes from the positions of
        /// all its nodes, are not matched against it (search in a window only). Raise it for scanners with a
        /// long range.
        max_constraint_distance: f64 = 15.0, "m", Bounds::at_least(0.0).or_infinite();
        /// Minimum score of a match in a window; in 3D with planes, minimum fraction of the points of a scan
        /// on planes, if nearly all points of scans are on the planes of their own submaps, and less if fewer
        /// are. Raise it against wrong loop closures, lower it when true ones are missed.
        min_score: f64 = 0.55, "score", Bounds::UNIT;
        /// Minimum score of a match against a whole submap, or in 3D at a pose proposed by a search of the
        /// whole map. Raise it when relocalisation finds wrong places.
        global_localization_min_score: f64 = 0.6, "score", Bounds::UNIT;
        /// Weight of the translation of a loop closure. Raise it when loops do not close fully.
        loop_closure_translation_weight: f64 = 1.1e4, "weight", Bounds::at_least(0.0);
        /// Weight of the rotation of a loop closure. Raise it when loops do not close fully.
        loop_closure_rotation_weight: f64 = 1e5, "weight", Bounds::at_least(0.0);
        /// Log every constraint found, and histograms of the scores.
        log_matches: bool = true, "", Bounds::ANY;
        /// The search in 2D.
        fast_correlative_scan_matcher: FastCorrelativeScanMatcher2dOptions =
            FastCorrelativeScanMatcher2dOptions::default();
        /// The refinement of a found match in 2D.
        ceres_scan_matcher: CeresScanMatcher2dOptions = CeresScanMatcher2dOptions {
            occupied_space_weight: 20.0,
            translation_weight: 10.0,
            rotation_weight: 1.0,
            ceres_solver_options: refinement_solver(true),
        };
        /// The search in 3D.
        fast_correlative_scan_matcher_3d: FastCorrelativeScanMatcher3dOptions =
            FastCorrelativeScanMatcher3dOptions::default();
        /// The refinement of a found match in 3D.
        ceres_scan_matcher_3d: CeresScanMatcher3dOptions = CeresScanMatcher3dOptions {
            occupied_space_weight_0: 5.0,
            occupied_space_weight_1: 30.0,
            intensity_cost_function_options_0: None,
            intensity_cost_function_options_1: None,
            translation_weight: 10.0,
            rotation_weight: 1.0,
            only_optimize_yaw: false,
            ceres_solver_options: refinement_solver(false),
        };
    }
}

fn refinement_solver(use_nonmonotonic_steps: bool) -> SolverOptions {
    SolverOptions { use_nonmonotonic_steps, max_num_iterations: 10, num_threads: 1 }
}
