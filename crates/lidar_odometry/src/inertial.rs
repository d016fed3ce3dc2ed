//! The inertial filter in 3D: pose, velocity, biases and gravity, all in the local map ([`InertialEstimate`]), corrected by sweeps
//! of a lidar (Xu and Zhang 2021, "FAST-LIO").
//!
//! The IMU propagates the state from one sweep to the next. The registered pose of the sweep then corrects
//! all of it, except along degenerate directions. When a platform starts to move among trees, the
//! accelerometer shows this long before registration does: planes made by its own beams while it stood
//! still hold it at its old position.

#[cfg(test)]
mod tests;

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3, Time, Vector3, rotation_between};
use portolan_motion::{
    DegenerateDirections, ImuBuffer, InertialEntry, InertialEstimate, InertialNoise, Preintegrated,
    USUAL_GRAVITY,
};
use portolan_numeric::CovarianceMatching;
use portolan_sensor::ImuData;

use crate::segment::TrajectorySegment;
use crate::settings::constants::inertial::{
    COMPARED_SWEEPS, MAX_ACCELERATION, MAX_NOISE_FACTOR, UNKNOWN_SIGMA,
};
use crate::settings::{ImuSettings, InertialSettings, MotionPriorSettings, OdometrySettings};

/// A trajectory segment that the IMU predicts.
#[derive(Clone, Debug)]
pub(crate) struct InertialPrediction {
    pub segment: TrajectorySegment,
    /// At its end.
    estimate: InertialEstimate,
    measured: Preintegrated,
}

/// State in which the filter begins, or is reset after motion that it did not follow.
pub(crate) struct InertialStart {
    /// Pose of the tracking frame in the local map.
    pub local_from_tracking: Rigid3,
    /// m/s, in the local map.
    pub velocity: Vector3,
    /// Norm of the specific force that the accelerometer measures, m/s², if it is at rest.
    pub force_at_rest: Option<f64>,
}

/// Pose measurement at the end of a registered sweep.
pub(crate) struct PoseMeasurement<'a> {
    /// Pose of the tracking frame in the local map.
    pub local_from_tracking: &'a Rigid3,
    /// Directions along and about which it does not constrain, in the local map.
    pub degenerate: &'a DegenerateDirections,
    /// Covariance of the position error by attenuation, m². None where the sweep does not fit.
    pub attenuation: Option<na::Matrix3<f64>>,
    /// Whether the rotation adds information to that of the gyroscope.
    pub measures_rotation: bool,
    /// Whether the gyroscope measured the rotation since the last sweep.
    pub gyroscope_holds: bool,
    /// Whether the platform stands still.
    pub is_standing: bool,
}

/// The filter. It has no state before [`InertialFilter::begin`].
#[derive(Clone, Debug)]
pub(crate) struct InertialFilter {
    settings: InertialSettings,
    errors: InertialNoise,
    imu: ImuSettings,
    prior: MotionPriorSettings,
    /// Standard deviation of registered positions, metres: the noise of ranges.
    place_error: f64,
    outlier_sigmas: f64,
    /// Standard deviation of the velocity of a platform whose poses do not drift, m/s.
    standing_velocity: f64,
    /// Standard deviation of the specific force that an IMU at rest measures, m/s².
    resting_error: f64,
    samples: ImuBuffer,
    last: Option<Time>,
    estimate: Option<InertialEstimate>,
    /// Factor of the assumed variance of accelerations.
    noise: CovarianceMatching,
}

impl InertialFilter {
    pub fn new(settings: &OdometrySettings) -> Self {
        Self {
            settings: settings.inertial.clone(),
            errors: settings.inertial_noise(),
            imu: settings.imu.clone(),
            prior: settings.motion_prior.clone(),
            place_error: settings.plane_fit.range_noise,
            outlier_sigmas: settings.registration.outlier_sigmas,
            standing_velocity: settings.plane_fit.range_noise / (3.0 * settings.initialisation.leveling_time),
            resting_error: settings.standstill.acceleration_error,
            samples: ImuBuffer::default(),
            last: None,
            estimate: None,
            noise: CovarianceMatching::new(COMPARED_SWEEPS).within(1.0, MAX_NOISE_FACTOR),
        }
    }

    /// Takes a raw sample, in order of time.
    pub fn add_imu(&mut self, data: &ImuData) {
        self.samples.push(data);
    }

    /// A sample without the bias of the gyroscope.
    pub fn corrected(&self, data: &ImuData) -> ImuData {
        let bias = self.estimate.as_ref().map_or_else(Vector3::zeros, |estimate| estimate.gyroscope_bias);
        ImuData { angular_velocity: data.angular_velocity - bias, ..*data }
    }

    /// Begins at the end of the first sweep. `up` is the unit vector of the mean specific force in the
    /// local map.
    pub fn begin(&mut self, time: Time, start: &InertialStart, up: &Vector3) {
        let force = match start.force_at_rest {
            Some(strength) => (up * strength, self.resting_error),
            // If the platform accelerates while accelerations are averaged, it seems tilted.
            None => (up * USUAL_GRAVITY, self.prior.acceleration),
        };
        if !self.measures_gravity() {
            self.noise.distrust();
        }
        let rotation = start.local_from_tracking.rotation;
        self.estimate = Some(InertialEstimate::first(rotation, force, USUAL_GRAVITY, &self.errors));
        self.restart(time, start);
    }

    /// Whether the mean specific force is about gravity. If not, the accelerometer has other units.
    fn measures_gravity(&self) -> bool {
        let samples = self.samples.all();
        let sum: f64 = samples.iter().map(|sample| sample.linear_acceleration.norm()).sum();
        (sum / samples.len().max(1) as f64 - USUAL_GRAVITY).abs() < 0.5 * USUAL_GRAVITY
    }

    /// Resets pose and velocity at the end of a sweep, after motion that it did not follow. Biases and
    /// gravity remain.
    pub fn restart(&mut self, time: Time, start: &InertialStart) {
        let settings = &self.settings;
        let sigmas = [self.place_error, self.prior.least_rotation_error, settings.first_velocity];
        if let Some(estimate) = &mut self.estimate {
            estimate.moved_to(&start.local_from_tracking, start.velocity, sigmas);
        }
        self.last = Some(time);
        self.samples.forget_until(time);
    }

    /// Standard deviation of the velocity in its worst direction, m/s.
    pub fn velocity_sigma(&self) -> f64 {
        let most = self.settings.first_velocity;
        self.estimate.as_ref().map_or(most, |e| e.sigma_of(InertialEntry::Velocity).min(most))
    }

    /// Standard deviation about each axis of the rotation that the gyroscope measured during a segment,
    /// radians: by its noise, its scale errors, and its bias, which may still be unknown.
    pub fn rotation_sigma(&self, segment: &TrajectorySegment) -> f64 {
        let errors = &self.errors;
        let most = errors.gyroscope_bias;
        let bias = self.estimate.as_ref().map_or(most, |e| e.sigma_of(InertialEntry::Gyroscope).min(most));
        let (seconds, turn) = (segment.seconds(), segment.start().rotation.angle_to(&segment.end().rotation));
        let by_noise = errors.turn * seconds.sqrt();
        by_noise.hypot(errors.turn_scale * turn).hypot(bias * seconds)
    }

    /// Whether velocity and specific force at rest are certain enough to use the accelerometer.
    pub fn is_reliable(&self) -> bool {
        let settings = &self.settings;
        let is_sure = |estimate: &InertialEstimate| estimate.force_sigma() < settings.accelerometer_bias;
        self.velocity_sigma() < 0.5 * settings.first_velocity && self.estimate.as_ref().is_some_and(is_sure)
    }

    /// Rotation from the tracking frame, given in the local map, to a gravity-aligned one of the same
    /// heading; none before the filter begins.
    pub fn level_from_tracking(&self, local_from_tracking: &Quaternion) -> Option<Quaternion> {
        let up = self.estimate.as_ref()?.force_at_rest;
        Some(rotation_between(&up, &Vector3::z()) * local_from_tracking)
    }

    /// A segment over the times of `predicted` that begins where the last sweep ended, with the motion by
    /// the IMU. None where samples are missing or invalid.
    pub fn predict(&self, start: Time, predicted: &TrajectorySegment) -> Option<InertialPrediction> {
        let mut next = self.samples.count_until(start);
        if self.last != Some(start) || next == 0 || predicted.seconds() <= 0.0 {
            return None;
        }
        let samples = self.samples.all();
        let before = self.estimate.as_ref()?;
        let (mut estimate, mut measured) = (before.clone(), Preintegrated::default());
        let begin = predicted.start();
        let (to_begin, mut last, mut is_known) = (before.rotation.inverse(), 0.0, true);
        let segment = predicted.clone().changed(|seconds, pose| {
            let is_past = |s: &ImuData| s.time.seconds_since(start) <= seconds;
            while samples.get(next).is_some_and(is_past) {
                next += 1;
            }
            let sample = &samples[next - 1];
            is_known &= seconds - sample.time.seconds_since(start) <= self.imu.max_gap;
            is_known &= estimate.acceleration(&estimate.rotation, sample).norm() <= MAX_ACCELERATION;
            let middle = 0.5 * (last + seconds) - sample.time.seconds_since(start);
            let sample = between(sample, samples.get(next), middle);
            estimate.advance(&sample, seconds - last, &mut measured);
            let place = begin.translation.vector + estimate.place - before.place;
            *pose = Rigid3::from_parts(place.into(), begin.rotation * (to_begin * estimate.rotation));
            last = seconds;
        });
        is_known.then_some(InertialPrediction { segment, estimate, measured })
    }

    /// Updates the state to the end of a sweep: prediction, correction by the registered pose,
    /// zero-velocity update.
    pub fn update(&mut self, end: Time, prediction: &InertialPrediction, measured: &PoseMeasurement<'_>) {
        let mut estimate = prediction.estimate.clone();
        let noise = self.noise.variance_factor();
        estimate.propagate(&prediction.measured, noise, &self.errors);
        self.correct_rotation(&mut estimate, measured);
        self.correct_place(&mut estimate, measured);
        if measured.is_standing {
            let innovation = -estimate.velocity;
            estimate.correct(InertialEntry::Velocity, &innovation, &square(self.standing_velocity));
        }
        self.estimate = Some(estimate);
        self.last = Some(end);
        self.samples.forget_until(end);
    }

    /// The registered rotation updates the bias of the gyroscope, unless the gyroscope measured something
    /// else altogether.
    fn correct_rotation(&self, estimate: &mut InertialEstimate, measured: &PoseMeasurement<'_>) {
        let innovation = estimate.rotation_to(&measured.local_from_tracking.rotation);
        let error = with_unknown(square(self.prior.least_rotation_error), &measured.degenerate.rotations);
        let expected = estimate.covariance_of(InertialEntry::Rotation) + error;
        let is_possible = squared_mahalanobis(&innovation, &expected) < self.outlier_sigmas.powi(2);
        if !measured.gyroscope_holds || !is_possible {
            estimate.forget(InertialEntry::Rotation, UNKNOWN_SIGMA);
        } else if !measured.measures_rotation {
            return;
        }
        estimate.correct(InertialEntry::Rotation, &innovation, &error);
    }

    fn correct_place(&mut self, estimate: &mut InertialEstimate, measured: &PoseMeasurement<'_>) {
        let Some(attenuation) = measured.attenuation else { return };
        let innovation = measured.local_from_tracking.translation.vector - estimate.place;
        let known = square(self.place_error) + attenuation;
        let error = with_unknown(known, &measured.degenerate.translations);
        // Covariance matching: if innovations are larger than their covariance, the accelerometer is worse
        // than assumed; its clock, axes or units may be wrong.
        let constrained = 3_usize.saturating_sub(measured.degenerate.translations.len());
        if constrained > 0 {
            let squared =
                squared_mahalanobis(&innovation, &(estimate.covariance_of(InertialEntry::Place) + error));
            self.noise.add_relative(squared / constrained as f64);
        }
        estimate.correct(InertialEntry::Place, &innovation, &error);
    }
}

/// Interpolated sample of the IMU at this time after a sample, seconds; the sample itself if there is no
/// next one.
fn between(sample: &ImuData, next: Option<&ImuData>, seconds: f64) -> ImuData {
    let Some(next) = next else { return *sample };
    let fraction = (seconds / next.time.seconds_since(sample.time).max(1e-9)).clamp(0.0, 1.0);
    ImuData {
        time: sample.time,
        linear_acceleration: sample.linear_acceleration.lerp(&next.linear_acceleration, fraction),
        angular_velocity: sample.angular_velocity.lerp(&next.angular_velocity, fraction),
    }
}

fn square(sigma: f64) -> na::Matrix3<f64> {
    na::Matrix3::from_diagonal_element(sigma * sigma)
}

/// The covariance of a measurement, with large variance added along these directions.
fn with_unknown(known: na::Matrix3<f64>, degenerate: &[Vector3]) -> na::Matrix3<f64> {
    degenerate.iter().fold(known, |sum, d| sum + d * d.transpose() * (UNKNOWN_SIGMA * UNKNOWN_SIGMA))
}

fn squared_mahalanobis(error: &Vector3, covariance: &na::Matrix3<f64>) -> f64 {
    covariance.try_inverse().map_or(f64::INFINITY, |inverse| error.dot(&(inverse * error)))
}
