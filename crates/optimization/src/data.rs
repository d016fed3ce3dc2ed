//! Data of the optimisation: everything that is optimised or measured, by trajectory.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Bound;

use portolan_geometry::{Duration, NearFrame, Quaternion, Rigid3, Time, Vector3, moved};
use portolan_motion::Observability;
use portolan_sensor::{FixedFramePoseData, ImuData, LandmarkObservation, OdometryData};

use crate::{NodeId, SensorPolicy, SubmapId, TrajectoryConnectivity, TrajectoryId, of_trajectory};

/// A node as the optimisation sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct OptimizationNode {
    /// Time of the scan.
    pub time: Time,
    /// Pose in the local map, in the frame that constraints use.
    pub local_from_node: Rigid3,
    /// Pose in the global map, in the frame that constraints use.
    pub map_from_node: Rigid3,
    /// Rotation from tracking to gravity-aligned.
    pub gravity_alignment: Quaternion,
}

/// One observation of a landmark.
#[derive(Clone, Debug, PartialEq)]
pub struct LandmarkSighting {
    /// The trajectory that observed it.
    pub trajectory_id: TrajectoryId,
    /// Time of the observation.
    pub time: Time,
    /// The observation.
    pub observation: LandmarkObservation,
}

/// A landmark.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LandmarkNode {
    /// In order of arrival.
    pub sightings: Vec<LandmarkSighting>,
    /// Pose in the global map, once known.
    pub map_from_landmark: Option<Rigid3>,
    /// A frozen landmark is not moved.
    pub frozen: bool,
}

/// Pose of a trajectory's fixed frame in the global map, once known.
pub type FixedFrameOrigin = Option<Rigid3>;

/// Measurements of one trajectory, each by time (a stamp that is already there is not replaced).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrajectorySensors {
    /// IMU samples (3D only).
    pub imu: BTreeMap<Time, ImuData>,
    /// Odometry poses.
    pub odometry: BTreeMap<Time, OdometryData>,
    /// Fixed-frame poses.
    pub fixed_frame: BTreeMap<Time, FixedFramePoseData>,
    /// State of the IMU as estimated by the optimisation (3D only).
    pub imu_state: ImuState,
}

/// Estimated state of an IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuState {
    /// Length of the acceleration that the IMU measures at rest, m/s².
    pub gravity_constant: f64,
    /// Rotation from the axes of the IMU to the tracking frame.
    pub calibration: Quaternion,
}

impl Default for ImuState {
    /// Initial gravity of Cartographer; not `portolan_motion::USUAL_GRAVITY`, because results have to be the
    /// same.
    fn default() -> Self {
        Self { gravity_constant: 9.8, calibration: Quaternion::identity() }
    }
}

/// The state of the optimisation problem.
#[derive(Clone, Debug, Default)]
pub struct OptimizationData {
    /// Global poses of submaps.
    pub submaps: BTreeMap<SubmapId, Rigid3>,
    /// Nodes.
    pub nodes: BTreeMap<NodeId, OptimizationNode>,
    /// Observability of the scans of nodes with degenerate directions. Files do not keep it.
    pub open: BTreeMap<NodeId, Observability>,
    /// Landmarks by name.
    pub landmarks: BTreeMap<String, LandmarkNode>,
    /// Measurements.
    pub sensors: BTreeMap<TrajectoryId, TrajectorySensors>,
    /// Fixed-frame origins.
    pub fixed_frame_origins: BTreeMap<TrajectoryId, FixedFrameOrigin>,
    /// Starts of trajectories given by the user: their first nodes and the poses of these.
    pub given_starts: BTreeMap<NodeId, Rigid3>,
    /// Trajectories that are not moved.
    pub frozen: BTreeSet<TrajectoryId>,
    /// How other sensors are used.
    pub sensor_policy: SensorPolicy,
    /// First submaps of parts of the map that nothing ties to the rest: they keep their poses, so that their
    /// part does not float. The first submap of all does so in any case.
    pub anchors: BTreeSet<SubmapId>,
    /// Iterations allowed beyond the options' number, for the final optimisation.
    pub max_iterations_override: Option<u32>,
}

/// Result of an optimisation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OptimizationSummary {
    /// ½Σρ(r²) before.
    pub initial_cost: f64,
    /// ½Σρ(r²) after.
    pub final_cost: f64,
    /// Iterations made.
    pub iterations: u32,
    /// Whether a tolerance ended it, not the number of iterations.
    pub converged: bool,
    /// Whether it failed, for example because of numbers that are too large: nothing was moved.
    pub failed: bool,
}

impl OptimizationData {
    /// The measurements of a trajectory, created empty when it is new.
    pub fn sensors_mut(&mut self, trajectory_id: TrajectoryId) -> &mut TrajectorySensors {
        self.sensors.entry(trajectory_id).or_default()
    }

    /// Pose of a node in a submap by their global poses; `None` where either has none.
    pub fn submap_from_node(&self, submap_id: SubmapId, node_id: NodeId) -> Option<Rigid3> {
        let map_from_submap = self.submaps.get(&submap_id)?;
        Some(map_from_submap.inverse() * self.nodes.get(&node_id)?.map_from_node)
    }

    /// Moves the whole map along its axes, metres.
    pub fn move_by(&mut self, shift: &Vector3) {
        let origins = self.fixed_frame_origins.values_mut().flatten();
        let landmarks =
            self.landmarks.values_mut().filter_map(|landmark| landmark.map_from_landmark.as_mut());
        let nodes = self.nodes.values_mut().map(|node| &mut node.map_from_node);
        let starts = self.given_starts.values_mut();
        for pose in self.submaps.values_mut().chain(nodes).chain(landmarks).chain(origins).chain(starts) {
            *pose = moved(pose, shift);
        }
    }

    /// A frame near the map.
    pub fn near_frame(&self) -> NearFrame {
        let nodes = self.nodes.values().map(|node| &node.map_from_node);
        NearFrame::around(self.submaps.values().chain(nodes).map(|pose| pose.translation.vector))
    }

    /// Anchors the first submap of every part of the map that neither a landmark nor a frozen trajectory
    /// constrains.
    pub fn set_anchors(&mut self, connectivity: &TrajectoryConnectivity) {
        let sightings = self.landmarks.values().flat_map(|l| &l.sightings);
        let see_landmarks: BTreeSet<TrajectoryId> = sightings.map(|s| s.trajectory_id).collect();
        let parts = connectivity.components();
        let floating = parts
            .iter()
            .filter(|part| !part.iter().any(|id| see_landmarks.contains(id) || self.frozen.contains(id)));
        let first_submap =
            |id: &TrajectoryId| of_trajectory(&self.submaps, *id).next().map(|(submap_id, _)| submap_id);
        self.anchors = floating.filter_map(|part| part.iter().find_map(first_submap)).collect();
    }

    /// Removes a node and the measurements that only mattered between its neighbours: strictly inside the
    /// gap, except the first and the last, which interpolation at the neighbours needs.
    pub fn trim_node(&mut self, node_id: NodeId) {
        if self.nodes.remove(&node_id).is_none() {
            return;
        }
        self.open.remove(&node_id);
        self.given_starts.remove(&node_id);
        let trajectory_id = node_id.trajectory_id;
        let previous =
            self.nodes.range(NodeId::new(trajectory_id, 0)..node_id).next_back().map(|(_, n)| n.time);
        let next =
            self.nodes.range(node_id..=NodeId::new(trajectory_id, u32::MAX)).next().map(|(_, n)| n.time);
        let Some(sensors) = self.sensors.get_mut(&trajectory_id) else { return };
        trim_gap(&mut sensors.imu, previous, next);
        trim_gap(&mut sensors.odometry, previous, next);
        trim_gap(&mut sensors.fixed_frame, previous, next);
        if previous.is_none() && next.is_none() {
            self.sensors.remove(&trajectory_id);
        }
    }
}

/// Interval over which samples of an IMU at rest are averaged.
const REST_INTERVAL: Duration = Duration::from_ticks(1_000_000);

impl TrajectorySensors {
    /// Averages the samples of an IMU that was at rest between two times, so that standing for long takes
    /// little memory. Each mean stands for the time span of its samples.
    pub fn thin_out_rest(&mut self, start: Time, end: Time) {
        if start >= end {
            return;
        }
        let mut means: Vec<(ImuData, f64)> = Vec::new();
        let inside = (Bound::Excluded(start), Bound::Excluded(end));
        for sample in self.imu.range(inside).map(|(_, sample)| sample) {
            match means.last_mut() {
                Some((mean, count)) if sample.time - mean.time < REST_INTERVAL => {
                    *count += 1.0;
                    mean.linear_acceleration +=
                        (sample.linear_acceleration - mean.linear_acceleration) / *count;
                    mean.angular_velocity += (sample.angular_velocity - mean.angular_velocity) / *count;
                }
                _ => means.push((*sample, 1.0)),
            }
        }
        let mut after = self.imu.split_off(&end);
        self.imu.split_off(&(start + Duration::from_ticks(1)));
        self.imu.extend(means.into_iter().map(|(mean, _)| (mean.time, mean)));
        self.imu.append(&mut after);
    }
}

/// Removes entries in the closed gap between two node times, but keeps the first and the last one towards an
/// existing neighbour.
fn trim_gap<T>(data: &mut BTreeMap<Time, T>, previous: Option<Time>, next: Option<Time>) {
    let start = previous.unwrap_or(Time::MIN);
    let end = next.unwrap_or(Time::MAX);
    let inside: Vec<Time> = data.range(start..=end).map(|(t, _)| *t).collect();
    let first_kept = usize::from(previous.is_some());
    let last_kept = inside.len().saturating_sub(usize::from(next.is_some()));
    for time in inside.get(first_kept..last_kept).unwrap_or_default() {
        data.remove(time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_motion::integrate_imu;

    #[test]
    fn an_imu_at_rest_is_thinned_out_without_changing_its_integral() {
        let time = |i: i64| Time::from_ticks(50_000 * i);
        let mut sensors = TrajectorySensors::default();
        for i in 0..1000 {
            let k = i as f64;
            let linear_acceleration = Vector3::new(0.01 * (k * 0.7).sin(), 0.02 * (k * 1.3).cos(), 9.81);
            let angular_velocity = Vector3::new(1e-3 * (k * 2.1).sin(), 2e-3, -1e-3);
            let sample = ImuData { time: time(i), linear_acceleration, angular_velocity };
            sensors.imu.insert(time(i), sample);
        }
        let motion = |sensors: &TrajectorySensors| integrate_imu(&sensors.imu, time(100), time(900)).unwrap();
        let before = motion(&sensors);
        sensors.thin_out_rest(time(100), time(900));
        assert!(sensors.imu.len() < 250, "{}", sensors.imu.len());
        let after = motion(&sensors);
        // Gravity is rotated in steps of a tenth of a second then: within 4 s as much as a tilt of 0.1 mrad.
        assert!((before.delta_velocity - after.delta_velocity).norm() < 5e-3, "{before:?} {after:?}");
        assert!(before.delta_rotation.angle_to(&after.delta_rotation) < 1e-5);
        sensors.thin_out_rest(time(900), time(100));
        sensors.thin_out_rest(time(100), time(900));
        assert!(sensors.imu.contains_key(&time(900)) && sensors.imu.contains_key(&time(100)));
    }

    #[test]
    fn trimming_keeps_samples_for_interpolation() {
        let ms = |v: i64| Time::from_ticks(v * 10_000);
        let mut data = OptimizationData::default();
        let trajectory_id = TrajectoryId(0);
        for (index, time) in [42, 46, 48].into_iter().enumerate() {
            let node = OptimizationNode {
                time: ms(time),
                local_from_node: Rigid3::identity(),
                map_from_node: Rigid3::identity(),
                gravity_alignment: Quaternion::identity(),
            };
            data.nodes.insert(NodeId::new(trajectory_id, index as u32), node);
        }
        for time in [1, 41, 42, 43, 47, 48, 49, 5000] {
            let odometry = OdometryData { time: ms(time), odom_from_tracking: Rigid3::identity() };
            data.sensors_mut(trajectory_id).odometry.insert(ms(time), odometry);
        }
        let times = |data: &OptimizationData| -> Vec<i64> {
            data.sensors[&trajectory_id].odometry.keys().map(|t| t.ticks() / 10_000).collect()
        };
        data.trim_node(NodeId::new(trajectory_id, 1));
        assert_eq!(times(&data), [1, 41, 42, 48, 49, 5000]);
        data.trim_node(NodeId::new(trajectory_id, 2));
        assert_eq!(times(&data), [1, 41, 42]);
        data.trim_node(NodeId::new(trajectory_id, 0));
        assert!(data.sensors.is_empty());
    }
}
