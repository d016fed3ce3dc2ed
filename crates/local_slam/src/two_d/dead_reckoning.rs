//! Dead reckoning by odometry alone, while scans fit nowhere in the map.
//!
//! Scans that do not fit have one of three causes: the scanner was carried elsewhere, the map is wrong
//! here, or the last scans were matched at a wrong place. In the last two cases odometry still measures
//! the motion of the scanner. It does not measure being carried: the wheels stand still then, or the
//! odometry jumps.

use portolan_geometry::Rigid2;

use super::motion::{FASTEST, Motion};
use super::prediction_error::PredictionSigmas;
use crate::OdometryBridge;

/// Total motion, metres and radians, below which odometry counts as standing still although the scans
/// changed.
const STANDING: (f64, f64) = (0.1, 0.1);

/// Dead reckoning since the last scan that fitted.
#[derive(Clone, Copy, Debug)]
pub(super) struct DeadReckoning {
    /// Pose of the tracking frame in the local map.
    pose: Rigid2,
    /// Variances of the errors of all steps: metres² along each axis, radians².
    translation_variance: f64,
    rotation_variance: f64,
    /// Total distance travelled and total rotation, metres and radians.
    moved: (f64, f64),
    /// Whether odometry measured every step, and no step was faster than a robot moves.
    is_whole: bool,
}

impl DeadReckoning {
    /// Starts at the pose of a matched scan.
    pub fn from(pose: Rigid2) -> Self {
        Self { pose, translation_variance: 0.0, rotation_variance: 0.0, moved: (0.0, 0.0), is_whole: true }
    }

    /// Adds the motion of the tracking frame to the next scan as odometry measured it, with its standard
    /// deviations.
    pub fn add(&mut self, motion: &Motion, step: &Rigid2, sigmas: PredictionSigmas) {
        let (length, turn) = (step.translation.norm(), step.normalized_angle().abs());
        let seconds = motion.seconds;
        self.is_whole &= motion.is_measured()
            && length <= FASTEST.linear * seconds + STANDING.0
            && turn <= FASTEST.angular * seconds + STANDING.1;
        self.translation_variance += sigmas.translation.powi(2) + length * length * self.rotation_variance;
        self.rotation_variance += sigmas.rotation.powi(2);
        self.moved = (self.moved.0 + length, self.moved.1 + turn);
        self.pose = self.pose * *step;
    }

    /// The pose by odometry and its uncertainty; none where odometry does not measure it.
    pub fn bridge(&self) -> Option<(Rigid2, OdometryBridge)> {
        let has_moved = self.moved.0 > STANDING.0 || self.moved.1 > STANDING.1;
        let bridge = OdometryBridge {
            translation: self.translation_variance.sqrt(),
            rotation: self.rotation_variance.sqrt(),
            is_contradicted: true,
        };
        (self.is_whole && has_moved).then_some((self.pose, bridge))
    }
}

#[cfg(test)]
mod tests {
    use super::super::motion::Measured;
    use super::*;

    const SIGMAS: PredictionSigmas = PredictionSigmas { translation: 0.02, rotation: 0.01 };

    fn after(steps: &[(f64, f64)], motion: Motion) -> Option<(Rigid2, OdometryBridge)> {
        let mut reckoned = DeadReckoning::from(Rigid2::new(1.0, 2.0, 0.0));
        for (metres, radians) in steps {
            reckoned.add(&motion, &Rigid2::new(*metres, 0.0, *radians), SIGMAS);
        }
        reckoned.bridge()
    }

    #[test]
    fn errors_of_steps_add_up_and_turns_make_the_position_uncertain() {
        let (pose, bridge) = after(&[(0.2, 0.0); 25], Motion::measured(0.2)).unwrap();
        assert!((pose.translation.x - 6.0).abs() < 1e-12 && (pose.translation.y - 2.0).abs() < 1e-12);
        assert!((bridge.rotation - 0.05).abs() < 1e-12, "{bridge:?}");
        assert!((0.1..0.2).contains(&bridge.translation), "{bridge:?}");
        let (_, turned) = after(&[(0.0, 0.4); 25], Motion::measured(0.2)).unwrap();
        assert!((turned.translation - 0.1).abs() < 1e-12, "{turned:?}");
    }

    #[test]
    fn stationary_jumping_or_missing_odometry_gives_no_bridge() {
        let motion = Motion::measured(0.2);
        assert!(after(&[(0.001, 0.0); 10], motion).is_none());
        assert!(after(&[(0.1, 0.0), (3.0, 0.0), (0.1, 0.0)], motion).is_none());
        assert!(after(&[(0.1, 0.0); 10], Motion { measured: Measured::Rotation, ..motion }).is_none());
    }
}
