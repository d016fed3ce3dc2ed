//! A pose in the map with its covariance: a Kalman filter whose prediction is local SLAM and whose measurements are
//! matches of scans to the map.

use nalgebra as na;
use portolan_geometry::{Rigid2, Vector2, normalize_angle};

/// Covariance, or information, of (x, y, yaw) in the map: metres and radians.
pub type Matrix3 = na::Matrix3<f64>;

/// Drift of local SLAM as a random walk: metres per root of a metre, radians per root of a metre and of a radian, and
/// metres and radians per root of a second.
const SHIFT_BY_WAY: f64 = 0.04;
const TURN_BY_WAY: f64 = 0.012;
const TURN_BY_TURN: f64 = 0.02;
const SHIFT_BY_TIME: f64 = 0.005;
const TURN_BY_TIME: f64 = 0.001;
/// What no number of scans makes smaller: walls of the map lie where the map's own error and its cells put them, metres and
/// radians. About what maps of the halves of real logs are bent against those of the whole within a few metres.
const MAP_ERROR: f64 = 0.035;
const MAP_TURN: f64 = 0.008;
/// Two matches are independent after this way, this turn or this time; nearer ones see the same errors of the map.
const INDEPENDENT_METRES: f64 = 0.5;
const INDEPENDENT_RADIANS: f64 = 0.35;
const INDEPENDENT_SECONDS: f64 = 10.0;

/// Where a scan was taken, and how well that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Belief {
    /// `map_from_scan`.
    pub pose: Rigid2,
    covariance: Matrix3,
    /// Share of an independent match that has gathered since the last one.
    fresh: f64,
}

impl Belief {
    /// A pose with standard deviations in metres and radians.
    pub fn new(pose: Rigid2, metres: f64, radians: f64) -> Self {
        let diagonal = na::Vector3::new(metres, metres, radians).map(|sigma| sigma * sigma);
        Self { pose, covariance: Matrix3::from_diagonal(&diagonal), fresh: 1.0 }
    }

    /// Covariance of what is told: with the errors that matches have in common.
    pub fn covariance(&self) -> Matrix3 {
        let map = na::Vector3::new(MAP_ERROR, MAP_ERROR, MAP_TURN).map(|sigma| sigma * sigma);
        self.covariance + Matrix3::from_diagonal(&map)
    }

    /// Standard deviations: metres along the worse direction, and radians.
    pub fn sigmas(&self) -> (f64, f64) {
        let c = &self.covariance;
        let (mean, half) = (0.5 * (c[(0, 0)] + c[(1, 1)]), 0.5 * (c[(0, 0)] - c[(1, 1)]));
        ((mean + half.hypot(c[(0, 1)])).max(0.0).sqrt(), c[(2, 2)].max(0.0).sqrt())
    }

    /// Goes along with a motion that local SLAM found, in the frame of the scan before it.
    pub fn predict(&mut self, motion: &Rigid2, seconds: f64) {
        let turned = self.pose.rotation_matrix() * motion.translation;
        let mut transition = Matrix3::identity();
        transition[(0, 2)] = -turned.y;
        transition[(1, 2)] = turned.x;
        let (way, turn, time) = (motion.translation.norm(), motion.angle.abs(), seconds.clamp(0.0, 10.0));
        let shift = SHIFT_BY_WAY.powi(2) * way + SHIFT_BY_TIME.powi(2) * time;
        let angle = TURN_BY_WAY.powi(2) * way + TURN_BY_TURN.powi(2) * turn + TURN_BY_TIME.powi(2) * time;
        let noise = Matrix3::from_diagonal(&na::Vector3::new(shift, shift, angle));
        self.covariance = transition * self.covariance * transition.transpose() + noise;
        self.pose = self.pose * *motion;
        self.pose.angle = normalize_angle(self.pose.angle);
        let fresh = way / INDEPENDENT_METRES + turn / INDEPENDENT_RADIANS + time / INDEPENDENT_SECONDS;
        self.fresh = (self.fresh + fresh).min(1.0);
    }

    /// How far a match lies from this belief, as the square of a Mahalanobis distance.
    pub fn distance(&self, found: &Rigid2, information: &Matrix3) -> f64 {
        let tiny = Matrix3::identity() * 1e-6;
        let Some(of_match) = (information + tiny).try_inverse() else { return f64::INFINITY };
        let Some(weight) = (self.covariance() + of_match).try_inverse() else { return f64::INFINITY };
        let offset = self.offset(found);
        (offset.transpose() * weight * offset)[(0, 0)]
    }

    /// Takes a match into account; directions in which it has no information stay as they are.
    pub fn update(&mut self, found: &Rigid2, information: &Matrix3) {
        let information = information * self.fresh;
        let Some(prior) = self.covariance.try_inverse() else { return };
        let Some(covariance) = (prior + information).try_inverse() else { return };
        let step = covariance * information * self.offset(found);
        self.covariance = 0.5 * (covariance + covariance.transpose());
        self.pose.translation += Vector2::new(step.x, step.y);
        self.pose.angle = normalize_angle(self.pose.angle + step.z);
        self.fresh = 0.0;
    }

    fn offset(&self, found: &Rigid2) -> na::Vector3<f64> {
        let shift = found.translation - self.pose.translation;
        na::Vector3::new(shift.x, shift.y, normalize_angle(found.angle - self.pose.angle))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corridor_tells_nothing_along_it() {
        let mut belief = Belief::new(Rigid2::identity(), 0.2, 0.02);
        let across = Matrix3::from_diagonal(&na::Vector3::new(0.0, 1e4, 1e5));
        for _ in 0..100 {
            belief.predict(&Rigid2::new(0.5, 0.0, 0.0), 0.5);
            let found = Rigid2::new(belief.pose.translation.x + 3.0, 0.0, 0.0);
            assert!(belief.distance(&found, &across) < 200.0);
            belief.update(&found, &across);
        }
        let covariance = belief.covariance();
        // 4 cm a root of a metre over 50 m, and what it began with.
        assert!((covariance[(0, 0)].sqrt() - 0.35).abs() < 0.05, "{covariance}");
        assert!(covariance[(1, 1)].sqrt() < 0.05 && (belief.pose.translation.x - 50.0).abs() < 1e-6);
    }

    #[test]
    fn standing_scans_do_not_add_up() {
        let mut belief = Belief::new(Rigid2::identity(), 1.0, 0.1);
        let information = Matrix3::identity() * 1e3;
        belief.update(&Rigid2::new(0.1, 0.0, 0.0), &information);
        let once = belief.sigmas().0;
        (0..10).for_each(|_| {
            belief.predict(&Rigid2::identity(), 0.1);
            belief.update(&Rigid2::new(0.1, 0.0, 0.0), &information);
        });
        assert!(belief.sigmas().0 > 0.8 * once && (belief.pose.translation.x - 0.1).abs() < 0.01);
    }
}
