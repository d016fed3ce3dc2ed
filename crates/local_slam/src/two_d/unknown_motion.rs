//! Prior of a motion that was unmeasured for so long that the previous velocity says little about it.
//!
//! The prior is a mixture of three cases: the scanner has stopped at its last pose, it has gone on at
//! constant velocity, or it is anywhere within reach.

use std::f64::consts::{PI, TAU};

use portolan_geometry::Rigid2;

use super::motion::{FASTEST, Motion};
use super::posterior::normal_density;
use super::prediction_error::PredictionSigmas;

/// Probability of each of the three cases: stopped, gone on, or neither.
const EACH: f64 = 1.0 / 3.0;
/// Standard deviations of the pose if the scanner has stopped, metres and radians.
const STANDING: PredictionSigmas = PredictionSigmas { translation: 0.05, rotation: 0.05 };
/// Standard deviation of the motion, as a fraction of it, if the scanner has gone on; dimensionless.
const SHARE: f64 = 0.1;

/// Prior density of poses.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnknownMotion {
    stopped: Rigid2,
    went_on: Rigid2,
    /// Standard deviations of the pose `went_on`.
    sigmas: PredictionSigmas,
    /// Density of the third case, anywhere within reach, 1/(m² rad).
    anywhere: f64,
}

impl UnknownMotion {
    /// Prior of a scanner that has stopped at the pose `stopped` or has reached the pose `went_on`.
    pub fn new(motion: &Motion, stopped: Rigid2, went_on: Rigid2) -> Self {
        let way = motion.to(&went_on);
        let sigmas = PredictionSigmas {
            translation: STANDING.translation + SHARE * way.translation.norm(),
            rotation: STANDING.rotation + SHARE * way.angle.abs(),
        };
        let reach = FASTEST.linear * motion.seconds;
        Self { stopped, went_on, sigmas, anywhere: 1.0 / (PI * reach * reach * TAU) }
    }

    /// Logarithm of the density of a pose, 1/(m² rad).
    pub fn log_density(&self, pose: &Rigid2) -> f64 {
        let stands = normal_density(&(self.stopped.inverse() * *pose), STANDING);
        let has_gone_on = normal_density(&(self.went_on.inverse() * *pose), self.sigmas);
        (EACH * (stands + has_gone_on + self.anywhere)).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_stands_or_goes_on_rather_than_anything_else() {
        let motion = Motion { measured: super::super::motion::Measured::Nothing, ..Motion::measured(8.0) };
        let went_on = Rigid2::new(2.4, 0.0, 0.0);
        let unknown = UnknownMotion::new(&motion, Rigid2::identity(), went_on);
        let at = |x: f64, y: f64, degrees: f64| unknown.log_density(&Rigid2::new(x, y, degrees.to_radians()));
        assert!(at(0.0, 0.0, 0.0) > at(2.3, 0.1, 4.0) && at(2.3, 0.1, 4.0) > at(1.0, 1.0, 0.0) + 4.0);
        // Half a turn in a corridor that looks the same takes better evidence, but not infinitely better.
        assert!((4.0..12.0).contains(&(at(2.3, 0.1, 4.0) - at(2.3, 0.1, 180.0))));
        assert!((at(-5.0, 2.0, 90.0) - at(1.0, 8.0, 10.0)).abs() < 1e-6);
    }
}
