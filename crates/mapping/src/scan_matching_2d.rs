//! Matchers as the options describe them, and matching a scan against the submap that is being filled
//! (`slam2d.md` §5, 10).

use portolan_config::{
    CeresScanMatcher2dOptions, FastCorrelativeScanMatcher2dOptions, TrajectoryBuilder2dOptions,
};
use portolan_geometry::Rigid2;
use portolan_matching::{
    FastCorrelativeOptions2d, GradientMatcher2d, GradientMatcherOptions2d, MatcherOptionError,
    RealTimeCorrelativeMatcher2d, RealTimeCorrelativeOptions,
};
use portolan_sensor::PointCloud;
use portolan_solver::SolverOptions;

use crate::sampling_density::densely_sampled;
use crate::submap_2d::Submap2d;

/// Correlative search around the prediction, if asked for, then descent along the gradient.
pub struct ScanMatcher2d {
    correlative: Option<RealTimeCorrelativeMatcher2d>,
    /// The gradient matcher starts from the search's result; whether it is also held there, or near the
    /// prediction.
    holds_search_result: bool,
    gradient: GradientMatcher2d,
}

impl ScanMatcher2d {
    /// With the options of local SLAM; weights that are not positive are an error.
    /// `search_penalty_limit` is what `portolan.search_penalty_limit` says.
    pub fn new(
        options: &TrajectoryBuilder2dOptions,
        search_penalty_limit: f64,
    ) -> Result<Self, MatcherOptionError> {
        let o = &options.real_time_correlative_scan_matcher;
        let correlative = options
            .use_online_correlative_scan_matching
            .then(|| {
                RealTimeCorrelativeMatcher2d::new(&RealTimeCorrelativeOptions {
                    linear_search_window: o.linear_search_window,
                    angular_search_window: o.angular_search_window,
                    translation_delta_cost_weight: o.translation_delta_cost_weight,
                    rotation_delta_cost_weight: o.rotation_delta_cost_weight,
                })
                .map(|matcher| matcher.with_largest_penalty(search_penalty_limit))
            })
            .transpose()?;
        let holds_search_result = correlative.is_some() && search_penalty_limit < 1.0;
        Ok(Self {
            correlative,
            holds_search_result,
            gradient: gradient_matcher(&options.ceres_scan_matcher)?,
        })
    }

    /// The pose of the scan in the local map. `cloud` are the points to match, picked from `returns`.
    /// Without a submap the prediction is all there is.
    pub fn match_scan(
        &self,
        prediction: Rigid2,
        cloud: &PointCloud,
        returns: &PointCloud,
        submap: Option<&Submap2d>,
    ) -> Rigid2 {
        let Some(submap) = submap else { return prediction };
        let searched = self.correlative.as_ref().and_then(|matcher| {
            let spacing = (DENSE_CELLS * submap.grid.limits().resolution()) as f32;
            let dense = if self.holds_search_result {
                densely_sampled(cloud, returns, spacing, MIN_DENSE_SHARE)
            } else {
                None
            };
            matcher.match_scan(&prediction, dense.as_ref().unwrap_or(cloud), &submap.grid)
        });
        let initial = searched.map_or(prediction, |found| found.pose);
        let held = if self.holds_search_result { initial } else { prediction };
        self.gradient.match_scan(held.translation, &initial, cloud, &submap.grid).pose
    }
}

/// Hits of neighbouring beams that are further apart than so many cells draw dots, not a wall.
const DENSE_CELLS: f64 = 3.0;
/// With less than this share of the points left, sparse ones are used as well.
const MIN_DENSE_SHARE: f64 = 0.2;

/// How fast a robot is thought to be able to go and turn when nothing was seen of it.
const UNSEEN_SPEED: f64 = 1.0;
const UNSEEN_TURN_RATE: f64 = 1.5;
/// Metres beyond which it is not looked for, however long the gap.
const WIDEST_SEARCH: f64 = 5.0;
/// A mean probability below this is no match. After a turn much of what is seen is new and counts as
/// free, so that this is low.
const MIN_WIDE_SCORE: f32 = 0.25;

/// The pose of a scan that was taken `gap_seconds` after the last one, with nothing known of the motion
/// between: the best placement as far away as the robot can have gone, slightly preferring the last
/// pose. `None` if the scan does not fit anywhere there.
pub fn search_after_gap(
    last_pose: Rigid2,
    gap_seconds: f64,
    cloud: &PointCloud,
    submap: &Submap2d,
) -> Option<Rigid2> {
    let matcher = RealTimeCorrelativeMatcher2d::new(&RealTimeCorrelativeOptions {
        linear_search_window: (UNSEEN_SPEED * gap_seconds).clamp(0.0, WIDEST_SEARCH),
        angular_search_window: (UNSEEN_TURN_RATE * gap_seconds).clamp(0.0, std::f64::consts::PI),
        ..RealTimeCorrelativeOptions::default()
    });
    let found = matcher.ok()?.match_scan(&last_pose, cloud, &submap.grid)?;
    (found.score >= MIN_WIDE_SCORE).then_some(found.pose)
}

/// The gradient matcher that the options describe.
pub fn gradient_matcher(
    options: &CeresScanMatcher2dOptions,
) -> Result<GradientMatcher2d, MatcherOptionError> {
    let solver = &options.ceres_solver_options;
    GradientMatcher2d::new(&GradientMatcherOptions2d {
        occupied_space_weight: options.occupied_space_weight,
        translation_weight: options.translation_weight,
        rotation_weight: options.rotation_weight,
        solver: SolverOptions {
            max_num_iterations: u32::try_from(solver.max_num_iterations).unwrap_or(u32::MAX),
            use_nonmonotonic_steps: solver.use_nonmonotonic_steps,
            ..SolverOptions::default()
        },
    })
}

/// The settings of the search for constraints.
pub fn fast_matcher_options(options: &FastCorrelativeScanMatcher2dOptions) -> FastCorrelativeOptions2d {
    FastCorrelativeOptions2d {
        linear_search_window: options.linear_search_window,
        angular_search_window: options.angular_search_window,
        branch_and_bound_depth: u32::try_from(options.branch_and_bound_depth).unwrap_or(u32::MAX),
    }
}
