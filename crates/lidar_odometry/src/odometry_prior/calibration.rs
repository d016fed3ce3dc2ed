//! Estimates the calibration and the noise of odometry.
//!
//! If wheels have another size than specified, if odometry is mounted differently than specified, or if it
//! measures in the plane while the platform drives up a ramp, its translations are scaled by a factor and
//! rotated by two angles. Kalman filters estimate these three from the motions of sweeps, as "Simultaneous
//! Calibration of Odometry and Sensor Parameters for Mobile Robots" (Censi, Franchi, Marchionni, Oriolo,
//! IEEE Transactions on Robotics 29, 2013) estimates them by least squares. The rest is the noise, whose
//! variance follows from the innovations.

use portolan_geometry::Vector3;
use portolan_geometry::nalgebra::Matrix3;
use portolan_numeric::CovarianceMatching;

use super::MeasuredPlace;
use crate::segment::TrajectorySegment;
use crate::settings::MotionPriorSettings;
use crate::settings::constants::odometry_calibration::{
    FORGOTTEN_AFTER, MEMORY_SWEEPS, NOISE_FACTORS, OUTLIER_SQUARED_SIGMAS, REPORTED_SCALE_ERROR,
    REPORTED_SIGMAS,
};

/// Motion since the last sweep by odometry.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OdometryMotion {
    /// Metres in the local map.
    pub translation: Vector3,
    pub seconds: f64,
}

/// The calibration of odometry.
#[derive(Clone, Debug)]
pub(crate) struct Calibration {
    /// Correction along the motion, to its left and upwards, for each metre of it, and the variance of
    /// each.
    mean: Vector3,
    variances: Vector3,
    /// Direction of the last motion, in the local map.
    last_along: Option<Vector3>,
    /// Variance of the noise, relative to the assumed one.
    noise: CovarianceMatching,
    settings: MotionPriorSettings,
}

impl Calibration {
    pub fn new(settings: &MotionPriorSettings) -> Self {
        Self {
            mean: Vector3::zeros(),
            variances: Vector3::repeat(settings.odometry_calibration.powi(2)),
            last_along: None,
            noise: CovarianceMatching::new(MEMORY_SWEEPS).within(NOISE_FACTORS.0, NOISE_FACTORS.1),
            settings: settings.clone(),
        }
    }

    /// The segment with its translations corrected.
    pub fn corrected(&self, segment: &TrajectorySegment, motion: &OdometryMotion) -> TrajectorySegment {
        let start = segment.start().translation.vector;
        let (mean, [_, left, _]) = (self.mean_of(motion), motion.axes());
        let turn = (Vector3::z() * mean.y - left * mean.z).cross_matrix();
        let matrix = Matrix3::identity() * (1.0 + mean.x) + turn;
        segment.clone().changed(|_, pose| {
            pose.translation.vector = start + matrix * (pose.translation.vector - start);
        })
    }

    /// The mean for a motion: a ramp up is a ramp down in the other direction.
    fn mean_of(&self, motion: &OdometryMotion) -> Vector3 {
        let [along, ..] = motion.axes();
        match self.last_along.is_some_and(|last| last.dot(&along) < 0.0) {
            true => Vector3::new(self.mean.x, self.mean.y, -self.mean.z),
            false => self.mean,
        }
    }

    /// Ratio of the distance by odometry to that by sweeps, where it differs significantly from one.
    pub fn factor(&self) -> Option<f64> {
        let sigma = self.variances.x.sqrt();
        let is_significant =
            self.mean.x.abs() > REPORTED_SCALE_ERROR && self.mean.x.abs() > REPORTED_SIGMAS * sigma;
        is_significant.then(|| 1.0 / (1.0 + self.mean.x))
    }

    /// Standard deviation of a corrected motion along each axis, metres.
    pub fn sigma(&self, motion: &OdometryMotion) -> f64 {
        let by_calibration = self.variances.max() * motion.translation.norm_squared();
        self.settings.least_translation_error + (self.noise_variance(motion) + by_calibration).sqrt()
    }

    fn noise_variance(&self, motion: &OdometryMotion) -> f64 {
        (self.settings.odometry_drift * motion.seconds).powi(2) * self.noise.variance_factor()
    }

    /// Takes the motion of the platform (metres in the local map), and that by odometry.
    pub fn learn(&mut self, motion: &OdometryMotion, moved: &Vector3, found: &MeasuredPlace) {
        let most = self.settings.odometry_calibration.powi(2);
        let walk = most * motion.seconds / FORGOTTEN_AFTER;
        self.variances = self.variances.map(|variance| (variance + walk).min(most));
        // Odometry of a platform at rest does not calibrate that of a moving one.
        let (distance, least) = (motion.translation.norm(), self.settings.least_translation_error);
        if distance.max(moved.norm()) < 2.0 * least {
            return;
        }
        self.mean = self.mean_of(motion);
        self.last_along = Some(motion.axes()[0]);
        let noise = self.noise_variance(motion);
        for (i, axis) in motion.axes().iter().enumerate() {
            let variance = axis.dot(&(found.covariance * axis));
            // Where points constrain less than the prior they agree with it, correct or not.
            if variance > found.of_prior {
                continue;
            }
            let expected = distance * (self.mean[i] + if i == 0 { 1.0 } else { 0.0 });
            let innovation = axis.dot(moved) - expected;
            let total = variance + least * least + noise + distance * distance * self.variances[i];
            let squared = innovation * innovation / total;
            self.noise.add_relative(squared);
            if squared < OUTLIER_SQUARED_SIGMAS {
                let gain = distance * self.variances[i] / total;
                self.mean[i] += gain * innovation;
                self.variances[i] -= gain * gain * total;
            }
        }
    }
}

impl OdometryMotion {
    /// Unit vectors along the motion, to its left and up, in the local map.
    fn axes(&self) -> [Vector3; 3] {
        let along = self.translation.try_normalize(1e-9).unwrap_or_else(Vector3::x);
        let left = Vector3::z().cross(&along).try_normalize(1e-9).unwrap_or_else(Vector3::y);
        [along, left, along.cross(&left)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::OdometrySettings;
    use portolan_geometry::Rigid3;

    /// Calibration after sweeps of 0.1 s: their motions by odometry, and their true ones.
    fn after(moves: impl Iterator<Item = (Vector3, Vector3)>, variance: f64) -> Calibration {
        let mut calibration = Calibration::new(&OdometrySettings::default().motion_prior);
        for (odometry, moved) in moves {
            let (covariance, of_prior) = (Matrix3::identity() * variance, 1e-3);
            let local_from_tracking = Rigid3::identity();
            let found = MeasuredPlace { local_from_tracking, covariance, of_prior, constrained: Vec::new() };
            calibration.learn(&OdometryMotion { translation: odometry, seconds: 0.1 }, &moved, &found);
        }
        calibration
    }

    #[test]
    fn wrong_wheel_size_and_mounting_are_corrected() {
        let odometry = Vector3::new(1.0, 0.0, 0.0);
        let moved = Vector3::new(0.92, 0.05, -0.03);
        let calibration = after(std::iter::repeat_n((odometry, moved), 40), 1e-4);
        assert!((calibration.mean - Vector3::new(-0.08, 0.05, -0.03)).norm() < 0.01, "{}", calibration.mean);
        let (start, motion) = (Rigid3::identity(), OdometryMotion { translation: odometry, seconds: 0.1 });
        let (begin, end) =
            (portolan_geometry::Time::from_ticks(0), portolan_geometry::Time::from_ticks(1_000_000));
        let segment = TrajectorySegment::new(begin, end, |time| match time == end {
            true => Rigid3::translation(1.0, 0.0, 0.0),
            false => start,
        });
        let corrected = calibration.corrected(&segment, &motion).translation();
        assert!((corrected - moved).norm() < 0.01, "{corrected}");
        assert!(calibration.sigma(&motion) < 0.025, "{}", calibration.sigma(&motion));
        assert!((calibration.factor().unwrap() - 1.0 / 0.92).abs() < 0.01);
        // In the opposite direction.
        let back = OdometryMotion { translation: -odometry, seconds: 0.1 };
        let returned = calibration.corrected(&segment.changed(|_, pose| *pose = pose.inverse()), &back);
        assert!((returned.translation() - Vector3::new(-0.92, -0.05, 0.03)).norm() < 0.01);
    }

    #[test]
    fn noise_of_slipping_odometry_is_larger_than_of_accurate_odometry() {
        let odometry = |i: u32| Vector3::new(0.1, 0.0, 0.001 * f64::from(i % 2));
        let noisy =
            after((0..200).map(|i| (odometry(i), odometry(i) * (1.0 + 0.8 * f64::from(i).sin()))), 1e-5);
        let good = after((0..200).map(|i| (odometry(i), odometry(i))), 1e-5);
        let motion = OdometryMotion { translation: odometry(0), seconds: 0.1 };
        let sigmas = [&noisy, &Calibration::new(&noisy.settings), &good].map(|of| of.sigma(&motion));
        assert!(sigmas.is_sorted_by(|a, b| a > b), "{sigmas:?}");
        assert!(sigmas[0] > 0.04 && sigmas[2] < 0.015, "{sigmas:?}");
    }

    #[test]
    fn degenerate_sweeps_and_rest_do_not_update_the_calibration() {
        let odometry = Vector3::new(1.0, 0.0, 0.0);
        let open = after(std::iter::repeat_n((odometry, 0.5 * odometry), 40), 1.0);
        assert_eq!((open.mean, open.factor()), (Vector3::zeros(), None));
        let resting = after(std::iter::repeat_n((Vector3::zeros(), Vector3::zeros()), 40), 1e-5);
        assert_eq!(resting.noise.variance_factor(), 1.0);
    }
}
