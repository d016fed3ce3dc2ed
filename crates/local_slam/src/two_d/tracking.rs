//! Where a scan lies in the submap that is matched against: hypotheses of the motion, searches around them as wide as
//! predictions were wrong lately, and a judgement of what was found.

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
use super::belief::is_hardly_explained;
use super::catching_up::CatchingUp;
use super::degeneracy::WeakDirection;
use super::hypotheses::{Basis, Judgement, Looked};
use super::motion::{ACCELERATION, ANGULAR_ACCELERATION, Measured, Motion, WIDEST, reached_by_acceleration};
use super::occlusion::Occlusion;
use super::odometry_failure::{MotionObservability, OdometryFailure};
use super::odometry_scale::OdometryScale;
use super::posterior::{BeamEvidence, MotionPrior};
use super::prediction_error::{PredictionError, PredictionSigmas, UsualScore};
use super::scan::{Scan, with_share};
use crate::remembered_scans::RememberedScans;
use crate::{OdometryBridge, UsualAgreement};

/// Scans are searched within so many standard deviations of their prediction.
const WITHIN_SIGMAS: f64 = 3.5;
/// So many times the usual time from scan to scan are a gap …
const INTERVALS_OF_A_GAP: f64 = 10.0;
/// … if they are so many seconds: in less a robot goes no farther than scans are searched, whatever odometry says.
const LEAST_GAP: f64 = 3.0;
/// About so many intervals tell what is usual.
const INTERVALS_REMEMBERED: f64 = 20.0;
/// What few beams find so far from its prediction, metres and radians, is doubted: which beams the map explains tells nearer
/// poses not apart.
const ELSEWHERE: SearchWindow = SearchWindow { linear: 0.15, angular: 0.1 };
/// Where scans tell this share of their poses they tell how far predictions are off, too.
const MOSTLY: f64 = 0.67;
/// What a scan does not tell to within this, metres and radians, it leaves to the prediction: odometry that is wrong by more
/// is noticed.
const TOLD_WITHIN: SearchWindow = SearchWindow { linear: 0.25, angular: 0.05 };

/// What the prediction decided, since the scan tells little of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum LeftOpen {
    Nothing,
    /// How far it went in this direction, a unit vector in the frame of the scan.
    Along(Vector2),
    Everything,
}

/// Where a scan was found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    /// In the local map; the prediction where nothing better is known.
    pub pose: Rigid2,
    /// It was found far from its prediction.
    pub is_far: bool,
    /// Odometry measured the motion, and it was not used.
    pub overrules_odometry: bool,
    /// The scan, or odometry, told where it is in the plane; nothing was taken for granted.
    pub tells_place: bool,
    /// What the prediction decided of the pose.
    pub left_open: LeftOpen,
    /// How the map agrees with the scan there; none where the grid does not tell.
    pub agreement: Option<ScanAgreement>,
}

/// Finds scans in the submap that is being filled.
pub(super) struct Tracker {
    matcher: ScanMatcher2d,
    is_adaptive: bool,
    /// No scan is looked for farther from its prediction, if this is set.
    limit: Option<SearchWindow>,
    /// After so many seconds of which nothing was measured the scanner may as well have stood still.
    gap: f64,
    odometry_scale: OdometryScale,
    prediction_error: PredictionError,
    odometry_failure: OdometryFailure,
    catching_up: CatchingUp,
    usual_score: UsualScore,
    usual_agreement: UsualAgreement,
    beam_evidence: BeamEvidence,
    /// Mean seconds from scan to scan, but for gaps.
    interval: Option<f64>,
    /// Of the scan that is to be found next, if it was looked for.
    looked: Option<Looked>,
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
            looked: None,
            occlusion: Occlusion::default(),
            remembered: RememberedScans::default(),
        })
    }

    /// Forgets what scans and motions were usual: what was learned while the pose was lost says nothing of a new piece of map.
    pub fn begin_anew(&mut self) {
        self.prediction_error = PredictionError::default();
        self.usual_score = UsualScore::default();
        self.beam_evidence = BeamEvidence::default();
    }

    /// The scanner moves like this in so many seconds: if odometry says otherwise it fails.
    pub fn odometry_contradicts(&mut self, moved: &Rigid2, seconds: f64) {
        self.odometry_failure = OdometryFailure::while_moving(moved, seconds);
    }

    /// Looks for no scan farther from its prediction.
    pub fn limit_to(&mut self, window: SearchWindow) {
        self.limit = Some(window);
    }

    /// Remembers where scans were found with this.
    pub fn remember_with(&mut self, memory: &Memory) {
        self.remembered = RememberedScans::new(memory);
    }

    /// Takes note of the scan that is to be found next.
    pub fn note(&mut self, time: Time, prediction: &Rigid2, clouds: [&PointCloud; 2]) {
        self.remembered.note(time, &embed_3d(prediction), clouds);
    }

    /// Takes note of how the map agreed with a scan that was believed.
    pub fn note_agreement(&mut self, agreement: &ScanAgreement) {
        self.usual_agreement.add(agreement);
    }

    /// Whether a scan agrees with the map rather as scans do at wrong places than as those of this recording do at theirs.
    pub fn looks_wrong(&self, agreement: &ScanAgreement) -> bool {
        self.usual_agreement.looks_wrong(agreement)
    }

    /// Whether scans are searched as far as predictions were wrong lately.
    pub fn is_adaptive(&self) -> bool {
        self.is_adaptive && self.matcher.usual_window().is_some()
    }

    /// How far predictions of this motion are off, as far as is known.
    pub fn sigmas(&self, motion: &Rigid2) -> PredictionSigmas {
        self.prediction_error.sigmas(motion)
    }

    /// How well odometry tells the motion to the next scan if it alone does: after a gap, where the map does not know what
    /// is seen.
    pub fn bridge(
        &mut self,
        motion: Motion,
        prediction: &Rigid2,
        agreement: Option<ScanAgreement>,
    ) -> Option<OdometryBridge> {
        let interval = *self.interval.get_or_insert(motion.seconds);
        let least = LEAST_GAP.max(INTERVALS_OF_A_GAP * interval);
        // A gap says little of what is usual, but a sensor that has become slower for good is not all gaps.
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

    /// Finds the scan as the options say, without judging it.
    pub fn match_scan(&self, prediction: Rigid2, scan: Option<Scan>, cloud: &PointCloud) -> Rigid2 {
        let (returns, submap) = scan.map_or((cloud, None), |s| (s.returns, Some(s.submap)));
        let find = || self.matcher.match_scan(prediction, cloud, returns, submap, None);
        self.remembered.answer(prediction, find).pose
    }

    /// Where the scan fits best around its prediction, as far as predictions of what nothing measured were wrong lately. Nothing
    /// is learned from it.
    pub fn look(&mut self, prediction: Rigid2, motion: Motion, scan: Scan) -> Option<Rigid2> {
        let window = self.window(&motion, &prediction);
        let balanced = WeakDirection::of(scan.returns).map(|weak| weak.balanced(scan.returns));
        let found = self.search((&scan, balanced.as_ref().unwrap_or(scan.cloud)), prediction, window);
        self.looked = Some(Looked { around: prediction, window, found });
        Some(found.pose).filter(Rigid2::is_finite)
    }

    /// Where the scan fits best within a window around each of these poses, the best first. Nothing is learned from it, and nothing
    /// remembered.
    pub fn search_freely(&self, scan: &Scan, poses: &[Rigid2], window: SearchWindow) -> Vec<Searched> {
        let clouds = [scan.cloud, scan.returns];
        let mut found = self.matcher.search_around(scan.submap, poses, clouds, window);
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        found
    }

    /// Goes on from where a search found the scan.
    pub fn refined(&self, scan: &Scan, found: &Searched) -> Rigid2 {
        self.matcher.refined(scan.submap, found, scan.cloud)
    }

    /// Another scan is to be found than that which was looked for.
    pub fn forget_look(&mut self) {
        self.looked = None;
    }

    /// Finds the scan around where the motion leads, as far as predictions were wrong lately, and as far as the scanner can
    /// have moved where it fits the map worse than scans did lately.
    pub fn find(&mut self, told: Rigid2, motion: Motion, scan: Scan) -> Found {
        // 1. Predict.
        let weak = WeakDirection::of(scan.returns);
        let prediction = self.predicted(told, &motion, weak.as_ref());
        // 2. Search, and judge what is found.
        let balanced = weak.as_ref().map(|weak| weak.balanced(scan.returns));
        let cloud = balanced.as_ref().unwrap_or(scan.cloud);
        let window = self.window(&motion, &prediction);
        let near = self.search_hypotheses([prediction, told], motion, (&scan, cloud), window);
        let is_failing = motion.is_measured() && near.basis == Basis::WentOn;
        let told_motion = (motion.to(&prediction), motion.seconds);
        let measured = if is_failing { Measured::Nothing } else { motion.measured };
        let motion = Motion { measured, ..motion };
        let (found, judgement) = self.judged(&near, motion, (&scan, cloud), window);
        self.looked = None;
        let is_far = judgement == Judgement::Far;
        let has_caught_up = near.basis == Basis::CaughtUp;
        self.catching_up.add(told_motion, near.around, is_far && motion.is_measured(), has_caught_up);
        if let Some(score) = found.score {
            self.usual_score.add(score);
        }
        if !found.pose.is_finite() {
            let left_open = LeftOpen::Everything;
            let overrules_odometry = false;
            return Found {
                pose: prediction,
                is_far: false,
                overrules_odometry,
                tells_place: false,
                left_open,
                agreement: None,
            };
        }
        // 3. Weigh it with the prediction.
        let is_open = weak.is_some() || scan.witnesses.are_few();
        if !is_open {
            self.odometry_failure.add_pose(&found.pose);
        }
        // Found far off, the prediction was judged to be none.
        let weighed = weak.as_ref().filter(|_| !is_far);
        let (pose, left_open) = match judgement {
            // So few beams do not confirm a prediction that they were not believed against.
            Judgement::Predicted if scan.witnesses.are_few() => (found.pose, LeftOpen::Everything),
            _ => self.weigh(found.pose, near.around, motion, &scan, weighed, is_failing || is_far),
        };
        // 4. Learn how odometry and beams agree with it. Where scans leave a direction open, they do not say how far it went.
        let observability = match (is_open, is_far) {
            (false, _) => MotionObservability::Full,
            (true, false) => MotionObservability::Weak,
            (true, true) => MotionObservability::Guess,
        };
        self.odometry_failure.add_motion(&motion.to(&pose), motion.seconds, observability);
        if near.basis == Basis::Measured && !is_far && !is_open {
            let measured = motion.to(&told);
            let sigma = self.prediction_error.sigmas(&measured).translation;
            let moved = motion.of_tracking(&motion.to(&found.pose));
            self.odometry_scale.add(&motion.of_tracking(&measured), &moved, sigma);
        }
        let agreement = scan_agreement(&scan.submap.grid, &pose, scan.cloud);
        if let Some(agreement) = &agreement {
            self.beam_evidence.add(agreement);
        }
        let tells_place = !is_open || motion.is_measured();
        Found { pose, is_far, overrules_odometry: is_failing, tells_place, left_open, agreement }
    }

    /// How many times as far as scans odometry goes, if it is corrected by that.
    pub fn odometry_factor(&self) -> Option<f64> {
        self.odometry_scale.factor()
    }

    /// Where the scan is if odometry, which tells this, rather fails than works.
    pub fn suspected(&self, told: Rigid2, motion: Motion) -> Option<Rigid2> {
        self.odometry_failure.suspected(motion, &self.prior(self.predicted(told, &motion, None), motion))
    }

    /// Where the scan is by odometry that measured the motion.
    pub fn told_by_odometry(&self, told: Rigid2, motion: &Motion) -> Rigid2 {
        self.predicted(told, motion, None)
    }

    /// Where the scan is expected, told where odometry, or else the velocity, leads.
    fn predicted(&self, told: Rigid2, motion: &Motion, weak: Option<&WeakDirection>) -> Rigid2 {
        let prediction = match motion.measured {
            Measured::Whole => {
                let measured = motion.of_tracking(&motion.to(&told));
                motion.last * motion.of_aligned(&self.odometry_scale.corrected(&measured))
            }
            Measured::Rotation if motion.is_unknown() => Rigid2 { angle: told.angle, ..motion.last },
            Measured::Nothing if motion.is_unknown() => motion.last,
            Measured::Rotation | Measured::Nothing => told,
        };
        // Readings far apart tell nothing of turns and stops between them, but how far it went along a corridor.
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
        if let Some(looked) = self.looked.as_ref().filter(|l| l.around == around && l.window == window) {
            return looked.found;
        }
        let find = || self.matcher.match_scan(around, cloud, scan.returns, Some(scan.submap), Some(window));
        self.remembered.answer((around, window), find)
    }

    /// What the motion says of the pose of a scan.
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

    /// Weighs the match with the prediction where the scan tells little, and learns from both how far predictions are
    /// off where it tells enough. The pose, and what the prediction decided of it.
    fn weigh(
        &mut self,
        found: Rigid2,
        around: Rigid2,
        motion: Motion,
        scan: &Scan,
        weak: Option<&WeakDirection>,
        is_failing: bool,
    ) -> (Rigid2, LeftOpen) {
        let predicted_motion = motion.to(&around);
        if scan.witnesses.are_next_to_none() && !is_failing {
            return self.weigh_few(found, around, motion, scan);
        }
        let (mut pose, mut observed, mut left_open) = (found, found, LeftOpen::Nothing);
        if let Some(weak) = weak {
            let learned = self.prediction_error.sigmas(&predicted_motion).translation;
            let is_told = motion.is_measured() || motion.between_readings.is_some();
            let unmeasured = if is_told { 0.0 } else { ACCELERATION * motion.seconds.powi(2) };
            let gain =
                weak.gain(&scan.submap.grid, scan.returns, (&around, &found), learned.hypot(unmeasured));
            pose = weak.with_share(&around, &found, gain);
            observed = weak.with_share(&around, &found, 0.0);
            if !weak.is_told(scan, &pose, TOLD_WITHIN.linear) {
                left_open = LeftOpen::Along(weak.in_scan());
            }
        }
        if motion.seconds <= self.gap && !is_failing {
            self.prediction_error.add(&predicted_motion, &(around.inverse() * observed));
        }
        (pose, left_open)
    }

    /// Weighs a match of hardly any beams with the prediction. It tells how far predictions are off where most comes from it.
    fn weigh_few(
        &mut self,
        found: Rigid2,
        around: Rigid2,
        motion: Motion,
        scan: &Scan,
    ) -> (Rigid2, LeftOpen) {
        let share = scan.match_share(&self.prior(around, motion), &found);
        if motion.seconds <= self.gap && share > MOSTLY {
            self.prediction_error.add(&motion.to(&around), &(around.inverse() * found));
        }
        let pose = with_share(&around, &found, share);
        let SearchWindow { linear, angular } = TOLD_WITHIN;
        let offsets =
            [Rigid2::new(linear, 0.0, 0.0), Rigid2::new(0.0, linear, 0.0), Rigid2::new(0.0, 0.0, angular)];
        let weights = vec![1.0; scan.returns.points.len()];
        let is_told = offsets.iter().all(|offset| scan.tells(&pose, *offset, &weights));
        (pose, if is_told { LeftOpen::Nothing } else { LeftOpen::Everything })
    }

    /// As far as predictions of such a motion were wrong lately; where nothing measured it, no farther than a scanner can
    /// have accelerated to, however fast it goes.
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

    /// As far as predictions with these errors can be off.
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
