//! Terms of gyroscope, accelerometer, wheels and fixes. The accuracy of each is estimated from its deviations
//! from the current trajectory, so that no data sheet is needed and an inaccurate sensor does no harm.

use nalgebra::{Matrix6, Vector6};
use portolan_geometry::{
    Rigid3, Time, Vector3, angle_axis_from_quaternion, nalgebra as na, rotation_between,
};
use serde::Serialize;

use super::motion_term::MotionTerm;
use super::odometry::trimmed_mean;
use super::unary_term::UnaryTerm;
use super::{DenseTrajectory, Knots};
use crate::motion_sensors::{MotionSensors, PoseTrack};

/// Interval over which noise is measured, seconds: over shorter ones the noise of the trajectory itself would
/// dominate.
const NOISE_SECONDS: f64 = 1.0;
/// Interval over which specific force is averaged, seconds: the effects of steps cancel.
const GRAVITY_SECONDS: f64 = 2.0;
/// Lower bounds of the estimated standard deviations: gyroscope (rad/√s), wheels (m/√s, rad/√s), mean
/// specific force (m/s²), fix (m).
const LEAST: [f64; 5] = [2e-4, 2e-3, 5e-4, 0.02, 0.01];
/// Standard deviation of the bias of an accelerometer, m/s².
const ACCELEROMETER_BIAS: f64 = 0.2;
/// Maximum number of corrections of the bias of a gyroscope.
const BIAS_STEPS: usize = 8;
/// Residual bias below which the corrections end, rad/s.
const BIAS_REST: f64 = 1e-6;
/// Number of standard deviations above which residuals lose weight (Cauchy).
const ROBUST: f64 = 2.0;
/// Minimum number of fixes for aligning a trajectory.
const LEAST_FIXES: usize = 10;

/// Estimates of the other sensors' parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct OtherSensorsFound {
    /// Bias of the gyroscope, rad/s.
    pub gyroscope_bias: Option<[f64; 3]>,
    /// Its noise, rad/√s, along the axes of the tracking frame.
    pub gyroscope_noise: Option<[f64; 3]>,
    /// Bias of the accelerometer, m/s².
    pub accelerometer_bias: Option<[f64; 3]>,
    /// Specific force at rest in the world of the trajectory, m/s²: it points up.
    pub gravity_in_world: Option<[f64; 3]>,
    /// Standard deviation of the mean specific force of two seconds, m/s².
    pub gravity_noise: Option<f64>,
    /// Noise of the wheels along the axes of the tracking frame, m/√s and rad/√s.
    pub odometry_noise: Option<[f64; 6]>,
    /// Standard deviation of a fix, metres.
    pub fix_noise: Option<f64>,
}

/// Measurements of other sensors in the time of a trajectory.
pub(crate) struct OtherSensors<'a> {
    sensors: &'a MotionSensors,
    start: Time,
    wheels: Option<PoseTrack>,
    pub found: OtherSensorsFound,
    /// World of the trajectory from the frame of the fixes.
    pub world_from_fixed: Option<Rigid3>,
}

impl<'a> OtherSensors<'a> {
    pub fn new(sensors: &'a MotionSensors, start: Time) -> Self {
        let wheels = sensors.odometry_track(start);
        Self { sensors, start, wheels, found: OtherSensorsFound::default(), world_from_fixed: None }
    }

    /// Terms of the motion between knots, and of single times. Biases, noise and frames are estimated with
    /// the current trajectory first.
    pub fn terms(
        &mut self,
        trajectory: &DenseTrajectory,
        knots: &Knots,
    ) -> (Vec<MotionTerm>, Vec<UnaryTerm>) {
        let mut motion = self.gyroscope_terms(trajectory, knots);
        motion.extend(self.wheel_terms(trajectory, knots));
        let mut moments = self.gravity_terms(trajectory, knots);
        moments.extend(self.fix_terms(trajectory, knots));
        (motion, moments)
    }

    fn gyroscope_terms(&mut self, trajectory: &DenseTrajectory, knots: &Knots) -> Vec<MotionTerm> {
        let Some((bias, track)) = self.gyroscope(trajectory) else { return Vec::new() };
        let noise = track_noise(&track, trajectory);
        let deviations: [f64; 6] =
            std::array::from_fn(|k| if k < 3 { f64::INFINITY } else { noise[k].max(LEAST[0]) });
        self.found.gyroscope_bias = Some(bias.into());
        self.found.gyroscope_noise = Some([deviations[3], deviations[4], deviations[5]]);
        track_terms(&track, trajectory, knots, &deviations)
    }

    /// The bias of the gyroscope, and its orientations without it. The rotation that a bias adds in a second
    /// is rotated by the motion of that second, so that the first estimate is wrong by the corresponding
    /// fraction. It is corrected until the residual bias vanishes.
    fn gyroscope(&self, trajectory: &DenseTrajectory) -> Option<(Vector3, PoseTrack)> {
        let mut bias = Vector3::zeros();
        let mut track = self.sensors.gyroscope_track(self.start, &bias)?;
        for _ in 0..BIAS_STEPS {
            let rest = gyroscope_bias(&track, trajectory)?;
            bias += rest;
            track = self.sensors.gyroscope_track(self.start, &bias)?;
            if rest.norm() < BIAS_REST {
                break;
            }
        }
        Some((bias, track))
    }

    fn wheel_terms(&mut self, trajectory: &DenseTrajectory, knots: &Knots) -> Vec<MotionTerm> {
        let Some(track) = &self.wheels else { return Vec::new() };
        let noise = track_noise(track, trajectory);
        let deviations = std::array::from_fn(|k| noise[k].max(if k < 3 { LEAST[1] } else { LEAST[2] }));
        self.found.odometry_noise = Some(deviations);
        track_terms(track, trajectory, knots, &deviations)
    }

    /// Mean specific force over two seconds, rotated into the world, is gravity plus the mean acceleration.
    fn gravity_terms(&mut self, trajectory: &DenseTrajectory, knots: &Knots) -> Vec<UnaryTerm> {
        let means = self.specific_forces(trajectory);
        let Some((gravity, bias)) = gravity_and_bias(&means) else { return Vec::new() };
        let residual = |m: &SpecificForce| m.in_world - m.turn * bias - m.acceleration - gravity;
        let squares = means.iter().map(|m| residual(m).norm_squared() / 3.0).collect();
        let deviation = trimmed_mean(squares).sqrt().max(LEAST[3]);
        self.found.gravity_in_world = Some(gravity.into());
        self.found.accelerometer_bias = Some(bias.into());
        self.found.gravity_noise = Some(deviation);
        means
            .iter()
            .map(|m| {
                UnaryTerm::tilt(
                    knots,
                    m.seconds,
                    &(m.in_world - m.turn * bias),
                    &residual(m),
                    deviation,
                    ROBUST,
                )
            })
            .collect()
    }

    fn specific_forces(&self, trajectory: &DenseTrajectory) -> Vec<SpecificForce> {
        let mut means = Vec::new();
        let samples = self.sensors.imu();
        let seconds = |i: usize| samples[i].time.seconds_since(self.start);
        let mut first = samples.partition_point(|s| s.time < self.start);
        while first < samples.len() && seconds(first) + GRAVITY_SECONDS < trajectory.duration() {
            let from = seconds(first);
            let end = samples.partition_point(|s| s.time.seconds_since(self.start) < from + GRAVITY_SECONDS);
            let part = first..end;
            first = end;
            let gapless = part.clone().skip(1).all(|i| seconds(i) - seconds(i - 1) < 0.1);
            if part.len() < 20 || !gapless {
                continue;
            }
            let (to, count) = (seconds(end - 1), part.len() as f64);
            let (mut in_world, mut turn) = (Vector3::zeros(), na::Matrix3::zeros());
            for i in part {
                let rotation = trajectory.pose(seconds(i)).rotation.to_rotation_matrix().into_inner();
                in_world += rotation * samples[i].linear_acceleration / count;
                turn += rotation / count;
            }
            let acceleration = (trajectory.velocity(to).0 - trajectory.velocity(from).0) / (to - from);
            means.push(SpecificForce { seconds: 0.5 * (from + to), in_world, turn, acceleration });
        }
        means
    }

    fn fix_terms(&mut self, trajectory: &DenseTrajectory, knots: &Knots) -> Vec<UnaryTerm> {
        let fixes: Vec<(f64, Vector3)> = self
            .sensors
            .fixes()
            .iter()
            .map(|(time, place)| (time.seconds_since(self.start), *place))
            .filter(|(s, _)| (0.0..=trajectory.duration()).contains(s))
            .collect();
        let up = self.found.gravity_in_world.map_or(Vector3::z(), Vector3::from);
        let Some(world_from_fixed) = align_fixes(&fixes, trajectory, &up) else { return Vec::new() };
        self.world_from_fixed = Some(world_from_fixed);
        let residual = |(seconds, place): &(f64, Vector3)| {
            trajectory.pose(*seconds).translation.vector
                - (world_from_fixed * na::Point3::from(*place)).coords
        };
        let squares = fixes.iter().map(|f| residual(f).norm_squared() / 3.0).collect();
        let deviation = trimmed_mean(squares).sqrt().max(LEAST[4]);
        self.found.fix_noise = Some(deviation);
        // Errors of fixes in neighbouring seconds are correlated: together they count as one fix in ten
        // seconds.
        let rate = fixes.len() as f64 / (fixes.last().map_or(1.0, |l| l.0 - fixes[0].0)).max(1.0);
        let deviation = deviation * (10.0 * rate).max(1.0).sqrt();
        fixes.iter().map(|f| UnaryTerm::place(knots, f.0, &residual(f), deviation, ROBUST)).collect()
    }
}

/// Mean specific force over an interval.
struct SpecificForce {
    seconds: f64,
    in_world: Vector3,
    /// Mean of the rotations from tracking frame to world.
    turn: na::Matrix3<f64>,
    /// Mean acceleration from the trajectory.
    acceleration: Vector3,
}

/// Gravity in the world and the bias in the tracking frame, by least squares.
fn gravity_and_bias(means: &[SpecificForce]) -> Option<(Vector3, Vector3)> {
    let (mut matrix, mut right) = (Matrix6::zeros(), Vector6::zeros());
    for m in means {
        let wanted = m.in_world - m.acceleration;
        for k in 0..3 {
            let turn = m.turn.row(k);
            let mut row = Vector6::zeros();
            row[k] = 1.0;
            row.fixed_rows_mut::<3>(3).copy_from(&turn.transpose());
            matrix += row * row.transpose();
            right += row * wanted[k];
        }
    }
    // Means of two seconds scatter by about 0.1 m/s².
    let prior = (0.1 / ACCELEROMETER_BIAS).powi(2);
    (3..6).for_each(|k| matrix[(k, k)] += prior);
    let solution = matrix.cholesky()?.solve(&right);
    Some((solution.fixed_rows::<3>(0).into_owned(), solution.fixed_rows::<3>(3).into_owned()))
}

/// The bias of the gyroscope, from its rotation in excess of that of the trajectory, averaged over all
/// seconds.
fn gyroscope_bias(track: &PoseTrack, trajectory: &DenseTrajectory) -> Option<Vector3> {
    let (mut sum, mut count) = (Vector3::zeros(), 0.0);
    for_each_second(trajectory, |from, to| {
        let Some(motion) = track.motion(from, to) else { return };
        let turned = trajectory.pose(from).rotation.inverse() * trajectory.pose(to).rotation;
        sum += angle_axis_from_quaternion(&(turned.inverse() * motion.rotation)) / (to - from);
        count += 1.0;
    });
    (count > 0.0).then(|| sum / count)
}

/// Standard deviation of a track from the trajectory, along the axes of the tracking frame, per root of a
/// second.
fn track_noise(track: &PoseTrack, trajectory: &DenseTrajectory) -> [f64; 6] {
    let mut squares: [Vec<f64>; 6] = Default::default();
    let knots = Knots::new(trajectory.duration(), NOISE_SECONDS);
    for term in track_terms(track, trajectory, &knots, &[1.0; 6]) {
        for (squares, residual) in squares.iter_mut().zip(term.along_axes()) {
            squares.push(residual * residual / knots.spacing());
        }
    }
    squares.map(|s| trimmed_mean(s).sqrt())
}

/// The terms of a track, with standard deviations per root of a second.
fn track_terms(
    track: &PoseTrack,
    trajectory: &DenseTrajectory,
    knots: &Knots,
    deviations: &[f64; 6],
) -> Vec<MotionTerm> {
    let deviations = deviations.map(|d| d * knots.spacing().sqrt());
    (0..knots.count() - 1)
        .filter_map(|i| {
            let motion = track.motion(knots.seconds(i), knots.seconds(i + 1))?;
            Some(MotionTerm::new(trajectory, knots, i, &motion, &deviations))
        })
        .collect()
}

fn for_each_second(trajectory: &DenseTrajectory, mut visit: impl FnMut(f64, f64)) {
    let knots = Knots::new(trajectory.duration(), NOISE_SECONDS);
    (0..knots.count() - 1).for_each(|i| visit(knots.seconds(i), knots.seconds(i + 1)));
}

/// Aligns fixes with a trajectory: heading and position by robust least squares, with the given up direction.
fn align_fixes(fixes: &[(f64, Vector3)], trajectory: &DenseTrajectory, up: &Vector3) -> Option<Rigid3> {
    if fixes.len() < LEAST_FIXES {
        return None;
    }
    let world_from_level = rotation_between(&Vector3::z(), up);
    let places: Vec<Vector3> = fixes
        .iter()
        .map(|(seconds, _)| world_from_level.inverse() * trajectory.pose(*seconds).translation.vector)
        .collect();
    let mut weights = vec![1.0; fixes.len()];
    let mut level_from_fixed = Rigid3::identity();
    for _ in 0..10 {
        let total: f64 = weights.iter().sum();
        let mean = |of: &dyn Fn(usize) -> Vector3| {
            (0..fixes.len()).map(|i| of(i) * weights[i]).sum::<Vector3>() / total
        };
        let (a, b) = (mean(&|i| fixes[i].1), mean(&|i| places[i]));
        let (mut cross, mut along) = (0.0, 0.0);
        for i in 0..fixes.len() {
            let (p, q) = (fixes[i].1 - a, places[i] - b);
            cross += weights[i] * (p.x * q.y - p.y * q.x);
            along += weights[i] * (p.x * q.x + p.y * q.y);
        }
        let heading = na::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), cross.atan2(along));
        level_from_fixed = Rigid3::from_parts((b - heading * a).into(), heading);
        let errors: Vec<f64> = (0..fixes.len())
            .map(|i| (level_from_fixed * na::Point3::from(fixes[i].1)).coords - places[i])
            .map(|e| e.norm_squared())
            .collect();
        let usual = trimmed_mean(errors.clone()).max(1e-6);
        weights = errors.iter().map(|e| 1.0 / (1.0 + e / (ROBUST * ROBUST * usual))).collect();
    }
    Some(Rigid3::from_parts(Vector3::zeros().into(), world_from_level) * level_from_fixed)
}
