//! Wheel odometry of a differential drive: the integrated counts of the encoders.

use std::sync::Arc;

use portolan_geometry::Rigid2;
use portolan_recording::{Header, Message, Odometry, Pose, RecordedMessage};

use super::stream::{Clock, MessageStream, Schedule, Ticks};
use crate::motion::Rolling;
use portolan_worlds::Random;

/// Wheels with encoders.
#[derive(Clone, Debug, PartialEq)]
pub struct OdometryOptions {
    /// Topic of its `nav_msgs/Odometry`. Default `/odom`.
    pub topic: String,
    /// Frame of its poses; the child is `base_link`. Default `odom`.
    pub frame: String,
    /// Messages per second. Default 50.
    pub rate: f64,
    /// Distance between the wheels, metres. Default 0.4.
    pub wheel_separation: f64,
    /// Standard deviation of the relative error of each wheel's circumference; drawn once from the
    /// seed. Default 0.005.
    pub wheel_size_error: f64,
    /// Standard deviation of the relative error of the wheel separation; drawn once. Default 0.01.
    pub wheel_separation_error: f64,
    /// Random error of each wheel, metres after one metre; grows with the square root of the distance.
    /// Default 0.004.
    pub noise: f64,
    /// Slip events per minute. Default 1.
    pub slips_per_minute: f64,
    /// Fraction by which a slipping wheel turns farther than the ground moves. Default 0.3.
    pub slip_ratio: f64,
    /// Metres of travel per encoder count; 0 for infinitely fine. Default 0.0005.
    pub encoder_resolution: f64,
}

impl Default for OdometryOptions {
    fn default() -> Self {
        Self {
            topic: "/odom".to_owned(),
            frame: "odom".to_owned(),
            rate: 50.0,
            wheel_separation: 0.4,
            wheel_size_error: 0.005,
            wheel_separation_error: 0.01,
            noise: 0.004,
            slips_per_minute: 1.0,
            slip_ratio: 0.3,
            encoder_resolution: 0.0005,
        }
    }
}

impl OdometryOptions {
    /// The same wheels without any error except that of the integration.
    pub fn without_noise(self) -> Self {
        Self {
            wheel_size_error: 0.0,
            wheel_separation_error: 0.0,
            noise: 0.0,
            slips_per_minute: 0.0,
            encoder_resolution: 0.0,
            ..self
        }
    }
}

/// One wheel with its encoder.
#[derive(Clone, Copy, Debug)]
struct Wheel {
    /// Relative error of the circumference.
    size_error: f64,
    /// Distance turned so far, as the encoder measures it, metres.
    turned: f64,
    /// Distance counted so far, metres.
    counted: f64,
}

impl Wheel {
    /// Turns the wheel for `distance` metres of ground. Gives the distance counted, metres.
    fn turn(&mut self, distance: f64, slip: f64, noise: f64, resolution: f64) -> f64 {
        self.turned += distance * (1.0 + self.size_error) * (1.0 + slip) + noise * distance.abs().sqrt();
        let counted =
            if resolution > 0.0 { (self.turned / resolution).floor() * resolution } else { self.turned };
        let step = counted - self.counted;
        self.counted = counted;
        step
    }
}

/// The messages of the wheels.
pub(crate) struct OdometryStream<M> {
    options: OdometryOptions,
    topic: Arc<str>,
    frame: Arc<str>,
    child_frame: Arc<str>,
    motion: Arc<M>,
    ticks: Ticks,
    seed: u64,
    wheels: [Wheel; 2],
    assumed_separation: f64,
    odom_from_base: Rigid2,
    /// Time, distance and heading at the previous message.
    before: (f64, f64, f64),
}

impl<M: Rolling> OdometryStream<M> {
    pub fn new(
        options: OdometryOptions,
        child_frame: &str,
        motion: Arc<M>,
        clock: Clock,
        schedule: Schedule,
        seed: u64,
    ) -> Self {
        let mut random = Random::new(seed, "wheels", 0);
        let mut wheel =
            || Wheel { size_error: options.wheel_size_error * random.gaussian(), turned: 0.0, counted: 0.0 };
        let wheels = [wheel(), wheel()];
        let assumed_separation =
            options.wheel_separation * (1.0 + options.wheel_separation_error * random.gaussian()).max(0.1);
        let (travelled, heading) = motion.rolled(0.0);
        Self {
            topic: options.topic.as_str().into(),
            frame: options.frame.as_str().into(),
            child_frame: child_frame.into(),
            options,
            motion,
            ticks: Ticks::new(clock, schedule),
            seed,
            wheels,
            assumed_separation,
            odom_from_base: Rigid2::identity(),
            before: (0.0, travelled, heading),
        }
    }

    /// Advances to `time` seconds. Gives forward and angular velocity as counted, m/s and rad/s.
    fn advance(&mut self, index: u64, time: f64) -> (f64, f64) {
        let (travelled, heading) = self.motion.rolled(time);
        let (time_before, travelled_before, heading_before) = self.before;
        let (forward, turned) = (travelled - travelled_before, heading - heading_before);
        self.before = (time, travelled, heading);
        let slips = self.slips(0.5 * (time + time_before));
        let mut random = Random::new(self.seed, "encoders", index);
        let mut counted = [0.0; 2];
        for (side, (wheel, slip)) in self.wheels.iter_mut().zip(slips).enumerate() {
            let sign = if side == 0 { -1.0 } else { 1.0 };
            let distance = forward + sign * 0.5 * turned * self.options.wheel_separation;
            let noise = self.options.noise * random.gaussian();
            counted[side] = wheel.turn(distance, slip, noise, self.options.encoder_resolution);
        }
        let step = 0.5 * (counted[0] + counted[1]);
        let angle = (counted[1] - counted[0]) / self.assumed_separation;
        self.add_arc(step, angle);
        let seconds = time - time_before;
        if seconds > 0.0 { (step / seconds, angle / seconds) } else { (0.0, 0.0) }
    }

    /// Adds an arc of `step` metres that turns by `angle`: its chord has the length
    /// step · sin(angle/2)/(angle/2) and the mean direction.
    fn add_arc(&mut self, step: f64, angle: f64) {
        let half = 0.5 * angle;
        let chord = if half.abs() < 1e-6 { step } else { step * libm::sin(half) / half };
        let (sine, cosine) = libm::sincos(self.odom_from_base.angle + half);
        self.odom_from_base.translation.x += chord * cosine;
        self.odom_from_base.translation.y += chord * sine;
        self.odom_from_base.angle += angle;
    }

    /// Slip of the left and the right wheel at `time` seconds, as a fraction. In every second at most one
    /// event of up to 0.6 s begins.
    fn slips(&self, time: f64) -> [f64; 2] {
        let mut slips = [0.0; 2];
        if self.options.slips_per_minute <= 0.0 {
            return slips;
        }
        let second = time.max(0.0) as u64;
        for window in second.saturating_sub(1)..=second {
            let mut random = Random::new(self.seed, "slip", window);
            if !random.chance(self.options.slips_per_minute / 60.0) {
                continue;
            }
            let begin = window as f64 + random.uniform();
            let end = begin + random.between(0.2, 0.6);
            let ratio = self.options.slip_ratio * random.between(0.5, 1.5);
            let which = random.below(3);
            if (begin..end).contains(&time) {
                for (side, slip) in slips.iter_mut().enumerate() {
                    *slip += if which == 2 || which == side { ratio } else { 0.0 };
                }
            }
        }
        slips
    }
}

impl<M: Rolling> MessageStream for OdometryStream<M> {
    fn next_message(&mut self) -> Option<RecordedMessage> {
        let (index, seconds, stamp) = self.ticks.next()?;
        let (forward, turn_rate) = self.advance(index, seconds);
        let odometry = Odometry {
            header: Header { stamp, frame_id: Arc::clone(&self.frame) },
            child_frame_id: Arc::clone(&self.child_frame),
            pose: pose_2d(&self.odom_from_base),
            pose_covariance: diagonal([1e-3, 1e-3, 1e-6, 1e-6, 1e-6, 1e-2]),
            linear_velocity: [forward, 0.0, 0.0],
            angular_velocity: [0.0, 0.0, turn_rate],
            twist_covariance: diagonal([1e-4, 1e-6, 1e-6, 1e-6, 1e-6, 1e-3]),
        };
        let message = Message::Odometry(odometry);
        Some(RecordedMessage { topic: Arc::clone(&self.topic), log_time: stamp, message })
    }
}

/// A pose in 2D in the form of messages.
fn pose_2d(pose: &Rigid2) -> Pose {
    let (sine, cosine) = libm::sincos(0.5 * pose.normalized_angle());
    Pose {
        position: [pose.translation.x, pose.translation.y, 0.0],
        orientation_xyzw: [0.0, 0.0, sine, cosine],
    }
}

/// A 6×6 matrix, row by row.
fn diagonal(values: [f64; 6]) -> Vec<f64> {
    let mut matrix = vec![0.0; 36];
    for (i, value) in values.into_iter().enumerate() {
        matrix[7 * i] = value;
    }
    matrix
}
