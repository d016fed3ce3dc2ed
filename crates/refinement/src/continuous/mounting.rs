//! Estimates mountings and clocks of sensors relative to each other from motions: those of the refined
//! trajectory, which the points have determined, against those of the input or of the IMU.

use nalgebra::DVector;
use portolan_geometry::{
    Rigid3, Time, Vector3, angle_axis_from_quaternion, nalgebra as na, quaternion_from_angle_axis,
};
use serde::Serialize;

use super::DenseTrajectory;
use super::regression::{Fit, fit};
use crate::motion_sensors::MotionSensors;

/// Duration of the motions that are compared, seconds.
const SEGMENT: f64 = 0.5;
/// Maximum number of these motions, spread over the whole.
const MOST: usize = 1500;
/// Number of standard deviations by which an estimate must differ from zero.
const SIGNIFICANT: f64 = 8.0;
/// Minimum fraction of the differences that an estimate must explain. A wrong mounting explains nearly all of
/// them, errors that happen to be similar at every corner a quarter.
const EXPLAINED: f64 = 0.4;
/// Minimum size of an estimate that matters: metres, radians, seconds.
const MATTERS: [f64; 3] = [0.005, 0.002, 0.003];
/// Number of parts of the time for which the estimate is repeated.
const PARTS: usize = 3;
/// Maximum difference of these estimates, as a fraction of the estimate.
const CONSTANT: f64 = 0.4;
/// Prior standard deviations: translation (metres), rotation (radians), delay (seconds), bias of a gyroscope
/// (rad/s), of an accelerometer and gravity (m/s²).
const PRIOR: [f64; 6] = [0.5, 0.3, 0.2, 0.1, 0.3, 20.0];
/// Ratio of the estimated to the prior standard deviation above which the motion does not determine a value.
const DETERMINED: f64 = 0.3;

/// Mounting of one sensor relative to another, with standard deviations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mounting {
    /// Name of the comparison.
    #[serde(rename = "what")]
    pub name: String,
    /// Translation, metres, axes of the tracking frame.
    pub translation: [f64; 3],
    /// Its standard deviations.
    pub translation_deviation: [f64; 3],
    /// Rotation vector, radians, axes of the tracking frame.
    pub rotation: [f64; 3],
    /// Its standard deviations.
    pub rotation_deviation: [f64; 3],
    /// Seconds to be added to the stamps.
    pub delay: f64,
    /// Its standard deviation.
    pub delay_deviation: f64,
    /// Names of the components that the motion does not determine.
    pub undetermined: Vec<&'static str>,
}

pub(crate) const NAMES: [&str; 7] = [
    "translation along x",
    "translation along y",
    "translation along z",
    "rotation about x",
    "rotation about y",
    "rotation about z",
    "delay",
];

impl Mounting {
    pub(crate) fn new(name: &str, value: [f64; 7], deviation: [f64; 7], prior: [f64; 3]) -> Self {
        let three = |v: &[f64; 7], first: usize| [v[first], v[first + 1], v[first + 2]];
        Self {
            name: name.to_owned(),
            translation: three(&value, 0),
            translation_deviation: three(&deviation, 0),
            rotation: three(&value, 3),
            rotation_deviation: three(&deviation, 3),
            delay: value[6],
            delay_deviation: deviation[6],
            undetermined: (0..7)
                .filter(|k| deviation[*k] > DETERMINED * prior[k / 3])
                .map(|k| NAMES[k])
                .collect(),
        }
    }

    /// Whether translation, rotation and delay are significant and large enough to matter.
    pub(crate) fn significant(&self, times: f64) -> [bool; 3] {
        let beyond = |value: &[f64; 3], deviation: &[f64; 3], matters: f64| {
            let norm = value.iter().map(|v| v * v).sum::<f64>().sqrt();
            norm > matters && value.iter().zip(deviation).any(|(v, d)| v.abs() > times * d)
        };
        [
            beyond(&self.translation, &self.translation_deviation, MATTERS[0]),
            beyond(&self.rotation, &self.rotation_deviation, MATTERS[1]),
            self.delay.abs() > MATTERS[2].max(times * self.delay_deviation),
        ]
    }

    /// The significant parts in words.
    pub(crate) fn words(&self, significant: [bool; 3]) -> String {
        let [x, y, z] = self.translation.map(|v| 100.0 * v);
        let [a, b, c] = self.rotation.map(f64::to_degrees);
        let parts = [
            format!("translated by ({x:.1}, {y:.1}, {z:.1}) cm"),
            format!("rotated by ({a:.2}, {b:.2}, {c:.2}) deg"),
            format!("delayed by {:.3} s", self.delay),
        ];
        let significant_parts: Vec<String> =
            parts.into_iter().zip(significant).filter(|p| p.1).map(|p| p.0).collect();
        significant_parts.join(" and ")
    }
}

/// Times at which the compared motions begin, spread over the trajectory.
fn moments(trajectory: &DenseTrajectory) -> Vec<f64> {
    let last = trajectory.duration() - SEGMENT - 2.0 * PRIOR[2];
    let count = ((last - PRIOR[2]) / (0.5 * SEGMENT)).max(0.0) as usize;
    let stride = count.div_ceil(MOST).max(1);
    (0..count).step_by(stride).map(|i| PRIOR[2] + i as f64 * 0.5 * SEGMENT).collect()
}

fn motion(pose: impl Fn(f64) -> Rigid3, from: f64) -> Rigid3 {
    pose(from).inverse() * pose(from + SEGMENT)
}

fn three(v: &DVector<f64>, first: usize) -> Vector3 {
    Vector3::new(v[first], v[first + 1], v[first + 2])
}

fn seven(fit: &Fit) -> ([f64; 7], [f64; 7]) {
    (std::array::from_fn(|k| fit.value[k]), std::array::from_fn(|k| fit.deviation(k)))
}

/// Fits one rotation and translation of the sensors in the tracking frame, and one delay of the trajectory,
/// to the difference between input and result: with them the motions of the input fit those of the points;
/// the delay is added to its stamps. None if they explain little, or are not constant in time, as with drift.
pub(crate) fn of_input(trajectory: &DenseTrajectory, gaps: &[[f64; 2]]) -> Option<Mounting> {
    let is_free = |s: &f64| !gaps.iter().any(|g| *s < g[1] + 0.5 && s + SEGMENT > g[0] - 0.5);
    let moments: Vec<f64> = moments(trajectory).into_iter().filter(is_free).collect();
    let whole = fit_input(trajectory, &moments)?;
    if whole.explained < EXPLAINED {
        return None;
    }
    let (mut value, deviation) = seven(&whole);
    let parts: Vec<Fit> = moments
        .chunks(moments.len().div_ceil(PARTS))
        .filter_map(|part| fit_input(trajectory, part))
        .collect();
    for range in [0..3, 3..6, 6..7] {
        let norm = |v: &dyn Fn(usize) -> f64| range.clone().map(|k| v(k).powi(2)).sum::<f64>().sqrt();
        let size = norm(&|k| value[k]);
        let is_constant = |part: &Fit| norm(&|k| part.value[k] - whole.value[k]) < CONSTANT * size;
        if parts.len() < PARTS || !parts.iter().all(is_constant) {
            range.for_each(|k| value[k] = 0.0);
        }
    }
    let mounting = Mounting::new("input", value, deviation, [PRIOR[0], PRIOR[1], PRIOR[2]]);
    mounting.significant(SIGNIFICANT).contains(&true).then_some(mounting)
}

fn fit_input(trajectory: &DenseTrajectory, moments: &[f64]) -> Option<Fit> {
    let seen: Vec<Rigid3> = moments.iter().map(|s| motion(|s| trajectory.pose(s), *s)).collect();
    let residuals = |v: &DVector<f64>| -> Vec<Vec<f64>> {
        let turn = quaternion_from_angle_axis(&three(v, 3));
        let moved = Rigid3::from_parts(three(v, 0).into(), turn);
        let residual = |(s, seen): (&f64, &Rigid3)| {
            // Added to the stamps: the pose of the input at s − delay belongs to s.
            let input = motion(|s| trajectory.joined_pose(s - v[6]), *s);
            let difference = seen.inverse() * moved * input * moved.inverse();
            let (t, r) = (difference.translation.vector, angle_axis_from_quaternion(&difference.rotation));
            vec![t.x, t.y, t.z, r.x, r.y, r.z]
        };
        moments.iter().zip(&seen).map(residual).collect()
    };
    let prior: [f64; 7] = std::array::from_fn(|k| 1.0 / PRIOR[k / 3].powi(2));
    fit(residuals, &[0, 0, 0, 1, 1, 1], &[1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 2e-3], &prior)
}

/// Mounting of the IMU relative to the tracking frame that the points have determined, and its delay:
/// rotation and delay from the gyroscope, translation from the accelerometer.
pub(crate) fn of_imu(trajectory: &DenseTrajectory, sensors: &MotionSensors, start: Time) -> Option<Mounting> {
    let track = sensors.gyroscope_track(start, &Vector3::zeros())?;
    let moments = moments(trajectory);
    let by_gyroscope = |v: &DVector<f64>| -> Vec<Vec<f64>> {
        let turn = quaternion_from_angle_axis(&three(v, 0));
        let residual = |s: &f64| {
            let Some(measured) = track.motion(s - v[6], s - v[6] + SEGMENT) else { return vec![0.0; 3] };
            let bias = quaternion_from_angle_axis(&(three(v, 3) * -SEGMENT));
            let turned = motion(|s| trajectory.pose(s), *s).rotation;
            let in_tracking = turn * (measured.rotation * bias) * turn.inverse();
            let r = angle_axis_from_quaternion(&(turned.inverse() * in_tracking));
            vec![r.x, r.y, r.z]
        };
        moments.iter().map(residual).collect()
    };
    let variances = [PRIOR[1], PRIOR[1], PRIOR[1], PRIOR[3], PRIOR[3], PRIOR[3], PRIOR[2]];
    let prior = variances.map(|p| 1.0 / (p * p));
    let turned = fit(by_gyroscope, &[0, 0, 0], &[1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 2e-3], &prior)?;
    let (turn, delay) = (quaternion_from_angle_axis(&three(&turned.value, 0)), turned.value[6]);
    let shifted = by_accelerometer(trajectory, sensors, start, turn, delay)?;
    let pick = |of_turn: &dyn Fn(usize) -> f64, of_shift: &dyn Fn(usize) -> f64| -> [f64; 7] {
        std::array::from_fn(|k| match k {
            0..3 => of_shift(k),
            3..6 => of_turn(k - 3),
            _ => of_turn(6),
        })
    };
    let value = pick(&|k| turned.value[k], &|k| shifted.value[k]);
    let deviation = pick(&|k| turned.deviation(k), &|k| shifted.deviation(k));
    Some(Mounting::new("IMU", value, deviation, [PRIOR[0], PRIOR[1], PRIOR[2]]))
}

/// Lever arm, bias and gravity: compares the change of velocity over an interval from the accelerometer with
/// that of its position.
fn by_accelerometer(
    trajectory: &DenseTrajectory,
    sensors: &MotionSensors,
    start: Time,
    turn: portolan_geometry::Quaternion,
    delay: f64,
) -> Option<Fit> {
    struct Segment {
        /// Change of velocity: measured by the accelerometer minus that of the tracking frame, world axes.
        change: Vector3,
        /// Maps a lever arm to its change of velocity.
        lever: na::Matrix3<f64>,
        /// Maps a bias to its change of velocity.
        bias: na::Matrix3<f64>,
        seconds: f64,
    }
    let samples = sensors.imu();
    let seconds = |i: usize| samples[i].time.seconds_since(start) + delay;
    let mut segments = Vec::new();
    for from in moments(trajectory) {
        let first = samples.partition_point(|s| s.time.seconds_since(start) + delay < from);
        let end = samples.partition_point(|s| s.time.seconds_since(start) + delay < from + SEGMENT);
        if end - first < 10 || end >= samples.len() {
            continue;
        }
        let (mut change, mut bias) = (Vector3::zeros(), na::Matrix3::zeros());
        for (i, sample) in samples.iter().enumerate().take(end).skip(first) {
            let rotation = trajectory.pose(seconds(i)).rotation;
            let step = seconds(i + 1) - seconds(i);
            change += rotation * (turn * sample.linear_acceleration) * step;
            bias += rotation.to_rotation_matrix().into_inner() * step;
        }
        let ends = [seconds(first), seconds(end)];
        let [(v0, w0), (v1, w1)] = ends.map(|s| trajectory.velocity(s));
        let [r0, r1] = ends.map(|s| trajectory.pose(s).rotation.to_rotation_matrix().into_inner());
        let lever = w1.cross_matrix() * r1 - w0.cross_matrix() * r0;
        segments.push(Segment { change: change - (v1 - v0), lever, bias, seconds: ends[1] - ends[0] });
    }
    let residuals = |v: &DVector<f64>| -> Vec<Vec<f64>> {
        let residual = |s: &Segment| {
            let r = s.change - s.lever * three(v, 0) - s.bias * three(v, 3) - three(v, 6) * s.seconds;
            vec![r.x, r.y, r.z]
        };
        segments.iter().map(residual).collect()
    };
    let deviations =
        [PRIOR[0], PRIOR[0], PRIOR[0], PRIOR[4], PRIOR[4], PRIOR[4], PRIOR[5], PRIOR[5], PRIOR[5]];
    fit(residuals, &[0, 0, 0], &[1e-2; 9], &deviations.map(|d| 1.0 / (d * d)))
}
