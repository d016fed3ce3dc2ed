//! Finishes, freezes and deletes trajectories, and loads the contents of a file (`slam2d.md` §14.4,
//! `formats.md` §2.2).

use std::sync::Arc;

use portolan_config::Options;
use portolan_geometry::{Duration, NearFrame, Rigid3, Time, Vector3, moved};
use portolan_optimization::{ImuState, OptimizationNode};

use super::{Gap, InitialTrajectoryPose, PoseGraph, SubmapEntry, TrajectoryState, Trimmer};
use crate::{
    Constraint, ConstraintTag, InsertionSubmap, Node, NodeData, NodeId, Space, SubmapId, TrajectoryId,
};
use portolan_local_slam::OdometryBridge;

/// Time before the start of a piece of map from which it takes over measurements, so that its first node is
/// between two of them.
const BEFORE_PIECE: Duration = Duration::from_ticks(2_000_000);

impl<S: Space> PoseGraph<S> {
    /// Ends a trajectory. `remaining` are the submaps that local SLAM was still filling; those that
    /// come with a grid are complete from now on and nodes are searched in them too. Optimises.
    pub fn finish_trajectory(&mut self, id: TrajectoryId, remaining: Vec<InsertionSubmap<S>>) {
        if self.complete(id, remaining) {
            self.optimize();
        }
    }

    /// Takes the last submaps of a trajectory. False if it was complete before.
    fn complete(&mut self, id: TrajectoryId, remaining: Vec<InsertionSubmap<S>>) -> bool {
        let trajectory = self.state.trajectory_mut(id);
        if trajectory.state != TrajectoryState::Active {
            return false;
        }
        trajectory.state = TrajectoryState::Finished;
        for submap in remaining {
            if let Some(grid) = submap.finished {
                self.finish_submap(SubmapId::new(id, submap.index), grid);
            }
        }
        for (_, entry) in self.state.submaps.iter_mut().filter(|(s, _)| s.trajectory_id == id) {
            entry.searchable = true;
        }
        true
    }

    /// Ends a trajectory at which the pose was lost, and begins a new one for the scans after it. The new one
    /// is drawn from the last known pose on, but is not connected with anything until enough matches agree on
    /// its pose.
    pub fn begin_piece(
        &mut self,
        ended: TrajectoryId,
        remaining: Vec<InsertionSubmap<S>>,
        piece: TrajectoryId,
        old_from_new: &Rigid3,
        bridge: Option<OdometryBridge>,
    ) {
        self.complete(ended, remaining);
        let map_from_local = self.state.map_from_local(ended) * old_from_new;
        let drift = self.policy.loops.drift;
        let gap = bridge.map(|bridge| Gap { before: ended, bridge, path_length: bridge.translation / drift });
        let entry = self.state.trajectory_mut(piece);
        entry.map_from_local_before_optimization = Some(map_from_local);
        entry.after_gap = gap;
        self.pieces.insert(piece);
    }

    /// Copies what was measured from a time on, and just before it, from one trajectory to another.
    pub fn copy_measurements(&mut self, from: TrajectoryId, to: TrajectoryId, since: Time) {
        let begin = since - BEFORE_PIECE;
        let Some(sensors) = self.problem.sensors.get(&from) else { return };
        let (imu, odometry, fixes) = (&sensors.imu, &sensors.odometry, &sensors.fixed_frame);
        let imu: Vec<_> = imu.range(begin..).map(|(time, data)| (*time, *data)).collect();
        let odometry: Vec<_> = odometry.range(begin..).map(|(time, data)| (*time, *data)).collect();
        let fixes: Vec<_> = fixes.range(begin..).map(|(time, data)| (*time, *data)).collect();
        let sensors = self.problem.sensors_mut(to);
        sensors.imu.extend(imu);
        sensors.odometry.extend(odometry);
        sensors.fixed_frame.extend(fixes);
    }

    /// Keeps the grid of a submap that is not complete, so that it can be saved and drawn.
    pub fn set_unfinished_submap(&mut self, id: SubmapId, submap: Arc<S::Submap>) {
        if let Some(entry) = self.state.submaps.get_mut(&id)
            && !entry.insertion_finished
        {
            entry.submap = Some(submap);
        }
    }

    /// Makes a trajectory a fixed part of the map. All frozen trajectories count as connected.
    pub fn freeze_trajectory(&mut self, id: TrajectoryId) {
        self.state.trajectory_mut(id).state = TrajectoryState::Frozen;
        let frozen: Vec<TrajectoryId> = self.problem.frozen.iter().copied().collect();
        for other in frozen {
            if !self.state.connectivity.are_connected(id, other) {
                self.state.connectivity.connect(id, other, Time::from_ticks(0));
            }
        }
        self.problem.frozen.insert(id);
    }

    /// Removes a trajectory that is not active any more; done at the next optimisation. Returns whether there
    /// is such a trajectory.
    pub fn delete_trajectory(&mut self, id: TrajectoryId) -> bool {
        match self.state.trajectories.get_mut(&id) {
            Some(t) if t.state != TrajectoryState::Active && t.state != TrajectoryState::Deleted => {
                t.delete_requested = true;
                true
            }
            _ => false,
        }
    }

    pub(super) fn delete_requested_trajectories(&mut self) {
        let requested: Vec<TrajectoryId> =
            self.state.trajectories.iter().filter(|(_, t)| t.delete_requested).map(|(id, _)| *id).collect();
        for id in requested {
            for submap_id in self.submaps_of(id) {
                self.trim_submap(submap_id);
            }
            self.state.trimmed_nodes.forget(id);
            self.mark_deleted(id);
        }
    }

    pub(super) fn mark_deleted(&mut self, id: TrajectoryId) {
        let trajectory = self.state.trajectory_mut(id);
        trajectory.delete_requested = false;
        trajectory.state = TrajectoryState::Deleted;
        self.problem.sensors.remove(&id);
        self.problem.fixed_frame_origins.remove(&id);
        self.problem.frozen.remove(&id);
    }

    pub(super) fn submaps_of(&self, id: TrajectoryId) -> Vec<SubmapId> {
        crate::of_trajectory(&self.state.submaps, id).map(|(id, _)| id).collect()
    }

    /// Starts keeping only the newest `keep` submaps of a trajectory.
    pub fn localize_only(&mut self, id: TrajectoryId, keep: usize) {
        self.add_trimmer(Trimmer::pure_localization(id, keep));
    }

    /// Takes over a trajectory of a file. It is complete: it receives no more data, but may be frozen or
    /// deleted.
    pub fn load_trajectory(&mut self, id: TrajectoryId, initial_pose: Option<InitialTrajectoryPose>) {
        self.add_trajectory(id, initial_pose);
        self.state.trajectory_mut(id).state = TrajectoryState::Finished;
    }

    /// Gives loaded submaps what files do not keep (see [`Space::complete_loaded`]); to be called once all
    /// nodes and constraints are loaded.
    pub fn complete_loaded_submaps(&mut self, options: &Options) {
        let nodes = &self.state.nodes;
        for entry in self.state.submaps.values_mut() {
            let Some(submap) = entry.submap.as_mut().filter(|_| entry.insertion_finished) else { continue };
            let mut inserted = entry.node_ids.iter().filter_map(|id| Some(nodes.get(id)?.data.as_ref()));
            S::complete_loaded(Arc::make_mut(submap), &mut inserted, options);
        }
    }

    /// Takes over a submap of a file.
    pub fn load_submap(
        &mut self,
        id: SubmapId,
        submap: Arc<S::Submap>,
        finished: bool,
        map_from_submap: Rigid3,
    ) {
        self.state.trajectory_mut(id.trajectory_id);
        let local_from_submap = S::local_from_submap(&submap);
        self.state.submaps.insert(
            id,
            SubmapEntry {
                submap: Some(submap),
                local_from_submap,
                searchable: true,
                insertion_finished: finished,
                node_ids: Default::default(),
            },
        );
        self.problem.submaps.insert(id, map_from_submap);
        self.state.optimized_submaps.insert(id, map_from_submap);
    }

    /// Takes over a node of a file.
    pub fn load_node(&mut self, id: NodeId, data: Arc<NodeData>, map_from_tracking: Rigid3) {
        let trajectory = self.state.trajectory_mut(id.trajectory_id);
        trajectory.next_node_index = trajectory.next_node_index.max(id.index.saturating_add(1));
        let gravity_alignment = data.gravity_alignment;
        self.problem.nodes.insert(
            id,
            OptimizationNode {
                time: data.time,
                local_from_node: S::graph_pose(&data.local_from_tracking, &gravity_alignment),
                map_from_node: S::graph_pose(&map_from_tracking, &gravity_alignment),
                gravity_alignment,
            },
        );
        self.state.nodes.insert(id, Node { data, map_from_tracking });
    }

    /// Takes over a constraint (in memory form) whose node and submap are loaded. Between frozen trajectories
    /// it connects nothing and moves nothing; it is kept so that saving the map again loses nothing. Returns
    /// whether both ends exist.
    pub fn load_constraint(&mut self, constraint: Constraint) -> bool {
        if !self.state.nodes.contains_key(&constraint.node_id) {
            return false;
        }
        let Some(entry) = self.state.submaps.get_mut(&constraint.submap_id) else { return false };
        match constraint.tag {
            ConstraintTag::IntraSubmap => {
                entry.node_ids.insert(constraint.node_id);
            }
            ConstraintTag::InterSubmap if self.both_frozen(constraint.node_id, constraint.submap_id) => {}
            ConstraintTag::InterSubmap => self.connect_by(&constraint),
        }
        self.state.constraints.push(constraint);
        true
    }

    /// A frame near the map.
    pub fn near_frame(&self) -> NearFrame {
        self.problem.near_frame()
    }

    /// Moves the whole map along its axes, metres. To be called before anything is searched in it, or when it is finished.
    pub fn move_by(&mut self, shift: &Vector3) {
        if *shift == Vector3::zeros() {
            return;
        }
        self.problem.move_by(shift);
        let state = &mut self.state;
        let of_trajectories =
            state.trajectories.values_mut().filter_map(|t| t.map_from_local_before_optimization.as_mut());
        let nodes = state.nodes.values_mut().map(|node| &mut node.map_from_tracking);
        for pose in state.optimized_submaps.values_mut().chain(nodes).chain(of_trajectories) {
            *pose = moved(pose, shift);
        }
        for id in state.trajectories.keys() {
            state.trimmed_nodes.shift(*id, &Rigid3::from_parts((*shift).into(), Default::default()));
        }
    }

    /// Sets the pose of a landmark.
    pub fn set_landmark_pose(&mut self, id: &str, map_from_landmark: Rigid3, frozen: bool) {
        let landmark = self.problem.landmarks.entry(id.to_owned()).or_default();
        landmark.map_from_landmark = Some(map_from_landmark);
        landmark.frozen = frozen;
    }

    /// Sets the pose of the fixed frame of a trajectory in the global map.
    pub fn set_fixed_frame_origin(&mut self, id: TrajectoryId, map_from_fixed: Rigid3) {
        self.problem.fixed_frame_origins.insert(id, Some(map_from_fixed));
    }

    /// Sets what is known of the IMU of a trajectory.
    pub fn set_imu_state(&mut self, id: TrajectoryId, state: ImuState) {
        self.problem.sensors_mut(id).imu_state = state;
    }
}
