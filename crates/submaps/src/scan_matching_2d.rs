//! Builds 2D scan matchers from the options, and matches scans to the submap that is being filled
//! (`slam2d.md` §5, 10).

use portolan_config::{
    CeresScanMatcher2dOptions, FastCorrelativeScanMatcher2dOptions, TrajectoryBuilder2dOptions,
};
use portolan_geometry::Rigid2;
use portolan_matching::{
    FastCorrelativeOptions2d, GradientMatcher2d, GradientMatcherOptions2d, MatchResult, MatcherOptionError,
    RealTimeCorrelativeMatcher2d, RealTimeCorrelativeOptions,
};
use portolan_recall::{Answer, Sink, Words};
use portolan_sensor::PointCloud;
use portolan_solver::SolverOptions;

use crate::sampling_density::densely_sampled;
use crate::{SearchWindow, Submap2d};

/// Correlative search around the prediction, if the options enable it, then descent along the gradient.
pub struct ScanMatcher2d {
    correlative: Option<RealTimeCorrelativeOptions>,
    largest_penalty: f64,
    /// The gradient matcher starts from the result of the search. This decides whether it is also held there,
    /// or near the prediction.
    holds_search_result: bool,
    gradient: GradientMatcher2d,
}

impl ScanMatcher2d {
    /// With the options of local SLAM; weights that are not positive are an error. `search_penalty_limit` is
    /// the value of `portolan.search_penalty_limit`.
    pub fn new(
        options: &TrajectoryBuilder2dOptions,
        search_penalty_limit: f64,
    ) -> Result<Self, MatcherOptionError> {
        let o = &options.real_time_correlative_scan_matcher;
        let correlative =
            options.use_online_correlative_scan_matching.then_some(RealTimeCorrelativeOptions {
                linear_search_window: o.linear_search_window,
                angular_search_window: o.angular_search_window,
                translation_delta_cost_weight: o.translation_delta_cost_weight,
                rotation_delta_cost_weight: o.rotation_delta_cost_weight,
            });
        if let Some(options) = &correlative {
            RealTimeCorrelativeMatcher2d::new(options)?;
        }
        let holds_search_result = correlative.is_some() && search_penalty_limit < 1.0;
        Ok(Self {
            correlative,
            largest_penalty: search_penalty_limit,
            holds_search_result,
            gradient: gradient_matcher(&options.ceres_scan_matcher)?,
        })
    }

    /// The window of the search around predictions by the options, if there is one.
    pub fn usual_window(&self) -> Option<SearchWindow> {
        let options = self.correlative.as_ref()?;
        Some(SearchWindow { linear: options.linear_search_window, angular: options.angular_search_window })
    }

    /// The search in a window. The usual penalty for the distance from its middle is stretched to its size,
    /// and limited to `largest_penalty`, a fraction of scores.
    fn search_in(
        &self,
        window: Option<SearchWindow>,
        largest_penalty: f64,
    ) -> Option<RealTimeCorrelativeMatcher2d> {
        let usual = self.correlative.as_ref()?;
        let stretch = |wide: f64, usual: f64| if usual > 0.0 { wide / usual } else { 1.0 };
        let options = window.map_or_else(
            || usual.clone(),
            |w| RealTimeCorrelativeOptions {
                linear_search_window: w.linear,
                angular_search_window: w.angular,
                translation_delta_cost_weight: usual.translation_delta_cost_weight
                    / stretch(w.linear, usual.linear_search_window),
                rotation_delta_cost_weight: usual.rotation_delta_cost_weight
                    / stretch(w.angular, usual.angular_search_window),
            },
        );
        Some(RealTimeCorrelativeMatcher2d::new(&options).ok()?.with_largest_penalty(largest_penalty))
    }

    /// The pose of the scan in the local map. `cloud` are the points to match, selected from `returns`.
    /// Without a submap the result is the prediction. `window` is the search window; none: that of the
    /// options.
    pub fn match_scan(
        &self,
        prediction: Rigid2,
        cloud: &PointCloud,
        returns: &PointCloud,
        submap: Option<&Submap2d>,
        window: Option<SearchWindow>,
    ) -> ScanMatch2d {
        let Some(submap) = submap else { return ScanMatch2d { pose: prediction, score: None } };
        self.match_to(submap, prediction, [cloud, returns], self.search_in(window, self.largest_penalty))
    }

    /// Results of the search in a window around each of several poses, without a penalty for the distance.
    /// Empty without a search.
    pub fn search_around(
        &self,
        submap: &Submap2d,
        poses: &[Rigid2],
        clouds: [&PointCloud; 2],
        window: SearchWindow,
    ) -> Vec<Searched> {
        let Some(matcher) = self.search_in(Some(window), 0.0) else { return Vec::new() };
        let dense = self.dense(submap, clouds);
        let found = matcher.match_scan_around(poses, dense.as_ref().unwrap_or(clouds[0]), &submap.grid);
        let all = found.into_iter().zip(poses);
        all.filter_map(|(found, around)| {
            found.map(|MatchResult { score, pose }| Searched { score, pose, around: *around })
        })
        .collect()
    }

    /// Refines the result of a search along the gradient.
    pub fn refined(&self, submap: &Submap2d, found: &Searched, cloud: &PointCloud) -> Rigid2 {
        let held = if self.holds_search_result { found.pose } else { found.around };
        self.gradient.match_scan(held.translation, &found.pose, cloud, &submap.grid).pose
    }

    /// The densely sampled points, which are searched instead of all points to match; none: all are searched.
    fn dense(&self, submap: &Submap2d, [cloud, returns]: [&PointCloud; 2]) -> Option<PointCloud> {
        let spacing = (DENSE_CELLS * submap.grid.limits().resolution()) as f32;
        self.holds_search_result.then(|| densely_sampled(cloud, returns, spacing, MIN_DENSE_SHARE)).flatten()
    }

    fn match_to(
        &self,
        submap: &Submap2d,
        prediction: Rigid2,
        [cloud, returns]: [&PointCloud; 2],
        search: Option<RealTimeCorrelativeMatcher2d>,
    ) -> ScanMatch2d {
        let searched = search.and_then(|matcher| {
            let dense = self.dense(submap, [cloud, returns]);
            matcher.match_scan(&prediction, dense.as_ref().unwrap_or(cloud), &submap.grid)
        });
        let score = searched.as_ref().map(|found| found.score);
        let initial = searched.map_or(prediction, |found| found.pose);
        let held = if self.holds_search_result { initial } else { prediction };
        let pose = self.gradient.match_scan(held.translation, &initial, cloud, &submap.grid).pose;
        ScanMatch2d { pose, score }
    }
}

/// Result of a search for a scan.
#[derive(Clone, Copy, Debug)]
pub struct Searched {
    /// Score of the match.
    pub score: f32,
    /// In the local map.
    pub pose: Rigid2,
    /// The middle of the window.
    around: Rigid2,
}

/// Result of matching a scan.
#[derive(Clone, Copy, Debug)]
pub struct ScanMatch2d {
    /// In the local map.
    pub pose: Rigid2,
    /// Of the search, lowered by the distance from the prediction; none without a search.
    pub score: Option<f32>,
}

impl Answer for ScanMatch2d {
    fn write(&self, words: &mut impl Sink) {
        (self.pose, self.score).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let (pose, score) = Answer::read(words)?;
        Some(Self { pose, score })
    }
}

/// Distance between hits of neighbouring beams, in cells, above which they form dots, not a wall.
const DENSE_CELLS: f64 = 3.0;
/// Fraction of densely sampled points below which sparse ones are used as well.
const MIN_DENSE_SHARE: f64 = 0.2;

/// Assumed maximum speed of a robot in a gap without scans, m/s.
const UNSEEN_SPEED: f64 = 1.0;
/// Assumed maximum rate of rotation of a robot in a gap without scans, rad/s.
const UNSEEN_TURN_RATE: f64 = 1.5;
/// Maximum distance of the search after a gap, however long, metres.
const WIDEST_SEARCH: f64 = 5.0;
/// Minimum mean probability of a match. After a rotation much of the scan is new and counts as free, so that
/// this is low.
const MIN_WIDE_SCORE: f32 = 0.25;

/// The pose of a scan that was taken `gap_seconds` after the last one, with no measurement of the motion
/// between: the best placement within the distance that the robot can have travelled, slightly preferring the
/// last pose. `None` if the scan does not fit anywhere there.
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
///
/// # Errors
/// If a weight is not positive.
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
