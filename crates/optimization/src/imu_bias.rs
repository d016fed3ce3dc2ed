//! Estimates the biases of an IMU from the poses of local SLAM, which do not drift within seconds and do not
//! depend on loop closures that may be wrong.

use std::collections::BTreeSet;

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::nalgebra as na;
use portolan_geometry::{Duration, Quaternion, Time, Vector3, angle_axis_from_quaternion};
use portolan_lidar_odometry::settings::GyroscopeSettings;
use portolan_motion::{ImuMotion, integrate_imu, velocity_change};
use portolan_sensor::ImuData;

use super::data::{OptimizationData, OptimizationNode};
use super::graph_problem::follows;
use crate::{NodeId, TrajectoryId, of_trajectory};

/// Length of the window over which the bias of a gyroscope is averaged, seconds.
const WINDOW: f64 = 60.0;
/// Window in which gyroscope and scans are compared, seconds.
const CONTRADICTION_WINDOW: f64 = 1.0;
/// Difference in rotation above which gyroscope and scans contradict each other, radians; see also
/// `CONTRADICTION_SHARE`.
const CONTRADICTION: f64 = 0.15;
/// Increase of that threshold, as a fraction of the rotation in the window.
const CONTRADICTION_SHARE: f64 = 0.1;
/// Standard deviation of the bias of accelerometers, m/s².
const ACCELEROMETER_SIGMA: f64 = 0.1;
/// Standard deviation of velocities by local SLAM, m/s.
const VELOCITY_SIGMA: f64 = 0.1;

/// Estimated biases of the IMU of a trajectory.
#[derive(Clone, Debug, Default)]
pub(super) struct ImuBias {
    /// By time, ascending: cumulative seconds and rotation by which gyroscope and local SLAM differ.
    turns: Vec<(Time, f64, Vector3)>,
    /// m/s² in the tracking frame.
    accelerometer: Vector3,
    /// Times of nodes after which gyroscope and scans contradict each other.
    contradicted: BTreeSet<Time>,
}

/// Motion between two consecutive nodes.
struct Step {
    start: Time,
    seconds: f64,
    /// Rotation of the gyroscope minus that of the scans, in the tracking frame at the end.
    difference: Vector3,
    /// Tracking in local at the end.
    rotation: Quaternion,
    /// Angle of rotation, radians.
    turn: f64,
    /// Whether the gyroscope was at the end of its range.
    saturated: bool,
}

impl ImuBias {
    /// Estimates both from the nodes of a trajectory.
    pub fn estimate(data: &OptimizationData, id: TrajectoryId, options: &OptimizationProblemOptions) -> Self {
        let nodes: Vec<(NodeId, &OptimizationNode)> = of_trajectory(&data.nodes, id).collect();
        let Some(sensors) = data.sensors.get(&id) else { return Self::default() };
        let settings = GyroscopeSettings::default();
        let mut range = settings.saturation_detector();
        let saturated: BTreeSet<Time> = sensors
            .imu
            .values()
            .filter(|d| range.is_saturated(&d.angular_velocity))
            .map(|d| d.time)
            .collect();
        let steps = nodes.windows(2).filter_map(|pair| step(pair, &sensors.imu, &saturated));
        let steps: Vec<Step> = steps.collect();
        let mut bias = Self::default();
        let (mut seconds, mut turn) = (0.0, Vector3::zeros());
        let may_be_bias = |s: &&Step| !s.saturated && s.difference.norm() <= settings.max_bias() * s.seconds;
        for step in steps.iter().filter(may_be_bias) {
            let weight = settings.weight_at(step.turn / step.seconds);
            (seconds, turn) = (seconds + weight * step.seconds, turn + step.difference * weight);
            bias.turns.push((step.start + Duration::from_seconds(step.seconds), seconds, turn));
        }
        bias.contradicted = bias.contradictions(&steps);
        if options.acceleration_weight > 0.0 {
            bias.accelerometer = accelerometer_bias(&nodes, &sensors.imu);
        }
        bias
    }

    /// Finds where the gyroscope was at the end of its range, or differs from the scans within a second by
    /// more than the errors of either. There local SLAM is used.
    fn contradictions(&self, steps: &[Step]) -> BTreeSet<Time> {
        let mut contradicted = BTreeSet::new();
        let mut from = 0;
        for (to, last) in steps.iter().enumerate() {
            if last.saturated {
                contradicted.insert(last.start);
            }
            let end = last.start + Duration::from_seconds(last.seconds);
            let is_before = |s: &&Step| end.seconds_since(s.start) > CONTRADICTION_WINDOW;
            from += steps.iter().take(to).skip(from).take_while(is_before).count();
            let within = steps.get(from..=to).unwrap_or_default();
            let unexplained = |s: &Step| s.rotation * (s.difference - self.gyroscope(s.start) * s.seconds);
            let error = within.iter().map(unexplained).sum::<Vector3>().norm();
            let turn: f64 = within.iter().map(|s| s.turn).sum();
            if error > CONTRADICTION + CONTRADICTION_SHARE * turn {
                contradicted.extend(within.iter().map(|s| s.start));
            }
        }
        contradicted
    }

    /// Whether gyroscope and scans agree on the rotation from the node of this time to the next.
    pub fn agrees_after(&self, time: Time) -> bool {
        !self.contradicted.contains(&time)
    }

    /// The bias of the gyroscope around a time, rad/s in the tracking frame; zero if nothing is known.
    pub fn gyroscope(&self, time: Time) -> Vector3 {
        let half = Duration::from_seconds(0.5 * WINDOW);
        let at = |time: Time| self.turns.partition_point(|(t, ..)| *t < time);
        let (from, to) = (at(time - half), at(time + half).min(self.turns.len().saturating_sub(1)));
        let (Some(first), Some(last)) = (self.turns.get(from), self.turns.get(to)) else {
            return Vector3::zeros();
        };
        let seconds = last.1 - first.1;
        if seconds <= 0.0 { Vector3::zeros() } else { (last.2 - first.2) / seconds }
    }

    /// The bias of the accelerometer, m/s² in the tracking frame.
    pub fn accelerometer(&self) -> Vector3 {
        self.accelerometer
    }

    /// An integrated motion over `seconds` around a time, corrected for the biases (to first order).
    pub fn corrected(&self, motion: &ImuMotion, time: Time, seconds: f64) -> ImuMotion {
        let turn = self.gyroscope(time) * -seconds;
        ImuMotion {
            delta_rotation: motion.delta_rotation * portolan_geometry::quaternion_from_angle_axis(&turn),
            delta_velocity: motion.delta_velocity - self.accelerometer * seconds,
            delta_translation: motion.delta_translation - self.accelerometer * (0.5 * seconds * seconds),
        }
    }
}

fn step(
    pair: &[(NodeId, &OptimizationNode)],
    imu: &std::collections::BTreeMap<Time, ImuData>,
    saturated: &BTreeSet<Time>,
) -> Option<Step> {
    let &[(id_a, a), (id_b, b)] = pair else { return None };
    if !follows(&id_a, &id_b) {
        return None;
    }
    let seconds = b.time.seconds_since(a.time);
    let motion = integrate_imu(imu, a.time, b.time).filter(|_| seconds > 0.0)?;
    let found = a.local_from_node.rotation.inverse() * b.local_from_node.rotation;
    let difference = angle_axis_from_quaternion(&(found.inverse() * motion.delta_rotation));
    let (rotation, turn) = (b.local_from_node.rotation, found.angle());
    let saturated = saturated.range(a.time..=b.time).next().is_some();
    Some(Step { start: a.time, seconds, difference, rotation, turn, saturated })
}

/// The bias b and the gravity g (in the local map) at which measured changes of velocity agree best with
/// those of consecutive nodes: `R₂ (Δv − b T) − g T = Δv_local`, linear least squares with a prior of b
/// around zero. Where the frame never rotates b cannot be distinguished from a tilt of g, and stays small.
fn accelerometer_bias(
    nodes: &[(NodeId, &OptimizationNode)],
    imu: &std::collections::BTreeMap<Time, portolan_sensor::ImuData>,
) -> Vector3 {
    let mut hessian = na::Matrix6::<f64>::identity() * 1e-6;
    let mut gradient = na::Vector6::<f64>::zeros();
    let mut of_bias = hessian.fixed_view_mut::<3, 3>(0, 0);
    of_bias += na::Matrix3::identity() * (1.0 / (ACCELEROMETER_SIGMA * ACCELEROMETER_SIGMA));
    for triple in nodes.windows(3) {
        let &[(id_a, a), (id_b, b), (id_c, c)] = triple else { continue };
        if !(follows(&id_a, &id_b) && follows(&id_b, &id_c)) {
            continue;
        }
        let (first, second) = (b.time.seconds_since(a.time), c.time.seconds_since(b.time));
        if !(first > 0.0 && second > 0.0) {
            continue;
        }
        let Some(measured) = velocity_change(imu, [a.time, b.time, c.time]) else { continue };
        let at = |node: &OptimizationNode| node.local_from_node.translation.vector;
        let found = (at(c) - at(b)) / second - (at(b) - at(a)) / first;
        let rotation = b.local_from_node.rotation.to_rotation_matrix().into_inner();
        let middle = 0.5 * (first + second);
        let mut jacobian = na::Matrix3x6::<f64>::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&(rotation * -middle));
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(na::Matrix3::identity() * -middle));
        let residual = rotation * measured - found;
        let weight = 1.0 / (VELOCITY_SIGMA * VELOCITY_SIGMA);
        hessian += jacobian.transpose() * jacobian * weight;
        gradient += jacobian.transpose() * residual * weight;
    }
    let solution = hessian.cholesky().map_or_else(na::Vector6::zeros, |c| c.solve(&-gradient));
    let bias: Vector3 = solution.fixed_rows::<3>(0).into();
    if bias.iter().all(|v| v.is_finite()) && bias.norm() < 10.0 * ACCELEROMETER_SIGMA {
        bias
    } else {
        Vector3::zeros()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NodeId;
    use portolan_geometry::{Quaternion, Rigid3, quaternion_from_angle_axis};
    use portolan_sensor::ImuData;

    #[test]
    fn both_biases_are_found_on_a_circle() {
        let (gyroscope, accelerometer) = (Vector3::new(0.01, -0.02, 0.005), Vector3::new(0.06, -0.04, 0.02));
        let id = TrajectoryId(0);
        let mut data = OptimizationData::default();
        let time = |t: f64| Time::from_ticks((t * 1e7).round() as i64);
        // A circle of 4 m radius in 20 s.
        let rate = std::f64::consts::TAU / 20.0;
        let pose = |t: f64| {
            let position = Vector3::new(4.0 * (rate * t).sin(), 4.0 - 4.0 * (rate * t).cos(), 0.0);
            Rigid3::from_parts(position.into(), quaternion_from_angle_axis(&(Vector3::z() * (rate * t))))
        };
        for i in 0..200 {
            let t = 0.2 * f64::from(i);
            let node = OptimizationNode {
                time: time(t),
                local_from_node: pose(t),
                map_from_node: pose(t),
                gravity_alignment: Quaternion::identity(),
            };
            data.nodes.insert(NodeId::new(id, i as u32), node);
        }
        for i in -10..8000 {
            let sample = ImuData {
                time: time(0.005 * f64::from(i)),
                linear_acceleration: Vector3::new(0.0, 4.0 * rate * rate, 9.8) + accelerometer,
                // Not the same value every time: that would be the end of a range.
                angular_velocity: Vector3::z() * rate + gyroscope * (1.0 + 1e-3 * f64::from(i % 2)),
            };
            data.sensors_mut(id).imu.insert(sample.time, sample);
        }
        let bias = ImuBias::estimate(&data, id, &OptimizationProblemOptions::default());
        assert!((bias.gyroscope(time(20.0)) - gyroscope).norm() < 1e-3, "{}", bias.gyroscope(time(20.0)));
        // Along gravity bias and length of gravity are one.
        let found = bias.accelerometer;
        assert!((found - accelerometer).xy().norm() < 0.01, "{found}");
        let motion = integrate_imu(&data.sensors[&id].imu, time(10.0), time(10.2)).unwrap();
        let corrected = bias.corrected(&motion, time(10.1), 0.2);
        assert!(
            corrected.delta_rotation.angle_to(&quaternion_from_angle_axis(&(Vector3::z() * (0.2 * rate))))
                < 1e-3
        );
        assert_eq!(ImuBias::default().gyroscope(time(1.0)), Vector3::zeros());
    }
}
