//! Gyroscope and accelerometer: angular velocity and specific force of the exact motion, with noise and
//! biases that follow random walks.

use std::sync::Arc;

use portolan_geometry::{Rigid3, Vector3};
use portolan_recording::{Header, Imu, Message, RecordedMessage};

use super::stream::{Clock, MessageStream, Schedule, Ticks};
use crate::motion::{Motion, MotionState};
use portolan_worlds::Random;

/// An inertial measurement unit. Noise is given as density, as in data sheets: a sample at the rate f
/// has the standard deviation density · √f.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuOptions {
    /// Topic of its `sensor_msgs/Imu`. Default `/imu`.
    pub topic: String,
    /// Its frame. Default `imu_link`.
    pub frame: String,
    /// Pose of the IMU on the robot. Default at `base_link`.
    pub base_from_imu: Rigid3,
    /// Samples per second. Default 100.
    pub rate: f64,
    /// Noise of the gyroscope, rad/s/√Hz. Default 2e-4.
    pub gyroscope_noise: f64,
    /// Noise of the accelerometer, m/s²/√Hz. Default 2e-3.
    pub accelerometer_noise: f64,
    /// Standard deviation of the bias of each gyroscope axis at the start, rad/s. Default 2e-3.
    pub gyroscope_bias: f64,
    /// Standard deviation of the bias of each accelerometer axis at the start, m/s². Default 0.03.
    pub accelerometer_bias: f64,
    /// Random walk of the gyroscope biases, rad/s/√s. Default 2e-5.
    pub gyroscope_bias_walk: f64,
    /// Random walk of the accelerometer biases, m/s²/√s. Default 3e-4.
    pub accelerometer_bias_walk: f64,
    /// Gravity, m/s². Default 9.81.
    pub gravity: f64,
}

impl Default for ImuOptions {
    fn default() -> Self {
        Self {
            topic: "/imu".to_owned(),
            frame: "imu_link".to_owned(),
            base_from_imu: Rigid3::identity(),
            rate: 100.0,
            gyroscope_noise: 2e-4,
            accelerometer_noise: 2e-3,
            gyroscope_bias: 2e-3,
            accelerometer_bias: 0.03,
            gyroscope_bias_walk: 2e-5,
            accelerometer_bias_walk: 3e-4,
            gravity: 9.81,
        }
    }
}

impl ImuOptions {
    /// The same unit without noise and biases.
    pub fn without_noise(self) -> Self {
        Self {
            gyroscope_noise: 0.0,
            accelerometer_noise: 0.0,
            gyroscope_bias: 0.0,
            accelerometer_bias: 0.0,
            gyroscope_bias_walk: 0.0,
            accelerometer_bias_walk: 0.0,
            ..self
        }
    }
}

/// Angular velocity (rad/s) and specific force (m/s²) in the frame of an IMU on the robot. At rest the
/// specific force points up with the value of gravity.
pub(crate) fn exact_sample(state: &MotionState, base_from_imu: &Rigid3, gravity: f64) -> (Vector3, Vector3) {
    let base_from_map = state.map_from_base.rotation.inverse();
    let in_base = base_from_map * (state.acceleration_in_map + Vector3::new(0.0, 0.0, gravity));
    let (omega, alpha) = (state.angular_velocity_in_base, state.angular_acceleration_in_base);
    let arm = base_from_imu.translation.vector;
    let at_imu = in_base + alpha.cross(&arm) + omega.cross(&omega.cross(&arm));
    let imu_from_base = base_from_imu.rotation.inverse();
    (imu_from_base * omega, imu_from_base * at_imu)
}

/// The messages of the IMU.
pub(crate) struct ImuStream<M> {
    options: ImuOptions,
    topic: Arc<str>,
    frame: Arc<str>,
    motion: Arc<M>,
    ticks: Ticks,
    seed: u64,
    gyroscope_bias: Vector3,
    accelerometer_bias: Vector3,
}

impl<M: Motion> ImuStream<M> {
    pub fn new(options: ImuOptions, motion: Arc<M>, clock: Clock, schedule: Schedule, seed: u64) -> Self {
        let mut random = Random::new(seed, "biases", 0);
        Self {
            topic: options.topic.as_str().into(),
            frame: options.frame.as_str().into(),
            gyroscope_bias: random.gaussian_vector() * options.gyroscope_bias,
            accelerometer_bias: random.gaussian_vector() * options.accelerometer_bias,
            options,
            motion,
            ticks: Ticks::new(clock, schedule),
            seed,
        }
    }
}

impl<M: Motion> MessageStream for ImuStream<M> {
    fn next_message(&mut self) -> Option<RecordedMessage> {
        let (index, seconds, stamp) = self.ticks.next()?;
        let o = &self.options;
        let mut random = Random::new(self.seed, "imu", index);
        let state = self.motion.state(seconds);
        let (omega, force) = exact_sample(&state, &o.base_from_imu, o.gravity);
        let (per_sample, per_step) = (o.rate.sqrt(), (1.0 / o.rate).sqrt());
        let (gyroscope_noise, force_noise) =
            (o.gyroscope_noise * per_sample, o.accelerometer_noise * per_sample);
        let omega = omega + self.gyroscope_bias + random.gaussian_vector() * gyroscope_noise;
        let force = force + self.accelerometer_bias + random.gaussian_vector() * force_noise;
        self.gyroscope_bias += random.gaussian_vector() * (o.gyroscope_bias_walk * per_step);
        self.accelerometer_bias += random.gaussian_vector() * (o.accelerometer_bias_walk * per_step);
        let imu = Imu {
            header: Header { stamp, frame_id: Arc::clone(&self.frame) },
            // No orientation is measured, which −1 in the covariance reports.
            orientation_xyzw: [0.0, 0.0, 0.0, 1.0],
            orientation_covariance: [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            angular_velocity: omega.into(),
            angular_velocity_covariance: diagonal(gyroscope_noise * gyroscope_noise),
            linear_acceleration: force.into(),
            linear_acceleration_covariance: diagonal(force_noise * force_noise),
        };
        Some(RecordedMessage { topic: Arc::clone(&self.topic), log_time: stamp, message: Message::Imu(imu) })
    }
}

/// A multiple of the 3×3 identity, row by row.
fn diagonal(value: f64) -> [f64; 9] {
    [value, 0.0, 0.0, 0.0, value, 0.0, 0.0, 0.0, value]
}
