//! Estimates the vertical in the tracking frame from an IMU and matched scans.
//!
//! An accelerometer alone measures gravity and motion together, and the drift of a gyroscope looks like a
//! tilt. Scans measure the motion in the plane. With it an inertial filter ([`InertialEstimate`])
//! separates the tilt and the bias of the gyroscope. The extrapolator receives the angular velocity
//! without bias, and the vertical of the filter instead of the acceleration.

use portolan_geometry::nalgebra::{Matrix3, Vector3 as Vector};
use portolan_geometry::{Duration, Quaternion, Rigid3, Time, Vector3, quaternion_from_angle_axis};
use portolan_lidar_odometry::OdometrySettings;
use portolan_motion::{
    ImuBuffer, InertialEntry, InertialEstimate, InertialNoise, Preintegrated, USUAL_GRAVITY,
};
use portolan_numeric::CovarianceMatching;
use portolan_sensor::ImuData;

/// Standard deviation of the initial tilt from the mean of the first accelerations, radians: a platform
/// that accelerates by 1 m/s².
const FIRST_TILT: f64 = 0.1;
/// Standard deviation of an unmeasured velocity, m/s: walkers, wheels.
const UNKNOWN_VELOCITY: f64 = 2.0;
/// Standard deviations of matched poses: along each axis, metres, and of the heading, radians.
const PLACE: f64 = 0.03;
const HEADING: f64 = 0.01;
/// Standard deviation of a pose along each axis where most of it was predicted, metres: errors of smooth
/// velocities.
const PREDICTED_PLACE: f64 = 0.3;
/// Standard deviation of the height above the plane, metres: a carried scanner rises and sinks.
const HEIGHT: f64 = 0.3;
/// Standard deviation of the tilt by a scan, which does not measure it, radians.
const UNKNOWN: f64 = 30.0;
/// Deviation of a matched pose from the prediction, in standard deviations, above which the filter is
/// reset to it.
const OUTLIER_SIGMAS: f64 = 5.0;
/// Covariance matching of the noise of the IMU: time constant, scans, and limits of the variance factor;
/// at the upper one the IMU has no weight.
const LEARNED: CovarianceMatching = CovarianceMatching::new(20.0).within(1.0, 1e6);
/// Gap between samples above which the motion in between is unknown.
const MAX_GAP: Duration = Duration::from_ticks(5_000_000);

/// Estimator of the vertical.
#[derive(Clone, Debug)]
pub(super) struct LevelFilter {
    phase: Phase,
    samples: ImuBuffer,
    last_sample: Option<ImuData>,
    /// Errors of the IMU as in 3D, except that the local map is level.
    errors: InertialNoise,
    /// Factors of the assumed variances of accelerations, and of angular velocities and the walk of their
    /// bias.
    accelerations: CovarianceMatching,
    turns: CovarianceMatching,
}

#[derive(Clone, Debug)]
enum Phase {
    /// Before the first scan: the sum of accelerations in the tracking frame of the first sample, and the
    /// present tracking frame in it.
    Averaging { sum: Vector3, first_from_tracking: Quaternion },
    /// The estimates at the last scan and at the last sample.
    Filtering { at_scan: Box<InertialEstimate>, time: Time, now: Box<InertialEstimate> },
}

impl Default for LevelFilter {
    fn default() -> Self {
        Self {
            phase: Phase::Averaging { sum: Vector3::zeros(), first_from_tracking: Quaternion::identity() },
            samples: ImuBuffer::default(),
            last_sample: None,
            errors: InertialNoise { gravity_walk: 0.0, ..OdometrySettings::default().inertial_noise() },
            accelerations: LEARNED,
            turns: LEARNED,
        }
    }
}

impl LevelFilter {
    /// Takes a sample, in order of time. Gives it without bias, and with the estimated vertical in place
    /// of the acceleration. An invalid or older sample is given back unchanged.
    pub fn add_imu(&mut self, data: &ImuData) -> ImuData {
        let is_finite = data.linear_acceleration.iter().chain(&data.angular_velocity).all(|v| v.is_finite());
        if !is_finite || self.last_sample.is_some_and(|last| data.time < last.time) {
            return *data;
        }
        let last = self.last_sample.replace(*data).filter(|last| data.time - last.time <= MAX_GAP);
        self.samples.push(data);
        let (up, bias) = match &mut self.phase {
            Phase::Averaging { sum, first_from_tracking } => {
                let seconds = last.map_or(0.0, |last| data.time.seconds_since(last.time));
                let turn = quaternion_from_angle_axis(&(data.angular_velocity * seconds));
                *first_from_tracking = Quaternion::new_normalize((*first_from_tracking * turn).into_inner());
                *sum += *first_from_tracking * data.linear_acceleration;
                (first_from_tracking.inverse() * *sum, Vector3::zeros())
            }
            Phase::Filtering { now, .. } => {
                if let Some(last) = last {
                    let span = (last.time, data.time);
                    now.advance_along(&[last, *data], span, &mut Preintegrated::default());
                }
                (now.rotation.inverse() * Vector3::z(), now.gyroscope_bias)
            }
        };
        let up = up.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        ImuData {
            time: data.time,
            linear_acceleration: up * USUAL_GRAVITY,
            angular_velocity: data.angular_velocity - bias,
        }
    }

    /// Takes the matched pose of a scan. `measures_position`: the position was measured; otherwise most of it
    /// comes from the prediction.
    pub fn add_pose(&mut self, time: Time, local_from_tracking: &Rigid3, measures_position: bool) {
        if self.last_sample.is_none() {
            return;
        }
        let at_scan = match &self.phase {
            Phase::Averaging { .. } => {
                let sigmas = [PLACE, FIRST_TILT, UNKNOWN_VELOCITY];
                InertialEstimate::in_level_map(local_from_tracking, sigmas, USUAL_GRAVITY, &self.errors)
            }
            Phase::Filtering { at_scan, time: before, .. } => {
                let mut estimate = (**at_scan).clone();
                if self.propagate(&mut estimate, (*before, time)) {
                    self.correct(&mut estimate, local_from_tracking, measures_position);
                } else {
                    let sigmas = [PLACE, FIRST_TILT, UNKNOWN_VELOCITY];
                    estimate.moved_to(local_from_tracking, Vector3::zeros(), sigmas);
                }
                estimate
            }
        };
        self.samples.forget_until(time);
        let mut now = at_scan.clone();
        if let Some(last) = self.last_sample.filter(|last| last.time > time && last.time - time <= MAX_GAP) {
            now.advance_along(self.samples.all(), (time, last.time), &mut Preintegrated::default());
        }
        self.phase = Phase::Filtering { at_scan: Box::new(at_scan), time, now: Box::new(now) };
    }

    /// Propagates the estimate from one scan to the next by the IMU. False, with the estimate unchanged,
    /// if samples are missing.
    fn propagate(&self, estimate: &mut InertialEstimate, (from, to): (Time, Time)) -> bool {
        let samples = self.samples.all();
        let times = samples.iter().map(|sample| sample.time).filter(|time| (from..to).contains(time));
        let mut last = from;
        let has_gap = times.chain([to]).any(|time| time - std::mem::replace(&mut last, time) > MAX_GAP);
        if to < from || has_gap {
            return false;
        }
        let mut measured = Preintegrated::default();
        estimate.advance_along(samples, (from, to), &mut measured);
        let turns = self.turns.sigma_factor();
        let noise = InertialNoise {
            turn: turns * self.errors.turn,
            gyroscope_walk: turns * self.errors.gyroscope_walk,
            ..self.errors
        };
        estimate.propagate(&measured, self.accelerations.variance_factor(), &noise);
        true
    }

    /// Updates the estimate by a matched pose, which measures position and heading.
    fn correct(
        &mut self,
        estimate: &mut InertialEstimate,
        local_from_tracking: &Rigid3,
        measures_position: bool,
    ) {
        let unknown = UNKNOWN * UNKNOWN;
        let turn = estimate.rotation_to(&local_from_tracking.rotation);
        let error = Matrix3::from_diagonal(&Vector::new(unknown, unknown, HEADING * HEADING));
        let of_heading = estimate.covariance_of(InertialEntry::Rotation).m33 + HEADING * HEADING;
        self.turns.add_relative(turn.z * turn.z / of_heading);
        estimate.correct(InertialEntry::Rotation, &Vector3::new(0.0, 0.0, turn.z), &error);
        let horizontal = if measures_position { PLACE } else { PREDICTED_PLACE };
        let variances = Vector::new(horizontal * horizontal, horizontal * horizontal, HEIGHT * HEIGHT);
        let error = Matrix3::from_diagonal(&variances);
        let innovation = local_from_tracking.translation.vector - estimate.place;
        let expected = estimate.covariance_of(InertialEntry::Place) + error;
        let squared =
            expected.try_inverse().map_or(f64::INFINITY, |inverse| innovation.dot(&(inverse * innovation)));
        if measures_position {
            self.accelerations.add_relative(squared / 3.0);
        }
        if squared > OUTLIER_SIGMAS * OUTLIER_SIGMAS {
            // The motion was not that of the filter: the pose jumped, or was wrong before.
            estimate.place = local_from_tracking.translation.vector;
            estimate.velocity = Vector3::zeros();
            estimate.forget(InertialEntry::Place, PLACE);
            estimate.forget(InertialEntry::Velocity, UNKNOWN_VELOCITY);
            return;
        }
        estimate.correct(InertialEntry::Place, &innovation, &error);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Circles at 1.4 m/s on a radius of 2 m, so that accelerations are tilted by 6° in the mean over any
    /// time.
    fn pose(t: f64) -> Rigid3 {
        let angle = 0.7 * t;
        let place = Vector3::new(2.0 * angle.cos(), 2.0 * angle.sin(), 0.0);
        let tilt = quaternion_from_angle_axis(&(Vector3::x() * 0.5));
        Rigid3::from_parts(place.into(), quaternion_from_angle_axis(&(Vector3::z() * angle)) * tilt)
    }

    fn sample(t: f64, bias: &Vector3) -> ImuData {
        let Rigid3 { rotation, translation } = pose(t);
        let force = Vector3::z() * USUAL_GRAVITY - translation.vector * 0.49;
        ImuData {
            time: at(t),
            linear_acceleration: rotation.inverse() * force,
            angular_velocity: rotation.inverse() * Vector3::z() * 0.7 + bias,
        }
    }

    fn at(t: f64) -> Time {
        Time::from_ticks(0) + Duration::from_seconds(t)
    }

    /// The error of the vertical after this time, seconds, in radians, and that of the angular velocity,
    /// rad/s; and the largest error of the vertical in the second half. Positions are measured at the
    /// times `measures_position`.
    fn after(seconds: f64, bias: Vector3, measures_position: impl Fn(f64) -> bool) -> (f64, f64, f64) {
        let (mut filter, mut result) = (LevelFilter::default(), (0.0, 0.0, 0.0));
        for i in 1..=(100.0 * seconds) as i32 {
            let t = 0.01 * f64::from(i);
            let data = filter.add_imu(&sample(t, &bias));
            let up = pose(t).rotation.inverse() * Vector3::z();
            let off = data.linear_acceleration.angle(&up);
            let drift = (data.angular_velocity - up * 0.7).norm();
            result = (off, drift, if t > 0.5 * seconds { off.max(result.2) } else { 0.0 });
            if i % 10 == 0 {
                filter.add_pose(at(t), &pose(t), measures_position(t));
            }
        }
        result
    }

    #[test]
    fn curves_and_gyroscope_bias_do_not_tilt_the_level() {
        // In such curves a bias of the accelerometer cannot be separated from both: 0.1 m/s² are 0.6°.
        let (off, drift, _) = after(10.0, Vector3::new(0.05, -0.04, 0.03), |_| true);
        assert!(off.to_degrees() < 0.8 && drift < 0.01, "{off} {drift}");
        let (off, ..) = after(3.0, Vector3::zeros(), |_| true);
        assert!(off.to_degrees() < 1.0, "{off}");
    }

    #[test]
    fn the_level_is_kept_while_scans_do_not_measure_the_position() {
        let (_, _, most) = after(60.0, Vector3::new(0.01, 0.0, -0.01), |t| !(30.0..45.0).contains(&t));
        assert!(most.to_degrees() < 0.5, "{most}");
    }

    #[test]
    fn a_jump_of_the_pose_is_followed() {
        let mut filter = LevelFilter::default();
        for i in 1..=2000 {
            let t = 0.01 * f64::from(i);
            filter.add_imu(&sample(t, &Vector3::zeros()));
            let elsewhere = if t > 15.0 { 100.0 } else { 0.0 };
            if i % 10 == 0 {
                filter.add_pose(at(t), &(Rigid3::translation(elsewhere, 0.0, 0.0) * pose(t)), true);
            }
        }
        let up = filter.add_imu(&sample(20.01, &Vector3::zeros())).linear_acceleration;
        let off = up.angle(&(pose(20.01).rotation.inverse() * Vector3::z()));
        assert!(off.to_degrees() < 0.3, "{off}");
    }

    #[test]
    fn invalid_samples_and_gaps_of_decades_do_no_harm() {
        let mut filter = LevelFilter::default();
        for i in 1..=1000 {
            let t = 0.01 * f64::from(i);
            filter.add_imu(&sample(t, &Vector3::zeros()));
            let nothing = Vector3::repeat(f64::NAN);
            assert!(
                filter
                    .add_imu(&ImuData { linear_acceleration: nothing, ..sample(t, &nothing) })
                    .angular_velocity
                    .x
                    .is_nan()
            );
            filter.add_imu(&sample(t - 5.0, &Vector3::zeros()));
            if i % 10 == 0 {
                filter.add_pose(at(t), &pose(t), true);
            }
        }
        let later = 2e9;
        for i in 0..=100 {
            let t = 10.0 + 0.01 * f64::from(i);
            filter.add_imu(&ImuData { time: at(t + later), ..sample(t, &Vector3::zeros()) });
            if i % 10 == 0 {
                filter.add_pose(at(t + later), &pose(t), true);
            }
        }
        let data = filter.add_imu(&ImuData { time: at(11.01 + later), ..sample(11.01, &Vector3::zeros()) });
        let off = data.linear_acceleration.angle(&(pose(11.01).rotation.inverse() * Vector3::z()));
        assert!(off.to_degrees() < 1.0, "{off}");
    }
}
