//! Derives IMU samples from the poses of nodes.
//!
//! Cartographer aborts when it optimises a 3D trajectory whose IMU data do not reach back to its first node,
//! and it extends the last sample over any gap. Where nothing was measured, maps get samples that are
//! consistent with the poses and gravity: at the poses of the nodes all IMU residuals are zero. They are
//! marked (`derived_from_poses`) and not read again.

use std::collections::VecDeque;

use portolan_geometry::{
    Duration, Quaternion, Rigid3, Time, Vector3, angle_axis_from_quaternion, quaternion_from_angle_axis,
};
use portolan_optimization::ImuState;

use portolan_pbstream::pose_from_proto;
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::sensor;
use portolan_pbstream::proto::transform::Vector3d;

/// Time for which a measured sample is valid, as in mapping: 0.5 s.
const MAX_GAP: Duration = Duration::from_ticks(5_000_000);
/// Number of samples between two nodes. It is even, so that acceleration can change in the middle.
const PER_INTERVAL: i64 = 4;

/// Derived samples of one trajectory, returned in sequence with the measured ones.
#[derive(Debug, Default)]
pub(crate) struct DerivedImu {
    trajectory_id: i32,
    nodes: Vec<(Time, Rigid3)>,
    state: ImuState,
    /// Samples not yet returned; none before the first call.
    pending: Option<VecDeque<sensor::ImuData>>,
    last_measured: Option<Time>,
}

impl DerivedImu {
    /// `nodes` are times and poses of the tracking frame in the global map, ascending.
    pub fn new(trajectory_id: i32, nodes: Vec<(Time, Rigid3)>) -> Self {
        Self { trajectory_id, nodes, ..Self::default() }
    }

    /// Samples for a trajectory of a file; nodes without a valid pose are left out.
    pub fn of(trajectory: &m::Trajectory) -> Self {
        let node = |n: &m::trajectory::Node| {
            Some((Time::from_ticks(n.timestamp), pose_from_proto(n.pose.as_ref())?))
        };
        Self::new(trajectory.trajectory_id, trajectory.node.iter().filter_map(node).collect())
    }

    /// Sets gravity and calibration of the IMU. To be called before the first sample.
    pub fn set_state(&mut self, state: ImuState) {
        self.state = state;
    }

    /// Derived samples to write before a measured sample of this time.
    pub fn before(&mut self, measured: Time) -> Vec<m::ImuData> {
        let messages = self.until(measured);
        self.last_measured = Some(measured);
        messages
    }

    /// Derived samples to write after the last measured sample.
    pub fn rest(&mut self) -> Vec<m::ImuData> {
        self.until(Time::MAX)
    }

    fn until(&mut self, end: Time) -> Vec<m::ImuData> {
        let pending = self.pending.get_or_insert_with(|| samples(&self.nodes, &self.state).into());
        let mut messages = Vec::new();
        while let Some(time) = pending.front().map(|s| Time::from_ticks(s.timestamp)).filter(|t| *t <= end) {
            let Some(sample) = pending.pop_front() else { break };
            if time < end && self.last_measured.is_none_or(|last| time - last > MAX_GAP) {
                messages.push(m::ImuData {
                    trajectory_id: self.trajectory_id,
                    imu_data: Some(sample),
                    derived_from_poses: true,
                });
            }
        }
        messages
    }
}

/// Constant-velocity motion from one node to the next.
struct Interval {
    start: Time,
    end: Time,
    velocity: Vector3,
    /// Rotation map from tracking at the start.
    rotation: Quaternion,
    /// Angular velocity in the tracking frame, rad/s.
    rate: Vector3,
}

impl Interval {
    fn between(a: &(Time, Rigid3), b: &(Time, Rigid3)) -> Option<Self> {
        let seconds = b.0.seconds_since(a.0);
        if (b.0 - a.0).ticks() < PER_INTERVAL {
            return None;
        }
        let turn = angle_axis_from_quaternion(&(a.1.rotation.inverse() * b.1.rotation));
        let shift = b.1.translation.vector - a.1.translation.vector;
        let (velocity, rate) = (shift / seconds, turn / seconds);
        Some(Self { start: a.0, end: b.0, velocity, rotation: a.1.rotation, rate })
    }

    fn seconds(&self) -> f64 {
        self.end.seconds_since(self.start)
    }

    /// Start time of a sample by its number. The middle is rounded as in the integration.
    fn sample_time(&self, number: i64) -> Time {
        let ticks = (self.end - self.start).ticks();
        let half = ticks / 2;
        let offset = match number {
            0..2 => half * number / 2,
            2..4 => half + (ticks - half) * (number - 2) / 2,
            _ => ticks,
        };
        self.start + Duration::from_ticks(offset)
    }

    /// Rotation map from tracking at a time within the interval.
    fn rotation_at(&self, time: Time) -> Quaternion {
        self.rotation * quaternion_from_angle_axis(&(self.rate * time.seconds_since(self.start)))
    }
}

/// Acceleration in the map between the middles of two intervals; zero if they are not adjacent.
fn acceleration(first: Option<&Interval>, second: Option<&Interval>) -> Vector3 {
    match (first, second) {
        (Some(a), Some(b)) if a.end == b.start => {
            (b.velocity - a.velocity) / (0.5 * (a.seconds() + b.seconds()))
        }
        _ => Vector3::zeros(),
    }
}

/// Samples for the whole time from the first node to the last, in the axes of the IMU.
fn samples(nodes: &[(Time, Rigid3)], state: &ImuState) -> Vec<sensor::ImuData> {
    let pairs = nodes.iter().zip(nodes.iter().skip(1));
    let intervals: Vec<Interval> = pairs.filter_map(|(a, b)| Interval::between(a, b)).collect();
    let imu_from_tracking = state.calibration.inverse();
    let up = Vector3::z() * state.gravity_constant;
    let message = |time: Time, map_from_tracking: Quaternion, acceleration: Vector3, rate: Vector3| {
        let force = imu_from_tracking * (map_from_tracking.inverse() * (up + acceleration));
        sensor::ImuData {
            timestamp: time.ticks(),
            linear_acceleration: Some(vector(force)),
            angular_velocity: Some(vector(imu_from_tracking * rate)),
        }
    };
    let mut samples = Vec::with_capacity(intervals.len() * PER_INTERVAL as usize + 1);
    for (i, interval) in intervals.iter().enumerate() {
        let before = i.checked_sub(1).and_then(|i| intervals.get(i));
        let at_start = acceleration(before, Some(interval));
        let at_end = acceleration(Some(interval), intervals.get(i + 1));
        for number in 0..PER_INTERVAL {
            // The integration applies the rotation first and adds the velocity then.
            let rotation = interval.rotation_at(interval.sample_time(number + 1));
            let acceleration = if number < PER_INTERVAL / 2 { at_start } else { at_end };
            samples.push(message(interval.sample_time(number), rotation, acceleration, interval.rate));
        }
    }
    let last = nodes.last().filter(|last| intervals.last().is_none_or(|i| i.end <= last.0));
    samples
        .extend(last.map(|(time, pose)| message(*time, pose.rotation, Vector3::zeros(), Vector3::zeros())));
    samples
}

fn vector(v: Vector3) -> Vector3d {
    Vector3d { x: v.x, y: v.y, z: v.z }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use portolan_geometry::rotation_from_roll_pitch_yaw;
    use portolan_motion::{integrate_imu, velocity_change};
    use portolan_sensor::ImuData;

    use super::*;

    fn nodes() -> Vec<(Time, Rigid3)> {
        let node = |i: i64| {
            let t = i as f64;
            let turn = rotation_from_roll_pitch_yaw(0.3 * t.sin(), -0.2 * t.cos(), 0.5 * t);
            let place = nalgebra::Translation3::new((0.7 * t).sin(), t, 0.1 * t * t);
            (Time::from_ticks(i * 4_000_001 + i * i * 7), Rigid3::from_parts(place, turn))
        };
        (0..8).map(node).collect()
    }

    fn measured(samples: &[sensor::ImuData]) -> BTreeMap<Time, ImuData> {
        let vector = |v: Option<Vector3d>| v.map(|v| Vector3::new(v.x, v.y, v.z)).unwrap();
        let sample = |s: &sensor::ImuData| {
            let time = Time::from_ticks(s.timestamp);
            let linear_acceleration = vector(s.linear_acceleration);
            (time, ImuData { time, linear_acceleration, angular_velocity: vector(s.angular_velocity) })
        };
        samples.iter().map(sample).collect()
    }

    #[test]
    fn the_residuals_of_the_imu_are_zero_where_the_nodes_stand() {
        let calibration = rotation_from_roll_pitch_yaw(0.1, 0.2, -0.3);
        let state = ImuState { gravity_constant: 9.7, calibration };
        let nodes = nodes();
        let imu = measured(&samples(&nodes, &state));
        for three in nodes.windows(3) {
            let [(t1, p1), (t2, p2), (t3, p3)] = three else { unreachable!() };
            let turned = integrate_imu(&imu, *t1, *t2).unwrap().delta_rotation;
            let expected = p1.rotation.inverse() * p2.rotation;
            assert!((calibration * turned * calibration.inverse()).angle_to(&expected) < 1e-12);
            let (first, second) = (t2.seconds_since(*t1), t3.seconds_since(*t2));
            let change = velocity_change(&imu, [*t1, *t2, *t3]).unwrap();
            let gravity = Vector3::z() * (9.7 * 0.5 * (first + second));
            let velocities = (p3.translation.vector - p2.translation.vector) / second
                - (p2.translation.vector - p1.translation.vector) / first;
            let residual = p2.rotation * (calibration * change) - gravity - velocities;
            assert!(residual.norm() < 1e-6, "{residual}");
        }
    }

    #[test]
    fn derived_samples_fill_gaps_in_measurements() {
        let nodes = nodes();
        let times = |messages: Vec<m::ImuData>| -> Vec<i64> {
            assert!(messages.iter().all(|m| m.derived_from_poses && m.trajectory_id == 3));
            messages.iter().map(|m| m.imu_data.as_ref().unwrap().timestamp).collect()
        };
        let mut nothing_measured = DerivedImu::new(3, nodes.clone());
        let all = times(nothing_measured.rest());
        assert!(all.is_sorted_by(|a, b| a < b), "{all:?}");
        assert_eq!((all.len(), all[0]), (7 * 4 + 1, nodes[0].0.ticks()));
        assert_eq!(all.last(), Some(&nodes[7].0.ticks()));

        let mut covered = DerivedImu::new(3, nodes.clone());
        assert!((0..300).all(|i| covered.before(Time::from_ticks(i * 100_000)).is_empty()));
        assert_eq!(times(covered.rest()), Vec::<i64>::new());

        let mut late = DerivedImu::new(3, nodes.clone());
        let before = times(late.before(nodes[2].0));
        assert_eq!(before, all[..8]);
        let after = times(late.rest());
        assert!(after.iter().all(|t| *t > nodes[2].0.ticks() + MAX_GAP.ticks()) && after.len() > 12);
        assert!(DerivedImu::new(3, vec![nodes[0]]).rest().len() == 1);
        assert!(DerivedImu::new(3, vec![]).rest().is_empty());
    }
}
