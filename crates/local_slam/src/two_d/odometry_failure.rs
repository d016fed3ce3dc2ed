//! Detects temporary failures of odometry: wheels that stall, slip or are lifted, readings that stand
//! still.
//!
//! There are two models of the motion since the last scan: odometry measured it, or odometry fails and the
//! velocity is constant. Where a failure is not improbable, the scan is matched with both, and the
//! posteriors of motion and map decide. The probability of failing is carried from scan to scan, since
//! failures last (switching models: Blom, Bar-Shalom, "The interacting multiple model algorithm for
//! systems with Markovian switching coefficients", IEEE Transactions on Automatic Control 33, 1988).

use portolan_geometry::{Rigid2, normalize_angle};

use super::motion::{
    ACCELERATION, ANGULAR_ACCELERATION, FASTEST, LONGEST_MEASURED, Motion, reached_by_acceleration,
};
use super::posterior::{MotionPrior, anywhere_density, normal_density};
use super::prediction_error::PredictionSigmas;

/// Probability that odometry begins to fail between two scans.
const BEGINS: f64 = 0.003;
/// Probability that a failure lasts until the next scan.
const LASTS: f64 = 0.95;
/// Probability that the velocity changes at once, as when the scanner is pushed.
const CHANGES: f64 = 0.003;
/// Probability that it changes by more than any acceleration allows, as in a collision.
const IS_HIT: f64 = 3e-6;
/// Probabilities that failing odometry stands still and that it slips; else its reading is arbitrary.
const STANDS: f64 = 0.5;
const SLIPS: f64 = 0.25;
/// Standard deviations of the motion reported by slipping wheels, metres and radians.
const OF_SLIPS: PredictionSigmas = PredictionSigmas { translation: 0.3, rotation: 0.3 };
/// Maximum errors, in standard deviations, for a change of velocity to be possible.
const WITHIN_SIGMAS: f64 = 3.0;
/// Probability of a failure below which its model is not tracked.
const IMPROBABLE: f64 = 0.03;
/// Standard deviations of the motion between two matched scans, metres and radians.
const OF_MATCHES: PredictionSigmas = PredictionSigmas { translation: 0.02, rotation: 0.01 };

/// Probability that odometry fails, and the last motion of the scanner.
#[derive(Clone, Copy, Debug)]
pub(super) struct OdometryFailure {
    /// Probability that it fails, before the next reading is considered.
    failing: f64,
    last: Option<LastMotion>,
    /// Priors of the next scan by both models, if a failure is too improbable for a search there.
    unfollowed: Option<Expected>,
}

/// The last motion by matched scans.
#[derive(Clone, Copy, Debug)]
struct LastMotion {
    moved: Rigid2,
    seconds: f64,
    /// Standard deviation of its translation beyond that of matches, metres, from degenerate directions.
    open: f64,
}

/// How well a scan constrains the motion since the last one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MotionObservability {
    Full,
    /// It has a degenerate direction or few independent measurements: most of the motion comes from the
    /// prediction.
    Weak,
    /// The same, and the match was far from the prediction: the motion is a guess.
    Guess,
}

/// Priors of the pose of the next scan by both models.
#[derive(Clone, Copy, Debug)]
struct Expected {
    works: MotionPrior,
    fails: MotionPrior,
    log_odds: f64,
}

impl Default for OdometryFailure {
    fn default() -> Self {
        Self { failing: BEGINS, last: None, unfollowed: None }
    }
}

impl OdometryFailure {
    /// State while the scanner has this motion over this time, seconds, against odometry.
    pub fn while_moving(moved: &Rigid2, seconds: f64) -> Self {
        Self {
            failing: LASTS,
            last: Some(LastMotion { moved: *moved, seconds, open: 0.0 }),
            unfollowed: None,
        }
    }

    /// Takes the match of a scan without degenerate directions. Odometry that is many standard deviations
    /// off there fails, although its reading was plausible by itself.
    pub fn add_pose(&mut self, pose: &Rigid2) {
        if let Some(expected) = self.unfollowed.take() {
            let odds = expected.fails.log_density(pose) - expected.works.log_density(pose);
            self.failing = after(expected.log_odds + odds);
        }
    }

    /// Takes the motion of the scanner, and how well the scan constrained it.
    pub fn add_motion(&mut self, moved: &Rigid2, seconds: f64, observability: MotionObservability) {
        let before = self.last.map_or(0.0, |last| last.open * seconds / last.seconds);
        let open = match observability {
            MotionObservability::Full => 0.0,
            MotionObservability::Weak => before.hypot(ACCELERATION * seconds.powi(2)),
            MotionObservability::Guess => FASTEST.linear * seconds,
        };
        let is_known = seconds > 0.0 && seconds <= LONGEST_MEASURED;
        self.last = is_known.then_some(LastMotion { moved: *moved, seconds, open });
    }

    /// Takes the motion by odometry. Gives the prior of the pose if odometry fails, and the logarithm of
    /// the odds of a failure; none where it is improbable or the velocity is unknown.
    pub fn add_measured(&mut self, motion: Motion, measured: &MotionPrior) -> Option<(MotionPrior, f64)> {
        self.unfollowed = None;
        let expected = self.expected(motion, measured)?;
        let Expected { fails, log_odds, .. } = expected;
        self.failing = after(log_odds);
        if probability(log_odds) > IMPROBABLE {
            return Some((fails, log_odds));
        }
        self.unfollowed = Some(expected);
        None
    }

    /// Pose of the scanner without odometry, if the reading alone, before the scan is matched, makes a
    /// failure more likely than not.
    pub fn suspected(&self, motion: Motion, measured: &MotionPrior) -> Option<Rigid2> {
        let expected = self.expected(motion, measured)?;
        (expected.log_odds > 0.0).then_some(expected.fails.prediction)
    }

    fn expected(&self, motion: Motion, measured: &MotionPrior) -> Option<Expected> {
        let LastMotion { moved, seconds, open } = self.last?;
        if !motion.is_measured() || motion.seconds > LONGEST_MEASURED {
            return None;
        }
        let share = motion.seconds / seconds;
        let translation = moved.translation * share;
        let prediction = motion.last * Rigid2 { translation, angle: moved.angle * share };
        let square = motion.seconds.powi(2);
        let sigmas = PredictionSigmas {
            translation: (OF_MATCHES.translation * (1.0 + share))
                .hypot(ACCELERATION * square)
                .hypot(open * share),
            rotation: (OF_MATCHES.rotation * (1.0 + share)).hypot(ANGULAR_ACCELERATION * square),
        };
        let both = PredictionSigmas {
            translation: sigmas.translation.hypot(measured.sigmas.translation),
            rotation: sigmas.rotation.hypot(measured.sigmas.rotation),
        };
        let beside = |pose: Rigid2| normal_density(&(pose.inverse() * measured.prediction), both);
        let slip = PredictionSigmas {
            translation: both.translation.hypot(OF_SLIPS.translation),
            rotation: both.rotation.hypot(OF_SLIPS.rotation),
        };
        let slips = normal_density(&(prediction.inverse() * measured.prediction), slip);
        let anything =
            STANDS * beside(motion.last) + SLIPS * slips + (1.0 - STANDS - SLIPS) * anywhere_density();
        let change = prediction.inverse() * measured.prediction;
        let reach = reached_by_acceleration(motion.seconds);
        let is_possible = change.translation.norm() <= reach.linear + WITHIN_SIGMAS * both.translation
            && normalize_angle(change.angle).abs() <= reach.angular + WITHIN_SIGMAS * both.rotation;
        let changes = if is_possible { CHANGES } else { IS_HIT };
        let works = (1.0 - changes) * beside(prediction) + changes * anything;
        let log_odds = (self.failing / (1.0 - self.failing)).ln() + (anything / works).ln();
        Some(Expected { works: *measured, fails: MotionPrior { prediction, sigmas }, log_odds })
    }

    /// Whether odometry fails, from the logarithm of its odds by the prior and the match.
    pub fn fails(&mut self, log_odds: f64) -> bool {
        self.failing = after(log_odds);
        log_odds > 0.0
    }
}

fn probability(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

/// Probability that odometry fails at the next scan.
fn after(log_odds: f64) -> f64 {
    let fails = probability(log_odds);
    LASTS * fails + BEGINS * (1.0 - fails)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECONDS: f64 = 0.2;
    const SIGMAS: PredictionSigmas = PredictionSigmas { translation: 0.02, rotation: 0.01 };

    /// Result of one scan if odometry measured `metres` after the scanner had moved by `moved`, metres, in
    /// the interval before.
    fn measured(failure: &mut OdometryFailure, moved: f64, metres: f64) -> Option<(MotionPrior, f64)> {
        measured_after(failure, (moved, MotionObservability::Full), metres)
    }

    fn measured_after(
        failure: &mut OdometryFailure,
        (moved, observability): (f64, MotionObservability),
        metres: f64,
    ) -> Option<(MotionPrior, f64)> {
        failure.add_motion(&Rigid2::new(moved, 0.0, 0.0), SECONDS, observability);
        let motion = Motion::measured(SECONDS);
        failure
            .add_measured(motion, &MotionPrior { prediction: Rigid2::new(metres, 0.0, 0.0), sigmas: SIGMAS })
    }

    #[test]
    fn stalled_wheels_keep_failing_while_scans_contradict_them() {
        let mut failure = OdometryFailure::default();
        let (constant_velocity, log_odds) =
            measured(&mut failure, 0.25, 0.0).expect("a sudden stop is suspect");
        assert!((constant_velocity.prediction.translation.x - 0.25).abs() < 1e-12);
        assert!(log_odds.abs() < 2.0, "{log_odds}");
        assert!(failure.fails(log_odds + 5.0));
        // The scanner slows down: both models are tracked although they nearly agree.
        let (_, log_odds) = measured(&mut failure, 0.05, 0.0).expect("failures last");
        assert!(log_odds > 1.0, "{log_odds}");
    }

    #[test]
    fn sudden_stops_at_the_speed_of_a_car_are_suspect() {
        let suspected = |moved: f64, metres: f64| {
            let mut failure = OdometryFailure::default();
            failure.add_motion(&Rigid2::new(moved, 0.0, 0.0), SECONDS, MotionObservability::Full);
            let prediction = Rigid2::new(metres, 0.0, 0.0);
            failure.suspected(Motion::measured(SECONDS), &MotionPrior { prediction, sigmas: SIGMAS })
        };
        assert_eq!(suspected(2.6, 0.0).map(|pose| pose.translation.x), Some(2.6));
        assert_eq!((suspected(2.6, 2.5), suspected(0.25, 0.24), suspected(0.0, 0.1)), (None, None, None));
    }

    #[test]
    fn odometry_that_agrees_with_scans_works() {
        let mut failure = OdometryFailure::default();
        let (_, log_odds) = measured(&mut failure, 0.25, 0.0).expect("a sudden stop is suspect");
        assert!(failure.fails(log_odds + 5.0));
        let suspected = measured(&mut failure, 0.25, 0.26);
        assert!(suspected.is_none_or(|(_, log_odds)| log_odds < -3.0), "{suspected:?}");
        assert!(measured(&mut failure, 0.25, 0.24).is_none());
    }

    #[test]
    fn slipping_wheels_are_detected_from_the_matched_pose() {
        let mut failure = OdometryFailure::default();
        // The reading is plausible as a push.
        assert!(measured(&mut failure, 0.26, 0.48).is_none());
        assert!(failure.failing < 0.1, "{failure:?}");
        failure.add_pose(&Rigid2::new(0.26, 0.0, 0.0));
        assert!(failure.failing > 0.9, "{failure:?}");
        assert!(measured(&mut failure, 0.26, 0.1).is_some());
    }

    #[test]
    fn standing_and_gentle_braking_are_no_failure() {
        let mut failure = OdometryFailure::default();
        for metres in [0.25, 0.22, 0.18, 0.14, 0.1, 0.06, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0] {
            assert!(measured(&mut failure, metres, metres).is_none(), "{metres}");
        }
    }

    #[test]
    fn a_velocity_from_degenerate_scans_is_weak_evidence() {
        let odds = |observabilities: [MotionObservability; 3]| {
            let mut failure = OdometryFailure::default();
            let (_, log_odds) = measured(&mut failure, 0.25, 0.0).expect("a sudden stop is suspect");
            assert!(failure.fails(log_odds + 5.0));
            observabilities.map(|observability| {
                measured_after(&mut failure, (0.4, observability), 0.07)
                    .map(|(prior, odds)| (prior.sigmas.translation, odds))
            })
        };
        let [.., well] = odds([MotionObservability::Full; 3]).map(Option::unwrap);
        let [.., open] =
            odds([MotionObservability::Guess, MotionObservability::Weak, MotionObservability::Weak])
                .map(Option::unwrap);
        assert!(well.0 < 0.06 && open.0 > 0.4, "{well:?} {open:?}");
        assert!(open.1 < well.1 - 1.0, "{well:?} {open:?}");
    }

    #[test]
    fn an_old_velocity_is_no_evidence() {
        let mut failure = OdometryFailure::default();
        failure.add_motion(&Rigid2::new(1.0, 0.0, 0.0), 2.0, MotionObservability::Full);
        let motion = Motion::measured(SECONDS);
        let standing = MotionPrior { prediction: Rigid2::identity(), sigmas: SIGMAS };
        assert!(failure.add_measured(motion, &standing).is_none());
    }
}
