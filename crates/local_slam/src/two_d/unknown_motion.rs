//! Prior of a motion that was unmeasured for so long that the previous velocity predicts it poorly.
//!
//! The prior is a mixture of three cases: the scanner has stopped at its last pose, it has continued at
//! constant velocity, or it is anywhere within reach.

use std::f64::consts::{PI, TAU};

use portolan_geometry::Rigid2;

use super::motion::{FASTEST, Motion};
use super::posterior::normal_density;
use super::prediction_error::PredictionSigmas;

/// Probability of each of the three cases: stopped, continued, or neither.
const EACH: f64 = 1.0 / 3.0;
/// Standard deviations of the pose if the scanner has stopped, metres and radians.
const STANDING: PredictionSigmas = PredictionSigmas { translation: 0.05, rotation: 0.05 };
/// Standard deviation of the motion, as a fraction of it, if the scanner has continued; dimensionless.
const SHARE: f64 = 0.1;

/// Prior density of poses.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnknownMotion {
    stopped: Rigid2,
    constant_velocity: Rigid2,
    /// Standard deviations of the pose `constant_velocity`.
    sigmas: PredictionSigmas,
    /// Density of the third case, anywhere within reach, 1/(m² rad).
    anywhere: f64,
}

impl UnknownMotion {
    /// Prior of a scanner that has stopped at the pose `stopped` or has reached the pose `constant_velocity`.
    pub fn new(motion: &Motion, stopped: Rigid2, constant_velocity: Rigid2) -> Self {
        let moved = motion.to(&constant_velocity);
        let sigmas = PredictionSigmas {
            translation: STANDING.translation + SHARE * moved.translation.norm(),
            rotation: STANDING.rotation + SHARE * moved.angle.abs(),
        };
        let reach = FASTEST.linear * motion.seconds;
        Self { stopped, constant_velocity, sigmas, anywhere: 1.0 / (PI * reach * reach * TAU) }
    }

    /// Logarithm of the density of a pose, 1/(m² rad).
    pub fn log_density(&self, pose: &Rigid2) -> f64 {
        let stands = normal_density(&(self.stopped.inverse() * *pose), STANDING);
        let continues = normal_density(&(self.constant_velocity.inverse() * *pose), self.sigmas);
        (EACH * (stands + continues + self.anywhere)).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stopping_and_constant_velocity_are_likelier_than_other_motions() {
        let motion = Motion { measured: super::super::motion::Measured::Nothing, ..Motion::measured(8.0) };
        let constant_velocity = Rigid2::new(2.4, 0.0, 0.0);
        let unknown = UnknownMotion::new(&motion, Rigid2::identity(), constant_velocity);
        let at = |x: f64, y: f64, degrees: f64| unknown.log_density(&Rigid2::new(x, y, degrees.to_radians()));
        assert!(at(0.0, 0.0, 0.0) > at(2.3, 0.1, 4.0) && at(2.3, 0.1, 4.0) > at(1.0, 1.0, 0.0) + 4.0);
        // Half a turn in a corridor that looks the same takes better evidence, but not infinitely better.
        assert!((4.0..12.0).contains(&(at(2.3, 0.1, 4.0) - at(2.3, 0.1, 180.0))));
        assert!((at(-5.0, 2.0, 90.0) - at(1.0, 8.0, 10.0)).abs() < 1e-6);
    }
}
