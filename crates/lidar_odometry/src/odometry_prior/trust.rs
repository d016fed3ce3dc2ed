//! Detects whether odometry measures the motion or fails: wheels that slip, readings that stand still,
//! other units or frames than specified.
//!
//! There are two models of the motion since the last sweep, as in "The interacting multiple model
//! algorithm for systems with Markovian switching coefficients" (Blom, Bar-Shalom, IEEE Transactions on
//! Automatic Control 33, 1988): odometry measured it, or it is the motion predicted without odometry.
//! Registered sweeps are compared with both predictions, and the odds are carried on.

use portolan_geometry::Rigid3;

use super::MeasuredPlace;

use crate::settings::constants::odometry_trust::{
    DIFFERENT_SIGMAS, FIRST_LOG_ODDS, MOST_LOG_ODDS, OUTLIER_NATS,
};

/// Trust in odometry, as log-odds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OdometryTrust {
    log_odds: f64,
}

impl Default for OdometryTrust {
    fn default() -> Self {
        Self { log_odds: FIRST_LOG_ODDS }
    }
}

/// A predicted pose at the end of a sweep.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Predicted {
    pub end: Rigid3,
    /// Standard deviation of its position along each axis, metres.
    pub sigma: f64,
}

/// Predictions of the end of a sweep with and without odometry.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TwoMotions {
    pub measured: Predicted,
    pub otherwise: Predicted,
    /// Standard deviation of both rotations about each axis, radians; none where both are those of a
    /// gyroscope, so that they do not distinguish the predictions.
    pub rotation_sigma: Option<f64>,
}

impl TwoMotions {
    /// Whether both differ significantly.
    pub fn differ(&self) -> bool {
        let (a, b) = (&self.measured, &self.otherwise);
        let metres = (a.end.translation.vector - b.end.translation.vector).norm();
        let radians = a.end.rotation.angle_to(&b.end.rotation);
        metres > DIFFERENT_SIGMAS * a.sigma.hypot(b.sigma)
            || self.rotation_sigma.is_some_and(|sigma| radians > DIFFERENT_SIGMAS * sigma.hypot(sigma))
    }

    /// Negative log-likelihood of a prediction given the registered sweep, up to a constant.
    fn negative_log_likelihood(&self, predicted: &Predicted, found: &MeasuredPlace) -> f64 {
        let place = &found.local_from_tracking;
        let shift = place.translation.vector - predicted.end.translation.vector;
        let turn = predicted.end.rotation.angle_to(&place.rotation);
        let mut squares = self.rotation_sigma.map_or(0.0, |sigma| (turn / sigma).powi(2));
        let mut logarithms = 0.0;
        for (direction, variance) in &found.constrained {
            let total = predicted.sigma.powi(2) + variance;
            squares += direction.dot(&shift).powi(2) / total;
            logarithms += 0.5 * total.ln();
        }
        (0.5 * squares).min(OUTLIER_NATS) + logarithms
    }
}

impl OdometryTrust {
    /// Whether odometry is more likely to work than to fail.
    pub fn works(&self) -> bool {
        self.log_odds > 0.0
    }

    /// Takes the position of a sweep. Where both predictions agree it does not update the odds.
    pub fn learn(&mut self, motions: &TwoMotions, found: &MeasuredPlace) {
        if !motions.differ() {
            return;
        }
        let odds = motions.negative_log_likelihood(&motions.otherwise, found)
            - motions.negative_log_likelihood(&motions.measured, found);
        self.log_odds = (self.log_odds + odds).clamp(-MOST_LOG_ODDS, MOST_LOG_ODDS);
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Vector3;
    use portolan_geometry::nalgebra::Matrix3;

    use super::*;

    /// State after this number of sweeps with this motion and these predictions with and without odometry.
    fn works_after(sweeps: usize, moved: f64, measured: f64, otherwise: f64) -> bool {
        works_where(sweeps, moved, measured, otherwise, &[Vector3::x(), Vector3::y(), Vector3::z()])
    }

    /// Sweeps constrain the position along these directions only.
    fn works_where(
        sweeps: usize,
        moved: f64,
        measured: f64,
        otherwise: f64,
        constrained: &[Vector3],
    ) -> bool {
        let at = |x: f64| Rigid3::translation(x, 0.0, 0.0);
        let predicted = |x: f64| Predicted { end: at(x), sigma: 0.03 };
        let motions = TwoMotions {
            measured: predicted(measured),
            otherwise: predicted(otherwise),
            rotation_sigma: None,
        };
        let constrained = constrained.iter().map(|direction| (*direction, 1e-4)).collect();
        let (covariance, of_prior) = (Matrix3::identity() * 1e-4, 1e-3);
        let found = MeasuredPlace { local_from_tracking: at(moved), covariance, of_prior, constrained };
        let mut trust = OdometryTrust::default();
        (0..sweeps).for_each(|_| trust.learn(&motions, &found));
        trust.works()
    }

    #[test]
    fn stationary_wheels_are_not_trusted_while_sweeps_move() {
        assert!(!works_after(1, 1.2, 0.0, 1.19), "a car");
        assert!(!works_after(3, 0.15, 0.0, 0.14), "somebody who walks");
        assert!(!works_after(1, 1.2, 120.0, 1.21), "in other units");
    }

    #[test]
    fn odometry_is_trusted_where_it_predicts_better_or_predictions_agree() {
        assert!(works_after(100, 1.2, 1.19, 1.21));
        assert!(works_after(100, 0.2, 0.21, 0.5), "a push, which constant velocity does not know");
        let across = [Vector3::y(), Vector3::z()];
        assert!(
            works_where(100, 1.2, 0.0, 1.19, &across),
            "along a tunnel, where sweeps do not constrain it"
        );
    }
}
