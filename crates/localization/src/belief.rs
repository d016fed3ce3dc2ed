//! A pose in the map with its covariance: a Kalman filter whose prediction is local SLAM and whose measurements are
//! matches of scans to the map.

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3, angle_axis_from_quaternion, quaternion_from_angle_axis};

use crate::drift_scale::DriftScale;
use crate::settings::tracking::{
    DRIFT_METRES_BY_DISTANCE, DRIFT_METRES_BY_TIME, DRIFT_RADIANS_BY_DISTANCE, DRIFT_RADIANS_BY_TIME,
    DRIFT_RADIANS_BY_TURN, INDEPENDENT_METRES, INDEPENDENT_RADIANS, INDEPENDENT_SECONDS,
};

/// Covariance, or information, of a pose in the map: x, y, z, and a small rotation about these axes; metres and radians.
pub type Matrix6 = na::Matrix6<f64>;
/// A small change of a pose in the same order.
pub(crate) type Vector6 = na::Vector6<f64>;

/// Variance along the fixed axes in 2D: so small that it has no effect, and not 0, so that matrices can be
/// inverted.
const FIXED: f64 = 1e-9;

/// Error common to all matches, which no number of scans reduces, since walls are where the map's own error
/// and its cells put them: standard deviations along and about each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapError {
    /// Metres.
    pub metres: f64,
    /// Radians.
    pub radians: f64,
}

/// Degrees of freedom of the scanner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// In 2D: x, y and yaw.
    TwoD,
    /// In 3D: all six.
    ThreeD,
}

impl Freedom {
    /// Variances along the free axes, 0 along the others.
    pub(crate) fn variances(self, metres_squared: f64, radians_squared: f64) -> Vector6 {
        let (m, r) = (metres_squared, radians_squared);
        match self {
            Self::TwoD => Vector6::new(m, m, 0.0, 0.0, 0.0, r),
            Self::ThreeD => Vector6::new(m, m, m, r, r, r),
        }
    }

    /// A covariance in which the fixed axes are practically known.
    fn restricted(self, covariance: &Matrix6) -> Matrix6 {
        if self == Self::ThreeD {
            return 0.5 * (covariance + covariance.transpose());
        }
        let is_open = |i: usize| matches!(i, 0 | 1 | 5);
        Matrix6::from_fn(|i, j| match (is_open(i) && is_open(j), i == j) {
            (true, _) => 0.5 * (covariance[(i, j)] + covariance[(j, i)]),
            (false, true) => FIXED,
            (false, false) => 0.0,
        })
    }
}

/// Pose of a scan in the map with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PoseEstimate {
    /// `map_from_scan`.
    pub pose: Rigid3,
    covariance: Matrix6,
    freedom: Freedom,
    map_error: MapError,
    drift_scale: DriftScale,
    /// Fraction of an independent match that has become available by motion and time since the last match.
    fresh: f64,
}

impl PoseEstimate {
    /// A pose with these standard deviations (metres, radians), in a map with this error.
    pub fn new(pose: Rigid3, freedom: Freedom, map_error: MapError, (metres, radians): (f64, f64)) -> Self {
        let diagonal = freedom.variances(metres * metres, radians * radians);
        let covariance = freedom.restricted(&Matrix6::from_diagonal(&diagonal));
        Self { pose, covariance, freedom, map_error, drift_scale: DriftScale::default(), fresh: 1.0 }
    }

    /// Another pose in the same map.
    pub fn elsewhere(&self, pose: Rigid3, sigmas: (f64, f64)) -> Self {
        Self::new(pose, self.freedom, self.map_error, sigmas)
    }

    /// Covariance of the reported pose: it includes the errors that all matches share.
    pub fn covariance(&self) -> Matrix6 {
        let MapError { metres, radians } = self.map_error;
        let map = self.freedom.variances(metres * metres, radians * radians);
        self.covariance + Matrix6::from_diagonal(&map)
    }

    /// Standard deviations: metres along the worst direction, and radians about the worst axis; without the
    /// map error.
    pub fn sigmas(&self) -> (f64, f64) {
        let shifts = self.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let turns = self.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        let worst = |block: na::Matrix3<f64>| block.symmetric_eigenvalues().max().max(0.0).sqrt();
        (worst(shifts), worst(turns))
    }

    /// Predicts with a motion from local SLAM, in the frame of the previous scan.
    pub fn predict(&mut self, motion: &Rigid3, seconds: f64) {
        let turned = self.pose.rotation * motion.translation.vector;
        let mut transition = Matrix6::identity();
        transition.fixed_view_mut::<3, 3>(0, 3).copy_from(&-turned.cross_matrix());
        let (metres, turn) = (motion.translation.vector.norm(), motion.rotation.angle());
        let time = seconds.clamp(0.0, 10.0);
        let shift = DRIFT_METRES_BY_DISTANCE.powi(2) * metres + DRIFT_METRES_BY_TIME.powi(2) * time;
        let angle = DRIFT_RADIANS_BY_DISTANCE.powi(2) * metres
            + DRIFT_RADIANS_BY_TURN.powi(2) * turn
            + DRIFT_RADIANS_BY_TIME.powi(2) * time;
        let scale = self.drift_scale.factor();
        let noise = Matrix6::from_diagonal(&self.freedom.variances(scale * shift, scale * angle));
        let covariance = transition * self.covariance * transition.transpose() + noise;
        self.covariance = self.freedom.restricted(&covariance);
        self.pose *= *motion;
        self.pose.rotation.renormalize();
        let fresh = metres / INDEPENDENT_METRES + turn / INDEPENDENT_RADIANS + time / INDEPENDENT_SECONDS;
        self.fresh = (self.fresh + fresh).min(1.0);
    }

    /// Squared Mahalanobis distance between a match and this estimate.
    pub fn distance(&self, found: &Rigid3, information: &Matrix6) -> f64 {
        let tiny = Matrix6::identity() * 1e-6;
        let Some(of_match) = (information + tiny).try_inverse() else { return f64::INFINITY };
        let Some(weight) = (self.covariance() + of_match).try_inverse() else { return f64::INFINITY };
        let offset = offset(&self.pose, found);
        (offset.transpose() * weight * offset).x
    }

    /// Takes the squared Mahalanobis distance of a match into account for the drift from now on.
    pub fn note_distance(&mut self, squared: f64) {
        self.drift_scale.add(squared, self.freedom);
    }

    /// Updates with a match; directions without information stay unchanged.
    pub fn update(&mut self, found: &Rigid3, information: &Matrix6) {
        let information = information * self.fresh;
        let Some(prior) = self.covariance.try_inverse() else { return };
        let Some(covariance) = (prior + information).try_inverse() else { return };
        let step = covariance * information * offset(&self.pose, found);
        self.covariance = self.freedom.restricted(&covariance);
        self.pose.translation.vector += step.fixed_rows::<3>(0);
        let turn = quaternion_from_angle_axis(&step.fixed_rows::<3>(3).into_owned());
        self.pose.rotation = turn * self.pose.rotation;
        self.fresh = 0.0;
    }
}

/// Difference between two poses: along the axes of the map, and as a rotation vector about them.
pub(crate) fn offset(from: &Rigid3, to: &Rigid3) -> Vector6 {
    let shift = to.translation.vector - from.translation.vector;
    let turn: Quaternion = to.rotation * from.rotation.inverse();
    let turn = angle_axis_from_quaternion(&turn);
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::maps::USUAL_MAP_ERROR;

    fn along(x: f64) -> Rigid3 {
        Rigid3::translation(x, 0.0, 0.0)
    }

    #[test]
    fn a_corridor_does_not_constrain_the_position_along_it() {
        for freedom in [Freedom::TwoD, Freedom::ThreeD] {
            let mut belief = PoseEstimate::new(Rigid3::identity(), freedom, USUAL_MAP_ERROR, (0.2, 0.02));
            let across = Matrix6::from_diagonal(&Vector6::new(0.0, 1e4, 1e4, 1e5, 1e5, 1e5));
            for _ in 0..100 {
                belief.predict(&along(0.5), 0.5);
                let found = along(belief.pose.translation.x + 3.0);
                assert!(belief.distance(&found, &across) < 200.0);
                belief.update(&found, &across);
            }
            let covariance = belief.covariance();
            // 4 cm a root of a metre over 50 m, and the initial standard deviation.
            assert!((covariance[(0, 0)].sqrt() - 0.35).abs() < 0.02, "{covariance}");
            assert!(covariance[(1, 1)].sqrt() < 0.05 && (belief.pose.translation.x - 50.0).abs() < 1e-6);
            assert!(covariance[(2, 2)].sqrt() < 0.05);
        }
    }

    #[test]
    fn standing_scans_do_not_add_up() {
        let mut belief = PoseEstimate::new(Rigid3::identity(), Freedom::TwoD, USUAL_MAP_ERROR, (1.0, 0.1));
        let information = Matrix6::from_diagonal(&Vector6::new(1e3, 1e3, 0.0, 0.0, 0.0, 1e3));
        belief.update(&along(0.1), &information);
        let once = belief.sigmas().0;
        (0..10).for_each(|_| {
            belief.predict(&Rigid3::identity(), 0.1);
            belief.update(&along(0.1), &information);
        });
        assert!(belief.sigmas().0 > 0.8 * once && (belief.pose.translation.x - 0.1).abs() < 0.01);
    }

    #[test]
    fn in_2d_height_and_tilt_never_vary() {
        let mut belief = PoseEstimate::new(Rigid3::identity(), Freedom::TwoD, USUAL_MAP_ERROR, (0.2, 0.02));
        for _ in 0..10_000 {
            belief.predict(&Rigid3::translation(1.0, 0.5, 0.0), 0.1);
            let information = Matrix6::from_diagonal(&Vector6::new(1e4, 1e4, 0.0, 0.0, 0.0, 1e5));
            belief.update(&belief.pose.clone(), &information);
        }
        assert!(belief.covariance()[(2, 2)] < 1e-6 && belief.sigmas().0 < 0.1);
    }
}
