//! Which of several poses a scan was taken at: maximum a posteriori (Bayes) of the agreement of its beams
//! with the map and of the motion prior.
//!
//! The prior is a mixture: the predicted motion with its learned errors, or, seldom, a slip, a stall, a
//! push or a jump of the odometry, after which the scanner may be anywhere within reach. So a pose far
//! from the prediction needs much better evidence than one nearby, but not infinitely much. Beams are not
//! independent: neighbours hit the same person or wall. A scan counts as as many independent measurements
//! as its [`IndependentMeasurements`].

use std::f64::consts::TAU;

use portolan_geometry::{Rigid2, normalize_angle};
use portolan_grids::ScanAgreement;

use super::independent_measurements::IndependentMeasurements;
use super::prediction_error::PredictionSigmas;

/// Evidence of an explained beam for a pose, and of a contradicted beam against it, nats. At a correct
/// pose four of five beams are explained and one of twelve is contradicted; at a wrong pose a quarter and
/// a half.
const EXPLAINED: f64 = 1.2;
const CONTRADICTED: f64 = 1.8;
/// Fraction of beams that end in free space, at correct and at wrong poses.
const IN_FREE_SPACE: (f64, f64) = (1.0 / 12.0, 0.5);
/// Fraction of beams that the map must know for a scan to update the statistics of agreement;
/// dimensionless.
const KNOWN: f32 = 0.5;
/// Time constant of the fraction of beams that end in free space, scans: it depends on the number of
/// people.
const SCANS: f64 = 5.0;
/// Probability that the learned errors do not explain the motion.
const OUTLIER: f64 = 0.003;
/// Range of the scanner in that case, metres: as far to each side as is searched, at any heading.
const OUTLIER_METRES: f64 = super::motion::WIDEST.linear;

/// Prior of the pose by the motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionPrior {
    pub prediction: Rigid2,
    pub sigmas: PredictionSigmas,
}

impl MotionPrior {
    /// Logarithm of the density of a pose, 1/(m² rad).
    pub fn log_density(&self, pose: &Rigid2) -> f64 {
        let usual = normal_density(&(self.prediction.inverse() * *pose), self.sigmas);
        ((1.0 - OUTLIER) * usual + OUTLIER * anywhere_density()).ln()
    }

    /// Logarithm of the posterior of a pose where the map agrees with the scan like this, up to a
    /// constant.
    pub fn log_posterior(
        &self,
        pose: &Rigid2,
        agreement: &ScanAgreement,
        (evidence, independent_measurements): (&BeamEvidence, IndependentMeasurements),
    ) -> f64 {
        self.log_density(pose) + evidence.log_likelihood(agreement, independent_measurements)
    }

    /// Deviation of a pose from the prediction, in standard deviations.
    pub fn deviation(&self, pose: &Rigid2) -> f64 {
        let offset = self.prediction.inverse() * *pose;
        (offset.translation.norm() / self.sigmas.translation)
            .hypot(normalize_angle(offset.angle) / self.sigmas.rotation)
    }
}

/// Evidence of beams for a pose. Where people walk about, beams end in former free space at the correct
/// pose, too, and such beams are weak evidence against it. Their fraction is learned from recent matches. No
/// beam passes through a wall.
#[derive(Clone, Copy, Debug)]
pub(super) struct BeamEvidence {
    in_free_space: f64,
}

impl Default for BeamEvidence {
    fn default() -> Self {
        Self { in_free_space: IN_FREE_SPACE.0 }
    }
}

impl BeamEvidence {
    /// Updates the statistics by the agreement of one more scan with the map.
    pub fn add(&mut self, agreement: &ScanAgreement) {
        if agreement.explained + agreement.contradicted() >= KNOWN {
            self.in_free_space += (f64::from(agreement.in_free_space) - self.in_free_space) / SCANS;
        }
    }

    /// Logarithm of the likelihood ratio of a correct and a wrong pose. Beams in unknown cells do not
    /// count.
    pub fn log_likelihood(
        &self,
        agreement: &ScanAgreement,
        independent_measurements: IndependentMeasurements,
    ) -> f64 {
        let (right, wrong) = IN_FREE_SPACE;
        let in_free_space = (wrong / self.in_free_space.clamp(right, wrong)).ln();
        let share = f64::from;
        let nats = EXPLAINED * share(agreement.explained)
            - in_free_space * share(agreement.in_free_space)
            - CONTRADICTED * share(agreement.through_solid);
        independent_measurements.count() * nats
    }
}

/// Density of an offset with these standard deviations, 1/(m² rad).
pub(super) fn normal_density(offset: &Rigid2, sigmas: PredictionSigmas) -> f64 {
    let PredictionSigmas { translation, rotation } = sigmas;
    let metres = offset.translation.norm() / translation;
    let radians = normalize_angle(offset.angle) / rotation;
    (-0.5 * (metres.powi(2) + radians.powi(2))).exp() / (TAU.powf(1.5) * translation.powi(2) * rotation)
}

/// Density of a pose within the outlier range of which nothing else is known, 1/(m² rad).
pub(super) fn anywhere_density() -> f64 {
    1.0 / ((2.0 * OUTLIER_METRES).powi(2) * TAU)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMAS: PredictionSigmas = PredictionSigmas { translation: 0.04, rotation: 0.03 };

    fn log_posterior(metres: f64, degrees: f64, explained: f32, contradicted: f32) -> f64 {
        after(&BeamEvidence::default(), metres, degrees, (explained, contradicted))
    }

    fn agreement((explained, in_free_space): (f32, f32)) -> ScanAgreement {
        ScanAgreement { explained, in_free_space, through_solid: 0.0 }
    }

    fn after(evidence: &BeamEvidence, metres: f64, degrees: f64, shares: (f32, f32)) -> f64 {
        let prior = MotionPrior { prediction: Rigid2::identity(), sigmas: SIGMAS };
        let independent_measurements = IndependentMeasurements::default();
        prior.log_posterior(
            &Rigid2::new(metres, 0.0, degrees.to_radians()),
            &agreement(shares),
            (evidence, independent_measurements),
        )
    }

    #[test]
    fn a_scan_that_fits_nowhere_is_placed_at_its_prediction() {
        let predicted = log_posterior(0.0, 0.0, 0.02, 0.93);
        // People all around: elsewhere a few more beams fit by chance.
        assert!(predicted > log_posterior(2.7, 92.0, 0.12, 0.8));
        assert!(predicted > log_posterior(0.2, 10.0, 0.15, 0.8));
    }

    #[test]
    fn a_jump_of_the_odometry_is_followed() {
        let predicted = log_posterior(0.0, 0.0, 0.3, 0.5);
        for (metres, degrees) in [(0.3, 0.0), (0.5, 30.0), (3.0, 90.0)] {
            assert!(log_posterior(metres, degrees, 0.87, 0.08) > predicted);
        }
    }

    #[test]
    fn among_people_a_far_pose_needs_more_than_fewer_contradictions() {
        let (predicted, far) = ((0.28, 0.64), (0.51, 0.36));
        let mut evidence = BeamEvidence::default();
        let is_followed = |evidence: &BeamEvidence| {
            after(evidence, 0.65, -53.0, far) > after(evidence, 0.0, 0.0, predicted)
        };
        assert!(is_followed(&evidence));
        // Scans of new surroundings do not update the statistics of people.
        (0..20).for_each(|_| evidence.add(&agreement((0.1, 0.1))));
        assert!(is_followed(&evidence));
        (0..4).for_each(|_| evidence.add(&agreement((0.43, 0.45))));
        assert!(!is_followed(&evidence));
        (0..40).for_each(|_| evidence.add(&agreement((0.9, 0.05))));
        assert!(is_followed(&evidence));
    }
}
