//! Records the directions that scans do not constrain as degenerate intervals, and guesses of the motion.

use std::f64::consts::PI;

use portolan_geometry::{Duration, Rigid2, Time, Vector2, Vector3};
use portolan_motion::{DegenerateScan, Substitute};

use super::super::motion::{FASTEST, Measured, Motion};
use super::super::tracking::{Degeneracy, Found};
use super::super::unmeasured_travel::Velocity;
use super::FrontEnd;
use super::one_scan::Expected;

/// Minimum time between scans, seconds.
const LEAST_INTERVAL: f64 = 1e-3;

fn embedded(in_2d: Vector2) -> Vector3 {
    Vector3::new(in_2d.x, in_2d.y, 0.0)
}

impl FrontEnd {
    /// Adds the degenerate directions of a scan to the degenerate intervals.
    pub(super) fn record_degeneracy(&mut self, time: Time, expected: &Expected, found: &Found) {
        let Some(motion) = &expected.motion else { return };
        let unmeasured = self.record_unmeasured(time, motion, found);
        let seconds = motion.seconds;
        self.degenerate.moved(&embedded(motion.to(&found.pose).translation), seconds, &Vector3::z());
        let (of_translation, of_rotation) = match motion.measured {
            Measured::Whole => (Substitute::Odometry, Substitute::Odometry),
            Measured::Rotation => (Substitute::Velocity, Substitute::Gyroscope),
            Measured::Nothing => (Substitute::Velocity, Substitute::Velocity),
        };
        let sigmas = self.tracker.prior(expected.prediction, *motion).sigmas;
        // After a long time the acceleration would explain more motion than a robot is capable of.
        let (metres, radians) = (FASTEST.linear * seconds, (FASTEST.angular * seconds).min(PI));
        let shift = unmeasured.unwrap_or(sigmas.translation).min(metres);
        let turned = sigmas.rotation.min(radians);
        let translation = DegenerateScan { time, seconds, taken: of_translation, sigma: Some(shift) };
        let rotation = DegenerateScan { time, seconds, taken: of_rotation, sigma: Some(turned) };
        match found.degeneracy {
            Degeneracy::None => {}
            Degeneracy::Direction(direction) => {
                self.gathered.translation += shift.powi(2);
                self.degenerate.add_translations(&translation, &[embedded(direction)], &Vector3::z());
            }
            Degeneracy::Full => {
                self.gathered.translation += shift.powi(2);
                self.gathered.rotation += turned.powi(2);
                let in_2d = [Vector3::x(), Vector3::y()];
                self.degenerate.add_translations(&translation, &in_2d, &Vector3::z());
                self.degenerate.add_rotations(&rotation, &[Vector3::z()], &Vector3::z());
            }
        }
    }

    /// Standard deviation that the last step adds to the distance travelled, metres, if it is a guess.
    fn record_unmeasured(&mut self, time: Time, motion: &Motion, found: &Found) -> Option<f64> {
        let seconds = motion.seconds.max(LEAST_INTERVAL);
        let velocity = Velocity {
            speed: motion.to(&found.pose).translation.norm() / seconds,
            sigma: self.tracker.sigmas(&Rigid2::identity()).translation / seconds,
        };
        // A stop that is seen where the motion is unobservable may be none; a platform that rested before
        // still does.
        let still_rests = velocity.is_rest() && self.unmeasured_travel.rested();
        if still_rests || motion.is_measured() || found.degeneracy == Degeneracy::None {
            self.unmeasured_travel.add_measured(time, &found.pose, velocity);
            return None;
        }
        let before = self.unmeasured_travel.sigma(time - Duration::from_seconds(motion.seconds));
        self.unmeasured_travel.add_unmeasured(time);
        let sigma = self.unmeasured_travel.sigma(time);
        Some((sigma.powi(2) - before.powi(2)).max(0.0).sqrt())
    }
}
