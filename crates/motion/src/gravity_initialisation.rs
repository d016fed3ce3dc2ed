//! Starts a trajectory: upright after measuring the direction of gravity with an IMU, or level without one.

use std::collections::VecDeque;

use portolan_geometry::{Duration, Quaternion, Rigid3, Time, Vector3, quaternion_from_angle_axis};
use portolan_sensor::{ImuData, OdometryData};

use crate::{ExtrapolatorError, PoseExtrapolator};

/// Number of odometry poses that are kept before the first sweep: they give the motion of the platform at
/// its start.
const ODOMETRY_POSES: usize = 2;

/// Maximum number of samples that are averaged, which bounds memory.
const MAX_SAMPLES: usize = 4000;

/// Sweeps that wait for the start of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WaitingSweeps {
    /// Time of the first point of the first one.
    pub first_point: Time,
    /// End of the first one.
    pub first_end: Time,
    /// End of the last one.
    pub last_end: Time,
}

/// A trajectory that has started.
#[derive(Clone, Debug)]
pub struct Beginning {
    /// Predicts from the first pose on.
    pub extrapolator: PoseExtrapolator,
    /// The samples from which the direction of gravity was measured; the extrapolator contains the first.
    /// Empty without an IMU.
    pub imu: Vec<ImuData>,
}

/// Gathers measurements before a trajectory starts.
#[derive(Clone, Debug)]
pub struct GravityInitialisation {
    /// Time for which sweeps wait for the first sample; accelerations are then averaged over
    /// `averaged_over`.
    imu_wait: Duration,
    averaged_over: Duration,
    imu: Vec<ImuData>,
    odometry: VecDeque<OdometryData>,
}

impl GravityInitialisation {
    /// Without measurements. Accelerations are averaged over `leveling_seconds`, and sweeps wait as long for
    /// the first of them.
    pub fn new(leveling_seconds: f64) -> Self {
        let leveling_time = Duration::from_seconds(leveling_seconds);
        Self {
            imu_wait: leveling_time,
            averaged_over: leveling_time,
            imu: Vec::new(),
            odometry: VecDeque::new(),
        }
    }

    /// Without measurements. A single sample determines the direction of gravity; sweeps wait `wait_seconds`
    /// for it.
    pub fn of_one_sample(wait_seconds: f64) -> Self {
        Self { averaged_over: Duration::ZERO, ..Self::new(wait_seconds) }
    }

    /// Takes a sample, in order of time.
    ///
    /// # Errors
    ///
    /// If the sample is not finite, or older than the one before; it is left out.
    pub fn add_imu(&mut self, data: &ImuData) -> Result<(), ExtrapolatorError> {
        let mut values = data.linear_acceleration.iter().chain(data.angular_velocity.iter());
        if !values.all(|v| v.is_finite()) {
            return Err(ExtrapolatorError::NotFinite);
        }
        if self.imu.last().is_some_and(|last| data.time < last.time) {
            return Err(ExtrapolatorError::OutOfOrder);
        }
        self.imu.push(*data);
        Ok(())
    }

    /// Takes an odometry pose. Only the newest are kept.
    pub fn add_odometry(&mut self, data: &OdometryData) {
        self.odometry.push_back(*data);
        if self.odometry.len() > ODOMETRY_POSES {
            self.odometry.pop_front();
        }
    }

    /// Whether enough was measured, or the sweeps have waited long enough.
    pub fn is_ready(&self, waiting: Option<&WaitingSweeps>) -> bool {
        let waited = waiting.map_or(Duration::ZERO, |sweeps| sweeps.last_end - sweeps.first_end);
        let averaged = match (self.imu.first(), self.imu.last()) {
            (Some(first), Some(last)) => last.time - first.time,
            _ => Duration::ZERO,
        };
        match self.imu.len() {
            0 => waited >= self.imu_wait,
            count => {
                averaged >= self.averaged_over
                    || count >= MAX_SAMPLES
                    || waited >= self.imu_wait + self.averaged_over
            }
        }
    }

    /// Starts at the first IMU sample, upright according to the mean of all samples; or without samples,
    /// level at the first sweep. None if there is neither, or if the samples are no accelerations.
    pub fn begin(
        &mut self,
        extrapolator: PoseExtrapolator,
        waiting: Option<&WaitingSweeps>,
    ) -> Option<Beginning> {
        let imu = std::mem::take(&mut self.imu);
        let mut extrapolator = match (imu.first(), mean_acceleration(&imu)) {
            (Some(first), Some(linear_acceleration)) => {
                extrapolator.started_at_rest(&ImuData { linear_acceleration, ..*first }).ok()?
            }
            _ => {
                let mut level = extrapolator;
                level.add_pose(waiting?.first_point, Rigid3::identity());
                level
            }
        };
        for odometry in self.odometry.drain(..) {
            // The extrapolator counts measurements that it rejects.
            let _ = extrapolator.add_odometry(&odometry);
        }
        Some(Beginning { extrapolator, imu })
    }
}

/// Mean of accelerations (m/s²) in the tracking frame at the first sample, rotated there by the gyroscope.
/// None without a sample.
fn mean_acceleration(samples: &[ImuData]) -> Option<Vector3> {
    let mut turned = Quaternion::identity();
    let mut sum = samples.first()?.linear_acceleration;
    for (before, sample) in samples.iter().zip(samples.iter().skip(1)) {
        let seconds = sample.time.seconds_since(before.time);
        turned *= quaternion_from_angle_axis(&(before.angular_velocity * seconds));
        sum += turned * sample.linear_acceleration;
    }
    Some(sum / samples.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(seconds: f64, acceleration: f64) -> ImuData {
        ImuData {
            time: Time::from_ticks(0) + Duration::from_seconds(seconds),
            linear_acceleration: Vector3::new(0.0, 0.0, acceleration),
            angular_velocity: Vector3::zeros(),
        }
    }

    fn waiting(seconds: f64) -> WaitingSweeps {
        let first_end = Time::from_ticks(0);
        WaitingSweeps {
            first_point: first_end,
            first_end,
            last_end: first_end + Duration::from_seconds(seconds),
        }
    }

    #[test]
    fn a_second_of_samples_is_enough_and_so_is_a_second_without_any() {
        let mut initialisation = GravityInitialisation::new(1.0);
        assert!(!initialisation.is_ready(None) && !initialisation.is_ready(Some(&waiting(0.9))));
        assert!(initialisation.is_ready(Some(&waiting(1.0))));
        assert_eq!(initialisation.add_imu(&sample(0.0, 9.8)), Ok(()));
        assert!(
            !initialisation.is_ready(Some(&waiting(1.9))) && initialisation.is_ready(Some(&waiting(2.0)))
        );
        assert_eq!(initialisation.add_imu(&sample(1.0, 9.8)), Ok(()));
        assert!(initialisation.is_ready(None));
        let started = initialisation.begin(PoseExtrapolator::new(0.1, 10.0, true), None).unwrap();
        assert_eq!(
            (started.imu.len(), started.extrapolator.last_pose_time()),
            (2, Some(Time::from_ticks(0)))
        );
    }

    #[test]
    fn one_sample_is_required_and_sufficient() {
        let mut initialisation = GravityInitialisation::of_one_sample(1.0);
        assert!(!initialisation.is_ready(None) && !initialisation.is_ready(Some(&waiting(0.9))));
        assert!(initialisation.is_ready(Some(&waiting(1.0))));
        assert_eq!(initialisation.add_imu(&sample(0.0, 9.8)), Ok(()));
        assert!(initialisation.is_ready(None));
    }

    #[test]
    fn non_finite_and_unordered_samples_are_rejected() {
        let mut initialisation = GravityInitialisation::new(1.0);
        assert_eq!(initialisation.add_imu(&sample(0.5, f64::NAN)), Err(ExtrapolatorError::NotFinite));
        assert_eq!(initialisation.add_imu(&sample(0.5, 9.8)), Ok(()));
        assert_eq!(initialisation.add_imu(&sample(0.4, 9.8)), Err(ExtrapolatorError::OutOfOrder));
    }

    #[test]
    fn without_samples_and_scans_no_trajectory_begins() {
        let mut initialisation = GravityInitialisation::new(1.0);
        assert!(initialisation.begin(PoseExtrapolator::new(0.1, 10.0, true), None).is_none());
    }

    #[test]
    fn the_mean_over_steps_and_turns_points_up() {
        // It rotates alternately about x and y, and vibrates.
        let rate = |t: f64| Vector3::new(0.5 * (6.0 * t).cos(), -0.4 * (5.0 * t).sin(), 0.4);
        let mut turned = Quaternion::identity();
        let mut samples = Vec::new();
        for i in 0..200 {
            let t = 0.005 * f64::from(i);
            let force = Vector3::new(2.0 * (12.0 * t).sin(), 0.0, 9.81 + 3.0 * (11.0 * t).cos());
            let linear_acceleration = turned.inverse() * force;
            samples.push(ImuData { linear_acceleration, angular_velocity: rate(t), ..sample(t, 0.0) });
            turned *= quaternion_from_angle_axis(&(rate(t) * 0.005));
        }
        let up = mean_acceleration(&samples).unwrap();
        let worst = samples.iter().map(|s| s.linear_acceleration.angle(&Vector3::z())).fold(0.0, f64::max);
        assert!(up.angle(&Vector3::z()) < 0.02 && worst > 0.15, "{} {worst}", up.angle(&Vector3::z()));
        assert!(mean_acceleration(&[]).is_none());
    }
}
