//! The inertial filter in 3D: pose, velocity, biases and gravity, all in the local map ([`InertialEstimate`]), corrected by sweeps
//! of a lidar (Xu and Zhang 2021, "FAST-LIO").
//!
//! From one sweep to the next the IMU moves the state on. Then the pose at which the sweep was registered corrects all of it, but not along degenerate directions. A platform that starts to move among trees is followed by the
//! accelerometer long before planes that its own beams drew while it stood let go of it.

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

/// Where the filter begins, or begins anew after what it did not follow.
pub(crate) struct InertialStart {
    /// Tracking in local.
    pub local_from_tracking: Rigid3,
    /// m/s, in the local map.
    pub velocity: Vector3,
    /// The strength of what the accelerometer measures, m/s², if it is at rest.
    pub force_at_rest: Option<f64>,
}

/// What a registered sweep says of the pose at its end.
pub(crate) struct PoseMeasurement<'a> {
    /// Tracking in local.
    pub local_from_tracking: &'a Rigid3,
    /// Along and about which it says nothing, in the local map.
    pub degenerate: &'a DegenerateDirections,
    /// Covariance of what attenuation may keep the place off by, m². None where the sweep fits nothing.
    pub attenuation: Option<na::Matrix3<f64>>,
    /// Whether the rotation tells something that the gyroscope does not know.
    pub tells_rotation: bool,
    /// Whether the gyroscope measured the rotation from the last sweep on.
    pub gyroscope_holds: bool,
    /// Whether the platform stands.
    pub is_standing: bool,
}

/// The filter. It knows nothing before [`InertialFilter::begin`].
#[derive(Clone, Debug)]
pub(crate) struct InertialFilter {
    settings: InertialSettings,
    errors: InertialNoise,
    imu: ImuSettings,
    prior: MotionPriorSettings,
    /// Standard deviation of registered places, metres: the noise of ranges.
    place_error: f64,
    outlier_sigmas: f64,
    /// Standard deviation of the velocity of a platform whose poses do not drift, m/s.
    standing_velocity: f64,
    /// Standard deviation of the force that an IMU at rest measures, m/s².
    resting_error: f64,
    samples: ImuBuffer,
    last: Option<Time>,
    estimate: Option<InertialEstimate>,
    /// How many times the variance of accelerations is what it is said to be.
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

    /// Takes a sample as it was measured, in order of time.
    pub fn add_imu(&mut self, data: &ImuData) {
        self.samples.push(data);
    }

    /// A sample without the bias of the gyroscope.
    pub fn corrected(&self, data: &ImuData) -> ImuData {
        let bias = self.estimate.as_ref().map_or_else(Vector3::zeros, |estimate| estimate.gyroscope_bias);
        ImuData { angular_velocity: data.angular_velocity - bias, ..*data }
    }

    /// Begins at the end of the first sweep, where accelerations point up along a unit vector in the local map.
    pub fn begin(&mut self, time: Time, start: &InertialStart, up: &Vector3) {
        let force = match start.force_at_rest {
            Some(strength) => (up * strength, self.resting_error),
            // A platform that speeds up while accelerations are averaged seems to lean.
            None => (up * USUAL_GRAVITY, self.prior.acceleration),
        };
        if !self.measures_gravity() {
            self.noise.distrust();
        }
        let rotation = start.local_from_tracking.rotation;
        self.estimate = Some(InertialEstimate::first(rotation, force, USUAL_GRAVITY, &self.errors));
        self.begin_anew(time, start);
    }

    /// Whether the accelerometer measures about gravity in the mean. Its units are others if it does not.
    fn measures_gravity(&self) -> bool {
        let samples = self.samples.all();
        let sum: f64 = samples.iter().map(|sample| sample.linear_acceleration.norm()).sum();
        (sum / samples.len().max(1) as f64 - USUAL_GRAVITY).abs() < 0.5 * USUAL_GRAVITY
    }

    /// Begins anew at the end of a sweep, after what it did not follow. Biases and gravity remain.
    pub fn begin_anew(&mut self, time: Time, start: &InertialStart) {
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

    /// Standard deviation about each axis of the rotation that the gyroscope measured during a segment, radians: its noise, its errors of
    /// scale, and its bias, which may not be known yet.
    pub fn rotation_sigma(&self, segment: &TrajectorySegment) -> f64 {
        let errors = &self.errors;
        let most = errors.gyroscope_bias;
        let bias = self.estimate.as_ref().map_or(most, |e| e.sigma_of(InertialEntry::Gyroscope).min(most));
        let (seconds, turn) = (segment.seconds(), segment.start().rotation.angle_to(&segment.end().rotation));
        let by_noise = errors.turn * seconds.sqrt();
        by_noise.hypot(errors.turn_scale * turn).hypot(bias * seconds)
    }

    /// Whether velocity and force at rest are known well enough for the accelerometer to be relied on.
    pub fn is_reliable(&self) -> bool {
        let settings = &self.settings;
        let is_sure = |estimate: &InertialEstimate| estimate.force_sigma() < settings.accelerometer_bias;
        self.velocity_sigma() < 0.5 * settings.first_velocity && self.estimate.as_ref().is_some_and(is_sure)
    }

    /// From the tracking frame, which lies in the local map as given, to a gravity-aligned one of the same heading; none
    /// before the filter began.
    pub fn level_from_tracking(&self, local_from_tracking: &Quaternion) -> Option<Quaternion> {
        let up = self.estimate.as_ref()?.force_at_rest;
        Some(rotation_between(&up, &Vector3::z()) * local_from_tracking)
    }

    /// A segment over the times of `predicted` that begins where the last sweep ended, and moves as the IMU says. None where
    /// that is not known.
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

    /// Goes on to the end of a sweep: prediction, correction by the registered pose, correction by a zero velocity.
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

    /// The registered rotation tells the bias of the gyroscope, unless that measured something else altogether.
    fn correct_rotation(&self, estimate: &mut InertialEstimate, measured: &PoseMeasurement<'_>) {
        let innovation = estimate.rotation_to(&measured.local_from_tracking.rotation);
        let error = with_unknown(square(self.prior.least_rotation_error), &measured.degenerate.rotations);
        let expected = estimate.covariance_of(InertialEntry::Rotation) + error;
        let is_possible = squared_mahalanobis(&innovation, &expected) < self.outlier_sigmas.powi(2);
        if !measured.gyroscope_holds || !is_possible {
            estimate.forget(InertialEntry::Rotation, UNKNOWN_SIGMA);
        } else if !measured.tells_rotation {
            return;
        }
        estimate.correct(InertialEntry::Rotation, &innovation, &error);
    }

    fn correct_place(&mut self, estimate: &mut InertialEstimate, measured: &PoseMeasurement<'_>) {
        let Some(attenuation) = measured.attenuation else { return };
        let innovation = measured.local_from_tracking.translation.vector - estimate.place;
        let known = square(self.place_error) + attenuation;
        let error = with_unknown(known, &measured.degenerate.translations);
        // Innovations are as large as their covariance says, or else the accelerometer is worse than it is said to be: its
        // clock, axes or units may be wrong.
        let constrained = 3_usize.saturating_sub(measured.degenerate.translations.len());
        if constrained > 0 {
            let squared =
                squared_mahalanobis(&innovation, &(estimate.covariance_of(InertialEntry::Place) + error));
            self.noise.add_relative(squared / constrained as f64);
        }
        estimate.correct(InertialEntry::Place, &innovation, &error);
    }
}

/// What an IMU measures so many seconds after a sample, if the next one is known; else the sample holds.
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

/// What was measured with a covariance, but not along some directions.
fn with_unknown(known: na::Matrix3<f64>, degenerate: &[Vector3]) -> na::Matrix3<f64> {
    degenerate.iter().fold(known, |sum, d| sum + d * d.transpose() * (UNKNOWN_SIGMA * UNKNOWN_SIGMA))
}

fn squared_mahalanobis(error: &Vector3, covariance: &na::Matrix3<f64>) -> f64 {
    covariance.try_inverse().map_or(f64::INFINITY, |inverse| error.dot(&(inverse * error)))
}
