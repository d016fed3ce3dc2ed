//! Learns the errors of predictions from matched scans.
//!
//! The error of a prediction grows with the predicted motion. Its factor is estimated from the innovations
//! (corrections of predictions by matching), which have the covariance of the prediction where scans
//! constrain the pose well (covariance matching).

use portolan_geometry::Rigid2;
use portolan_numeric::CovarianceMatching;

/// Standard deviations of a prediction: metres and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictionSigmas {
    /// Along each axis, metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
}

/// Errors assumed before anything was learned: at rest (encoders, uneven time stamps), and for each metre
/// and radian.
const AT_REST: PredictionSigmas = PredictionSigmas { translation: 0.02, rotation: 0.01 };
const PER_METRE: PredictionSigmas = PredictionSigmas { translation: 0.05, rotation: 0.02 };
const PER_RADIAN: PredictionSigmas = PredictionSigmas { translation: 0.05, rotation: 0.05 };
/// Time constant of the statistics, scans.
const MEMORY: f64 = 50.0;
/// Limits of the factor.
const FACTORS: (f64, f64) = (0.5, 6.0);

/// Learned factors of the assumed errors.
#[derive(Clone, Copy, Debug)]
pub struct PredictionError {
    translation: CovarianceMatching,
    rotation: CovarianceMatching,
}

impl Default for PredictionError {
    fn default() -> Self {
        let as_assumed = CovarianceMatching::new(MEMORY);
        Self { translation: as_assumed, rotation: as_assumed }
    }
}

impl PredictionError {
    /// Expected error of a predicted motion.
    pub fn sigmas(&self, motion: &Rigid2) -> PredictionSigmas {
        let expected = expected(motion);
        let factor = |learned: &CovarianceMatching| learned.sigma_factor().clamp(FACTORS.0, FACTORS.1);
        PredictionSigmas {
            translation: factor(&self.translation) * expected.translation,
            rotation: factor(&self.rotation) * expected.rotation,
        }
    }

    /// Updates the factors by the innovation of a predicted motion.
    pub fn add(&mut self, motion: &Rigid2, innovation: &Rigid2) {
        let expected = expected(motion);
        // The length of the offset is of two axes.
        let along_each_axis = innovation.translation.norm() / std::f64::consts::SQRT_2;
        self.translation.add((along_each_axis / expected.translation).powi(2));
        self.rotation.add((innovation.angle / expected.rotation).powi(2));
    }
}

fn expected(motion: &Rigid2) -> PredictionSigmas {
    let (metres, radians) = (motion.translation.norm(), motion.angle.abs());
    PredictionSigmas {
        translation: AT_REST.translation + PER_METRE.translation * metres + PER_RADIAN.translation * radians,
        rotation: AT_REST.rotation + PER_METRE.rotation * metres + PER_RADIAN.rotation * radians,
    }
}

/// Fit of recent scans: mean and standard deviation of their scores.
#[derive(Clone, Copy, Debug, Default)]
pub struct UsualScore {
    scans: f64,
    mean: f64,
    variance: f64,
}

/// Number of standard deviations below the mean from which on a score is low.
const LOW_SIGMAS: f64 = 2.5;
/// Minimum number of scans before a score counts as low.
const ENOUGH_SCANS: f64 = 10.0;

impl UsualScore {
    /// Whether a score is significantly lower than those of recent scans.
    pub fn is_low(&self, score: f32) -> bool {
        self.scans >= ENOUGH_SCANS && f64::from(score) < self.mean - LOW_SIGMAS * self.variance.sqrt()
    }

    /// Adds the score of one more scan.
    pub fn add(&mut self, score: f32) {
        self.scans = (self.scans + 1.0).min(MEMORY);
        let difference = f64::from(score) - self.mean;
        self.mean += difference / self.scans;
        self.variance += (difference * difference * (1.0 - 1.0 / self.scans) - self.variance) / self.scans;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector2;

    fn motion(x: f64, y: f64, angle: f64) -> Rigid2 {
        Rigid2 { translation: Vector2::new(x, y), angle }
    }

    #[test]
    fn the_factor_follows_innovations_and_not_a_single_slip() {
        let (step, mut error) = (motion(0.5, 0.0, 0.1), PredictionError::default());
        let before = error.sigmas(&step);
        error.add(&step, &motion(9.0, 0.0, 3.0));
        assert!(error.sigmas(&step).translation < 1.2 * before.translation);
        for i in 0..300 {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            error.add(&step, &motion(0.15 * sign, 0.15 * sign, 0.05 * sign));
        }
        let learned = error.sigmas(&step);
        assert!((learned.translation - 0.15).abs() < 0.01, "{learned:?}");
        assert!((learned.rotation - 0.05).abs() < 0.005, "{learned:?}");
        assert!(error.sigmas(&motion(2.0, 0.0, 0.0)).translation > 2.0 * learned.translation);
    }
}
