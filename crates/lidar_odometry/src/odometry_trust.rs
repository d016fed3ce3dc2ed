//! Whether odometry measures the motion or fails: wheels that slip, readings that stand still, other units or frames than said.
//!
//! Two models of the motion since the last sweep, as in "The interacting multiple model algorithm for systems with Markovian
//! switching coefficients" (Blom, Bar-Shalom, IEEE Transactions on Automatic Control 33, 1988): odometry measured it, or it is
//! what the platform did without any. Sweeps say which of the two predicts them, and the odds are carried on.

use portolan_geometry::{Rigid3, Vector3};

use crate::segment::TrajectorySegment;
use crate::settings::MotionPriorSettings;

/// Logarithm of the odds that odometry works before anything is known, and the most of them either way, so that a failure that
/// begins or ends is noticed within a few sweeps. Assumed, not measured.
const AT_FIRST: f64 = 3.0;
const MOST: f64 = 6.0;
/// A prediction that is farther off than this tells no more, nats: other things go wrong, too.
const OUTLIER: f64 = 8.0;
/// Predictions that differ by fewer standard deviations are one.
const DIFFERENT: f64 = 3.0;

/// What is believed of odometry.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OdometryTrust {
    log_odds: f64,
}

impl Default for OdometryTrust {
    fn default() -> Self {
        Self { log_odds: AT_FIRST }
    }
}

/// How far off predictions of a sweep's end may be, metres and radians along each axis.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Off {
    translation: f64,
    rotation: f64,
}

/// Where odometry says that a sweep ends, and where it ends without.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TwoMotions {
    measured: (Rigid3, Off),
    otherwise: (Rigid3, Off),
    /// Whether the rotation of both is a gyroscope's, so that it tells nothing of odometry.
    rotation_is_measured: bool,
}

impl TwoMotions {
    pub fn new(
        measured: &TrajectorySegment,
        otherwise: &TrajectorySegment,
        rotation_is_measured: bool,
        prior: &MotionPriorSettings,
    ) -> Self {
        let seconds = measured.seconds();
        let rotation = prior.least_rotation_error + 0.5 * prior.rotational_acceleration * seconds * seconds;
        let off = |translation| Off { translation: prior.least_translation_error + translation, rotation };
        Self {
            measured: (measured.end(), off(prior.odometry_drift * seconds)),
            otherwise: (otherwise.end(), off(prior.by_acceleration(seconds))),
            rotation_is_measured,
        }
    }

    /// Whether it matters which of the two holds.
    pub fn differ(&self) -> bool {
        let ((a, of_a), (b, of_b)) = (self.measured, self.otherwise);
        let metres = (a.translation.vector - b.translation.vector).norm();
        let radians = if self.rotation_is_measured { 0.0 } else { a.rotation.angle_to(&b.rotation) };
        metres > DIFFERENT * of_a.translation.hypot(of_b.translation)
            || radians > DIFFERENT * of_a.rotation.hypot(of_b.rotation)
    }

    /// Negative logarithm of how likely a prediction is where the sweep was found, up to a constant.
    fn surprise(&self, (predicted, off): &(Rigid3, Off), found: &Rigid3, open: &[Vector3]) -> f64 {
        let mut shift = found.translation.vector - predicted.translation.vector;
        open.iter().for_each(|direction| shift -= direction.dot(&shift) * direction);
        let turn = if self.rotation_is_measured { 0.0 } else { predicted.rotation.angle_to(&found.rotation) };
        let squares = (shift.norm() / off.translation).powi(2) + (turn / off.rotation).powi(2);
        let told = 3 - open.len().min(3);
        (0.5 * squares).min(OUTLIER) + told as f64 * off.translation.ln()
    }
}

impl OdometryTrust {
    /// Whether odometry rather works.
    pub fn works(&self) -> bool {
        self.log_odds > 0.0
    }

    /// Takes where a sweep was found, and the directions that it left open, orthonormal, both in the local map. Where the two
    /// predict the same nothing is learned.
    pub fn learn(&mut self, motions: &TwoMotions, found: &Rigid3, open: &[Vector3]) {
        if !motions.differ() {
            return;
        }
        let odds = motions.surprise(&motions.otherwise, found, open)
            - motions.surprise(&motions.measured, found, open);
        self.log_odds = (self.log_odds + odds).clamp(-MOST, MOST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::OdometrySettings;
    use portolan_geometry::{Duration, Time};

    /// What is believed after so many sweeps of 0.1 s that moved so far, where odometry said and without it was expected.
    fn works_after(sweeps: usize, moved: f64, measured: f64, otherwise: f64) -> bool {
        works_where(sweeps, moved, measured, otherwise, &[])
    }

    fn works_where(sweeps: usize, moved: f64, measured: f64, otherwise: f64, open: &[Vector3]) -> bool {
        let prior = OdometrySettings::default().motion_prior;
        let at = |x: f64| Rigid3::translation(x, 0.0, 0.0);
        let (start, end) = (Time::from_ticks(0), Time::from_ticks(0) + Duration::from_seconds(0.1));
        let segment =
            |x: f64| TrajectorySegment::new(start, end, |time| if time == end { at(x) } else { at(0.0) });
        let motions = TwoMotions::new(&segment(measured), &segment(otherwise), true, &prior);
        let mut trust = OdometryTrust::default();
        (0..sweeps).for_each(|_| trust.learn(&motions, &at(moved), open));
        trust.works()
    }

    #[test]
    fn wheels_that_stand_while_sweeps_move_are_not_believed() {
        assert!(!works_after(1, 1.2, 0.0, 1.19), "a car");
        assert!(!works_after(3, 0.15, 0.0, 0.14), "somebody who walks");
        assert!(!works_after(1, 1.2, 120.0, 1.21), "in other units");
    }

    #[test]
    fn odometry_is_believed_where_it_predicts_better_or_nothing_differs() {
        assert!(works_after(100, 1.2, 1.19, 1.21));
        assert!(works_after(100, 0.2, 0.21, 0.5), "a push, which constant velocity does not know");
        assert!(
            works_where(100, 1.2, 0.0, 1.19, &[Vector3::x()]),
            "along a tunnel, which tells nothing of it"
        );
    }
}
