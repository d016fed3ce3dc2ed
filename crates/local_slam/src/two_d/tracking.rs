//! Matches a scan with the submap: hypotheses of the motion, searches around them with windows of recent
//! prediction errors, and a decision between the matches.

mod judging;
mod viewing;

use portolan_config::TrajectoryBuilder2dOptions;
use portolan_geometry::{Rigid2, Time, Vector2, embed_3d};
use portolan_grids::{ScanAgreement, scan_agreement};
use portolan_matching::MatcherOptionError;
use portolan_recall::Memory;
use portolan_sensor::PointCloud;
use portolan_submaps::{ScanMatch2d, ScanMatcher2d, SearchWindow, Searched};

use super::LocalSlamExtras;
use super::catching_up::CatchingUp;
use super::degeneracy::WeakDirection;
use super::hypotheses::{Basis, CachedSearch, Judgement};
use super::motion::{ACCELERATION, ANGULAR_ACCELERATION, Measured, Motion, WIDEST, reached_by_acceleration};
use super::occlusion::Occlusion;
use super::odometry_failure::{MotionObservability, OdometryFailure};
use super::odometry_scale::OdometryScale;
use super::pose_status::is_hardly_explained;
use super::posterior::{BeamEvidence, MotionPrior};
use super::prediction_error::{PredictionError, PredictionSigmas, UsualScore};
use super::scan::{Scan, with_share};
use crate::remembered_scans::RememberedScans;
use crate::{OdometryBridge, UsualAgreement};

/// Half the search window around a prediction, in standard deviations.
const WITHIN_SIGMAS: f64 = 3.5;
/// Ratio of the time between two scans to the usual one from which on it is a gap.
const INTERVALS_OF_A_GAP: f64 = 10.0;
/// Minimum duration of a gap, seconds: in less time a robot remains within the search window, whatever
/// odometry reports.
const LEAST_GAP: f64 = 3.0;
/// Time constant of the usual interval, scans.
const INTERVALS_REMEMBERED: f64 = 20.0;
/// Offset from its prediction beyond which the match of few beams is questioned, metres and radians. The
/// beams that the map explains do not distinguish nearer poses.
const ELSEWHERE: SearchWindow = SearchWindow { linear: 0.15, angular: 0.1 };
/// Fraction of the match in the weighed pose above which it updates the errors of predictions;
/// dimensionless.
const MOSTLY: f64 = 0.67;
/// Uncertainty up to which a scan counts as constraining a direction, metres and radians; otherwise the
/// prediction determines it. Larger errors of odometry are noticed.
const CONSTRAINED_WITHIN: SearchWindow = SearchWindow { linear: 0.25, angular: 0.05 };

/// Directions in which the prediction determined the pose, since the scan constrains them weakly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Degeneracy {
    None,
    /// The position in this direction, a unit vector in the frame of the scan.
    Direction(Vector2),
    Full,
}

/// Match of a scan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    /// In the local map; the prediction where nothing better is known.
    pub pose: Rigid2,
    /// Whether the match is far from its prediction.
    pub is_far: bool,
    /// Whether odometry measured the motion but was not used.
    pub overrules_odometry: bool,
    /// Whether the scan or odometry constrains the position in the plane, so that none of it is assumed.
    pub measures_position: bool,
    /// Directions in which the prediction determined the pose.
    pub degeneracy: Degeneracy,
    /// How the map agrees with the scan there; none if the grid is a distance field.
    pub agreement: Option<ScanAgreement>,
}

/// Matches scans with the submap that is being filled.
pub(super) struct Tracker {
    matcher: ScanMatcher2d,
    is_adaptive: bool,
    /// Maximum search window around the prediction, if set.
    limit: Option<SearchWindow>,
    /// Time without measurements after which the scanner may have stopped, seconds.
    gap: f64,
    odometry_scale: OdometryScale,
    prediction_error: PredictionError,
    odometry_failure: OdometryFailure,
    catching_up: CatchingUp,
    usual_score: UsualScore,
    usual_agreement: UsualAgreement,
    beam_evidence: BeamEvidence,
    /// Mean time from scan to scan without gaps, seconds.
    interval: Option<f64>,
    /// Search result for the next scan, if it was searched before.
    cached_search: Option<CachedSearch>,
    occlusion: Occlusion,
    remembered: RememberedScans,
}

impl Tracker {
    pub fn new(
        options: &TrajectoryBuilder2dOptions,
        extras: &LocalSlamExtras,
    ) -> Result<Self, MatcherOptionError> {
        Ok(Self {
            matcher: ScanMatcher2d::new(options, extras.search_penalty_limit)?,
            is_adaptive: extras.adaptive_search,
            limit: None,
            gap: if extras.wide_search_after_gap > 0.0 {
                extras.wide_search_after_gap
            } else {
                f64::INFINITY
            },
            odometry_scale: OdometryScale::default(),
            prediction_error: PredictionError::default(),
            odometry_failure: OdometryFailure::default(),
            catching_up: CatchingUp::default(),
            usual_score: UsualScore::default(),
            usual_agreement: UsualAgreement::default(),
            beam_evidence: BeamEvidence::default(),
            interval: None,
            cached_search: None,
            occlusion: Occlusion::default(),
            remembered: RememberedScans::default(),
        })
    }

    /// Resets the statistics of scans and motions: those learned while the pose was lost are not valid in
    /// a new piece of map.
    pub fn restart(&mut self) {
        self.prediction_error = PredictionError::default();
        self.usual_score = UsualScore::default();
        self.beam_evidence = BeamEvidence::default();
    }

    /// The scanner moved like this over this time, seconds; odometry that contradicts it fails.
    pub fn odometry_contradicts(&mut self, moved: &Rigid2, seconds: f64) {
        self.odometry_failure = OdometryFailure::while_moving(moved, seconds);
    }

    /// Limits searches to this window around the prediction.
    pub fn limit_to(&mut self, window: SearchWindow) {
        self.limit = Some(window);
    }

    /// Sets the memory in which matched poses are remembered.
    pub fn remember_with(&mut self, memory: &Memory) {
        self.remembered = RememberedScans::new(memory);
    }

    /// Registers the next scan to be matched.
    pub fn note(&mut self, time: Time, prediction: &Rigid2, clouds: [&PointCloud; 2]) {
        self.remembered.note(time, &embed_3d(prediction), clouds);
    }

    /// Learns how the map agreed with an accepted scan.
    pub fn record_agreement(&mut self, agreement: &ScanAgreement) {
        self.usual_agreement.add(agreement);
    }

    /// Whether the agreement of a scan with the map is more typical of wrong poses than of correct ones in
    /// this recording.
    pub fn looks_wrong(&self, agreement: &ScanAgreement) -> bool {
        self.usual_agreement.looks_wrong(agreement)
    }

    /// Whether the search window adapts to recent prediction errors.
    pub fn is_adaptive(&self) -> bool {
        self.is_adaptive && self.matcher.usual_window().is_some()
    }

    /// Learned standard deviations of the prediction of this motion.
    pub fn sigmas(&self, motion: &Rigid2) -> PredictionSigmas {
        self.prediction_error.sigmas(motion)
    }

    /// Uncertainty of the motion to the next scan by odometry, if only odometry measures it: after a gap,
    /// where the surroundings of the scan are not in the map.
    pub fn bridge(
        &mut self,
        motion: Motion,
        prediction: &Rigid2,
        agreement: Option<ScanAgreement>,
    ) -> Option<OdometryBridge> {
        let interval = *self.interval.get_or_insert(motion.seconds);
        let least = LEAST_GAP.max(INTERVALS_OF_A_GAP * interval);
        // A gap hardly changes the usual interval, but a sensor that has become slower for good must not
        // give only gaps.
        self.interval = Some(interval + (motion.seconds.min(least) - interval) / INTERVALS_REMEMBERED);
        if motion.seconds < least {
            return None;
        }
        if !self.is_adaptive() || !motion.is_measured() || !agreement.is_none_or(|a| is_hardly_explained(&a))
        {
            return None;
        }
        let sigmas = self.prediction_error.sigmas(&motion.to(prediction));
        Some(OdometryBridge {
            translation: sigmas.translation,
            rotation: sigmas.rotation,
            is_contradicted: false,
        })
    }

    /// Matches the scan as the options specify, without judging the match.
    pub fn match_scan(&self, prediction: Rigid2, scan: Option<Scan>, cloud: &PointCloud) -> Rigid2 {
        let (returns, submap) = scan.map_or((cloud, None), |s| (s.returns, Some(s.submap)));
        let find = || self.matcher.match_scan(prediction, cloud, returns, submap, None);
        self.remembered.answer(prediction, find).pose
    }

    /// Best match of the scan around its prediction, in the window of recent errors of predictions of this
    /// kind. It does not update any statistics.
    pub fn search_ahead(&mut self, prediction: Rigid2, motion: Motion, scan: Scan) -> Option<Rigid2> {
        let window = self.window(&motion, &prediction);
        let balanced = WeakDirection::of(scan.returns).map(|weak| weak.balanced(scan.returns));
        let found = self.search((&scan, balanced.as_ref().unwrap_or(scan.cloud)), prediction, window);
        self.cached_search = Some(CachedSearch { around: prediction, window, found });
        Some(found.pose).filter(Rigid2::is_finite)
    }

    /// Best match of the scan in a window around each of these poses, the best first. It does not update
    /// any statistics, and is not remembered.
    pub fn search_freely(&self, scan: &Scan, poses: &[Rigid2], window: SearchWindow) -> Vec<Searched> {
        let clouds = [scan.cloud, scan.returns];
        let mut found = self.matcher.search_around(scan.submap, poses, clouds, window);
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        found
    }

    /// Refines the result of a search.
    pub fn refined(&self, scan: &Scan, found: &Searched) -> Rigid2 {
        self.matcher.refined(scan.submap, found, scan.cloud)
    }

    /// Discards the search result, since another scan is to be matched than the one that was searched.
    pub fn discard_cached_search(&mut self) {
        self.cached_search = None;
    }

    /// Matches the scan around its prediction, in the window of recent prediction errors. Where it fits
    /// the map worse than recent scans did, the window covers all that the scanner can have moved.
    pub fn find(&mut self, extrapolated: Rigid2, motion: Motion, scan: Scan) -> Found {
        // 1. Predict.
        let weak = WeakDirection::of(scan.returns);
        let prediction = self.predicted(extrapolated, &motion, weak.as_ref());
        // 2. Search, and choose between the matches.
        let balanced = weak.as_ref().map(|weak| weak.balanced(scan.returns));
        let cloud = balanced.as_ref().unwrap_or(scan.cloud);
        let window = self.window(&motion, &prediction);
        let near = self.search_hypotheses([prediction, extrapolated], motion, (&scan, cloud), window);
        let is_failing = motion.is_measured() && near.basis == Basis::ConstantVelocity;
        let predicted_motion = (motion.to(&prediction), motion.seconds);
        let measured = if is_failing { Measured::Nothing } else { motion.measured };
        let motion = Motion { measured, ..motion };
        let (found, judgement) = self.judged(&near, motion, (&scan, cloud), window);
        self.cached_search = None;
        let is_far = judgement == Judgement::Far;
        let has_caught_up = near.basis == Basis::CaughtUp;
        self.catching_up.add(predicted_motion, near.around, is_far && motion.is_measured(), has_caught_up);
        if let Some(score) = found.score {
            self.usual_score.add(score);
        }
        if !found.pose.is_finite() {
            let degeneracy = Degeneracy::Full;
            let overrules_odometry = false;
            return Found {
                pose: prediction,
                is_far: false,
                overrules_odometry,
                measures_position: false,
                degeneracy,
                agreement: None,
            };
        }
        // 3. Weigh the match with the prediction.
        let is_open = weak.is_some() || scan.independent_measurements.are_few();
        if !is_open {
            self.odometry_failure.add_pose(&found.pose);
        }
        // If the match is far off, the prediction was rejected.
        let weighed = weak.as_ref().filter(|_| !is_far);
        let (pose, degeneracy) = match judgement {
            // So few beams do not confirm a prediction that they could not refute.
            Judgement::Predicted if scan.independent_measurements.are_few() => (found.pose, Degeneracy::Full),
            _ => self.weigh(found.pose, near.around, motion, &scan, weighed, is_failing || is_far),
        };
        // 4. Learn how odometry and beams agree with the pose. Degenerate scans do not measure the
        // distance travelled.
        let observability = match (is_open, is_far) {
            (false, _) => MotionObservability::Full,
            (true, false) => MotionObservability::Weak,
            (true, true) => MotionObservability::Guess,
        };
        self.odometry_failure.add_motion(&motion.to(&pose), motion.seconds, observability);
        if near.basis == Basis::Measured && !is_far && !is_open {
            let measured = motion.to(&extrapolated);
            let sigma = self.prediction_error.sigmas(&measured).translation;
            let moved = motion.of_tracking(&motion.to(&found.pose));
            self.odometry_scale.add(&motion.of_tracking(&measured), &moved, sigma);
        }
        let agreement = scan_agreement(&scan.submap.grid, &pose, scan.cloud);
        if let Some(agreement) = &agreement {
            self.beam_evidence.add(agreement);
        }
        let measures_position = !is_open || motion.is_measured();
        Found { pose, is_far, overrules_odometry: is_failing, measures_position, degeneracy, agreement }
    }

    /// Ratio of the distance by odometry to that by scans, if it is corrected.
    pub fn odometry_factor(&self) -> Option<f64> {
        self.odometry_scale.factor()
    }

    /// Pose of the scan without odometry, if odometry, which gives `extrapolated`, probably fails.
    pub fn suspected(&self, extrapolated: Rigid2, motion: Motion) -> Option<Rigid2> {
        self.odometry_failure
            .suspected(motion, &self.prior(self.predicted(extrapolated, &motion, None), motion))
    }

    /// Pose of the scan by odometry that measured the motion.
    pub fn pose_by_odometry(&self, extrapolated: Rigid2, motion: &Motion) -> Rigid2 {
        self.predicted(extrapolated, motion, None)
    }

    /// Predicted pose of the scan; `extrapolated` is the pose by odometry, or else by constant velocity.
    fn predicted(&self, extrapolated: Rigid2, motion: &Motion, weak: Option<&WeakDirection>) -> Rigid2 {
        let prediction = match motion.measured {
            Measured::Whole => {
                let measured = motion.of_tracking(&motion.to(&extrapolated));
                motion.last * motion.of_aligned(&self.odometry_scale.corrected(&measured))
            }
            Measured::Rotation if motion.is_unknown() => Rigid2 { angle: extrapolated.angle, ..motion.last },
            Measured::Nothing if motion.is_unknown() => motion.last,
            Measured::Rotation | Measured::Nothing => extrapolated,
        };
        // Readings far apart do not measure rotations and stops between them, but do measure the distance
        // along a corridor.
        match (weak, motion.between_readings) {
            (Some(weak), Some(read)) => weak.with_share(&read, &prediction, 0.0),
            _ => prediction,
        }
    }

    fn search(
        &self,
        (scan, cloud): (&Scan, &PointCloud),
        around: Rigid2,
        window: SearchWindow,
    ) -> ScanMatch2d {
        if let Some(cached_search) =
            self.cached_search.as_ref().filter(|l| l.around == around && l.window == window)
        {
            return cached_search.found;
        }
        let find = || self.matcher.match_scan(around, cloud, scan.returns, Some(scan.submap), Some(window));
        self.remembered.answer((around, window), find)
    }

    /// Motion prior of the pose of a scan.
    pub fn prior(&self, prediction: Rigid2, motion: Motion) -> MotionPrior {
        let mut sigmas = self.prediction_error.sigmas(&motion.to(&prediction));
        let square = motion.seconds.powi(2);
        if !motion.is_measured() {
            sigmas.translation = sigmas.translation.hypot(ACCELERATION * square);
        }
        if !motion.is_rotation_measured() {
            sigmas.rotation = sigmas.rotation.hypot(ANGULAR_ACCELERATION * square);
        }
        MotionPrior { prediction, sigmas }
    }

    /// Weighs the match with the prediction in degenerate directions, and updates the errors of
    /// predictions where the scan constrains the motion enough. Gives the pose, and the directions in
    /// which the prediction determined it.
    fn weigh(
        &mut self,
        found: Rigid2,
        around: Rigid2,
        motion: Motion,
        scan: &Scan,
        weak: Option<&WeakDirection>,
        is_failing: bool,
    ) -> (Rigid2, Degeneracy) {
        let predicted_motion = motion.to(&around);
        if scan.independent_measurements.are_very_few() && !is_failing {
            return self.weigh_few(found, around, motion, scan);
        }
        let (mut pose, mut observed, mut degeneracy) = (found, found, Degeneracy::None);
        if let Some(weak) = weak {
            let learned = self.prediction_error.sigmas(&predicted_motion).translation;
            let is_measured = motion.is_measured() || motion.between_readings.is_some();
            let unmeasured = if is_measured { 0.0 } else { ACCELERATION * motion.seconds.powi(2) };
            let gain =
                weak.gain(&scan.submap.grid, scan.returns, (&around, &found), learned.hypot(unmeasured));
            pose = weak.with_share(&around, &found, gain);
            observed = weak.with_share(&around, &found, 0.0);
            if !weak.is_constrained(scan, &pose, CONSTRAINED_WITHIN.linear) {
                degeneracy = Degeneracy::Direction(weak.in_scan());
            }
        }
        if motion.seconds <= self.gap && !is_failing {
            self.prediction_error.add(&predicted_motion, &(around.inverse() * observed));
        }
        (pose, degeneracy)
    }

    /// Weighs a match of hardly any beams with the prediction. It updates the errors of predictions only
    /// where it has most of the weight.
    fn weigh_few(
        &mut self,
        found: Rigid2,
        around: Rigid2,
        motion: Motion,
        scan: &Scan,
    ) -> (Rigid2, Degeneracy) {
        let share = scan.match_share(&self.prior(around, motion), &found);
        if motion.seconds <= self.gap && share > MOSTLY {
            self.prediction_error.add(&motion.to(&around), &(around.inverse() * found));
        }
        let pose = with_share(&around, &found, share);
        let SearchWindow { linear, angular } = CONSTRAINED_WITHIN;
        let offsets =
            [Rigid2::new(linear, 0.0, 0.0), Rigid2::new(0.0, linear, 0.0), Rigid2::new(0.0, 0.0, angular)];
        let weights = vec![1.0; scan.returns.points.len()];
        let is_constrained = offsets.iter().all(|offset| scan.distinguishes(&pose, *offset, &weights));
        (pose, if is_constrained { Degeneracy::None } else { Degeneracy::Full })
    }

    /// Search window of recent errors of predictions of such a motion. Where the motion was unmeasured, it
    /// is limited to the range that the largest acceleration allows, at any velocity.
    fn window(&self, motion: &Motion, prediction: &Rigid2) -> SearchWindow {
        let window = self.window_of(&self.prediction_error.sigmas(&motion.to(prediction)));
        if motion.is_measured() || self.limit.is_some() {
            return window;
        }
        let usual = self.matcher.usual_window().unwrap_or(window);
        let reached = reached_by_acceleration(motion.seconds);
        SearchWindow {
            linear: window.linear.min(usual.linear + reached.linear),
            angular: match motion.is_rotation_measured() {
                true => window.angular,
                false => window.angular.min(usual.angular + reached.angular),
            },
        }
    }

    /// Search window of predictions with these standard deviations.
    fn window_of(&self, sigmas: &PredictionSigmas) -> SearchWindow {
        if let Some(limit) = self.limit {
            return limit;
        }
        let usual = self.matcher.usual_window().unwrap_or(SearchWindow { linear: 0.0, angular: 0.0 });
        SearchWindow {
            linear: usual.linear.max(WITHIN_SIGMAS * sigmas.translation).min(WIDEST.linear),
            angular: usual.angular.max(WITHIN_SIGMAS * sigmas.rotation).min(WIDEST.angular),
        }
    }
}

fn is_elsewhere(offset: &Rigid2) -> bool {
    offset.translation.norm() > ELSEWHERE.linear || offset.normalized_angle().abs() > ELSEWHERE.angular
}

#[cfg(test)]
mod tests {
    use portolan_config::Options;

    use super::*;

    #[test]
    fn a_sensor_that_becomes_slower_is_not_all_gaps() {
        let mut options = Options::for_2d().trajectory_builder.trajectory_builder_2d;
        options.use_online_correlative_scan_matching = true;
        let extras = LocalSlamExtras { adaptive_search: true, ..LocalSlamExtras::default() };
        let mut tracker = Tracker::new(&options, &extras).unwrap();
        let mut is_gap =
            |seconds| tracker.bridge(Motion::measured(seconds), &Rigid2::new(1.0, 0.0, 0.0), None).is_some();
        assert!((0..50).all(|_| !is_gap(0.1)));
        assert!(!is_gap(2.5) && is_gap(5.0));
        assert!((0..50).all(|_| !is_gap(0.1)));
        assert!((0..5).any(|_| is_gap(5.0)));
        assert!((0..50).filter(|_| is_gap(5.0)).count() < 10);
        assert!(!is_gap(5.0) && is_gap(60.0));
    }
}
