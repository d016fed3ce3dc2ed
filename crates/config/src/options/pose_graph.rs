//! `pose_graph`: when constraints are searched and when the graph is optimised.

use super::{ConstraintBuilderOptions, OptimizationProblemOptions};
use crate::bounds::Bounds;
use crate::define::options;

options! {
    /// Global SLAM: nodes, submaps, the constraints between them and their optimisation.
    PoseGraphOptions {
        /// Optimise after more than this many new nodes; 0 or less turns optimisation while mapping off.
        /// Raise it to save time, lower it to see loops close sooner.
        optimize_every_n_nodes: i32 = 90, "nodes", Bounds::ANY;
        /// Search for constraints in windows and in full submaps, and their weights.
        constraint_builder: ConstraintBuilderOptions = ConstraintBuilderOptions::default();
        /// Weight of the translation between a node and the submaps it was inserted into. Raise it to
        /// trust local SLAM more.
        matcher_translation_weight: f64 = 5e2, "weight", Bounds::at_least(0.0);
        /// Weight of the rotation between a node and the submaps it was inserted into. Raise it to trust
        /// local SLAM more.
        matcher_rotation_weight: f64 = 1.6e3, "weight", Bounds::at_least(0.0);
        /// The least-squares problem.
        optimization_problem: OptimizationProblemOptions = OptimizationProblemOptions::default();
        /// Solver iterations of the last optimisation, after all data. Raise it when that optimisation still
        /// improves at this limit.
        max_num_final_iterations: usize = 200, "iterations", Bounds::at_least(1.0);
        /// Fraction of the nodes that are matched against whole submaps of other trajectories with which
        /// there is no recent constraint. Raise it to relocalise sooner; each such match is expensive.
        global_sampling_ratio: f64 = 0.003, "ratio", Bounds::UNIT;
        /// Log histograms of the residuals after each optimisation, 3D only.
        log_residual_histograms: bool = true, "", Bounds::ANY;
        /// Time without a common constraint after which nodes of a trajectory are matched against the whole
        /// submaps of another one instead of within a window. Raise it when such searches cost too much time.
        global_constraint_search_after_n_seconds: f64 = 10.0, "s", Bounds::at_least(0.0).or_infinite();
        /// Drops 2D submaps that newer ones cover; absent: none is dropped.
        overlapping_submaps_trimmer_2d: Option<OverlappingSubmapsTrimmer2dOptions> = None;
    }
}

options! {
    /// Drops 2D submaps whose area is covered by newer ones, for lifelong mapping of one area.
    OverlappingSubmapsTrimmer2dOptions {
        /// Number of newest submaps that count at each place. Raise it to keep more history.
        fresh_submaps_count: usize = 1, "submaps", Bounds::at_least(0.0);
        /// A submap is dropped when less than this area of it is still among the newest. Raise it to drop
        /// more.
        min_covered_area: f64 = 2.0, "m²", Bounds::at_least(0.0);
        /// Number of new submaps after which covered ones are looked for. Raise it to trim less often.
        min_added_submaps_count: usize = 5, "submaps", Bounds::at_least(0.0);
    }
}
