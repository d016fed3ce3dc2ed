//! State of the pose graph: trajectories, submaps, nodes and constraints.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use portolan_geometry::{Rigid3, Time};
use portolan_optimization::TrajectoryConnectivity;

use super::TrimmedNodes;
use crate::{Constraint, LocalSlamSpace, Node, NodeData, NodeId, Space, SubmapId, TrajectoryId};
use portolan_local_slam::OdometryBridge;

/// State of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryState {
    /// Still receives data.
    Active,
    /// Complete.
    Finished,
    /// A fixed part of the map.
    Frozen,
    /// Removed.
    Deleted,
}

/// Start of a new trajectory relative to another one.
#[derive(Clone, Debug, PartialEq)]
pub struct InitialTrajectoryPose {
    /// The trajectory that it refers to.
    pub to_trajectory_id: TrajectoryId,
    /// Pose of the new local map relative to the reference trajectory at `time`.
    pub relative_pose: Rigid3,
    /// Time on the reference trajectory (clamped to its ends).
    pub time: Time,
}

/// A submap in the pose graph.
#[derive(Clone, Debug)]
pub struct SubmapEntry<S: Space> {
    /// The grid, once local SLAM has handed it over.
    pub submap: Option<Arc<S::Submap>>,
    /// Pose in the local map.
    pub local_from_submap: Rigid3,
    /// Whether nodes may be searched in it.
    pub searchable: bool,
    /// Whether no scan will be inserted any more.
    pub insertion_finished: bool,
    /// Nodes inserted into it.
    pub node_ids: BTreeSet<NodeId>,
}

/// Loop closures of a trajectory with others that were removed with trimmed nodes and submaps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrimmedTies {
    /// Number of them.
    pub count: usize,
    /// Time of the earliest node of the trajectory that took part.
    pub first: Time,
}

/// A gap between two trajectories that share their local map: without scans, or with scans that contradicted the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// The trajectory before it.
    pub before: TrajectoryId,
    /// Uncertainty of the motion in it as measured by odometry.
    pub bridge: OdometryBridge,
    /// Path length over which poses drift as much as odometry may be off in the gap, metres; windows of loop
    /// searches follow it.
    pub path_length: f64,
}

/// Data of one trajectory besides its nodes and submaps.
#[derive(Clone, Debug)]
pub struct TrajectoryEntry {
    /// State.
    pub state: TrajectoryState,
    /// Its start, if that is known.
    pub initial_pose: Option<InitialTrajectoryPose>,
    /// Pose at which its local map is drawn as long as nothing else determines it.
    pub map_from_local_before_optimization: Option<Rigid3>,
    /// The gap after which it continues another trajectory, bridged by odometry alone.
    pub after_gap: Option<Gap>,
    /// Index that the next node gets.
    pub next_node_index: u32,
    /// Deletion was asked for and waits for the next optimisation.
    pub delete_requested: bool,
}

impl Default for TrajectoryEntry {
    fn default() -> Self {
        Self {
            state: TrajectoryState::Active,
            initial_pose: None,
            map_from_local_before_optimization: None,
            after_gap: None,
            next_node_index: 0,
            delete_requested: false,
        }
    }
}

/// A submap and a node that are matched.
type Pair<'a, S> = ((SubmapId, &'a Arc<<S as LocalSlamSpace>::Submap>), (NodeId, &'a Arc<NodeData>));

/// Nodes, submaps, constraints and trajectories.
#[derive(Clone, Debug)]
pub struct GraphState<S: Space> {
    /// Trajectories.
    pub trajectories: BTreeMap<TrajectoryId, TrajectoryEntry>,
    /// Submaps.
    pub submaps: BTreeMap<SubmapId, SubmapEntry<S>>,
    /// Nodes; in files the poses are those of the tracking frame.
    pub nodes: BTreeMap<NodeId, Node>,
    /// In order of arrival.
    pub constraints: Vec<Constraint>,
    /// Which trajectories are connected.
    pub connectivity: TrajectoryConnectivity,
    /// Submap poses of the last optimisation; submaps not in it follow their trajectory.
    pub optimized_submaps: BTreeMap<SubmapId, Rigid3>,
    /// Poses of the nodes that trimmers removed. Files do not keep them.
    pub trimmed_nodes: TrimmedNodes,
    /// By trajectory.
    pub trimmed_ties: BTreeMap<TrajectoryId, TrimmedTies>,
}

impl<S: Space> Default for GraphState<S> {
    fn default() -> Self {
        Self {
            trajectories: BTreeMap::new(),
            submaps: BTreeMap::new(),
            nodes: BTreeMap::new(),
            constraints: Vec::new(),
            connectivity: TrajectoryConnectivity::default(),
            optimized_submaps: BTreeMap::new(),
            trimmed_nodes: TrimmedNodes::default(),
            trimmed_ties: BTreeMap::new(),
        }
    }
}

impl<S: Space> GraphState<S> {
    /// The trajectory, created active when it is new.
    pub fn trajectory_mut(&mut self, id: TrajectoryId) -> &mut TrajectoryEntry {
        self.connectivity.add(id);
        self.trajectories.entry(id).or_default()
    }

    /// State of a trajectory; unknown ones count as deleted.
    pub fn trajectory_state(&self, id: TrajectoryId) -> TrajectoryState {
        self.trajectories.get(&id).map_or(TrajectoryState::Deleted, |t| t.state)
    }

    /// Time of the last node that was inserted into a submap; none if there is none.
    pub fn time_of_last_node(&self, submap: &SubmapEntry<S>) -> Option<Time> {
        let last = submap.node_ids.iter().next_back()?;
        self.nodes.get(last).map(|n| n.data.time)
    }

    /// A pair to be matched: a submap that is in memory, and a node; none if either is gone.
    pub(super) fn pair(&self, submap_id: SubmapId, node_id: NodeId) -> Option<Pair<'_, S>> {
        let submap = self.submaps.get(&submap_id)?.submap.as_ref()?;
        Some(((submap_id, submap), (node_id, &self.nodes.get(&node_id)?.data)))
    }

    /// Transform from the local map of a trajectory to the global map: by its last optimised submap,
    /// else by its initial pose, else the identity (`slam2d.md` §14.4).
    pub fn map_from_local(&self, trajectory_id: TrajectoryId) -> Rigid3 {
        let optimized = crate::of_trajectory(&self.optimized_submaps, trajectory_id).next_back();
        if let Some((id, map_from_submap)) = optimized
            && let Some(entry) = self.submaps.get(&id)
        {
            return map_from_submap * entry.local_from_submap.inverse();
        }
        let trajectory = self.trajectories.get(&trajectory_id);
        self.initial_map_from_local(trajectory_id)
            .or_else(|| trajectory?.map_from_local_before_optimization)
            .unwrap_or_else(Rigid3::identity)
    }

    fn initial_map_from_local(&self, trajectory_id: TrajectoryId) -> Option<Rigid3> {
        let initial = self.trajectories.get(&trajectory_id)?.initial_pose.as_ref()?;
        let reference: portolan_geometry::TransformBuffer =
            crate::of_trajectory(&self.nodes, initial.to_trajectory_id)
                .map(|(_, node)| (node.data.time, node.map_from_tracking))
                .collect();
        Some(reference.lookup_clamped(initial.time)? * initial.relative_pose)
    }

    /// Global pose of a submap: optimised, or else derived from its trajectory.
    pub fn map_from_submap(&self, id: SubmapId) -> Option<Rigid3> {
        let entry = self.submaps.get(&id)?;
        Some(
            self.optimized_submaps
                .get(&id)
                .copied()
                .unwrap_or_else(|| self.map_from_local(id.trajectory_id) * entry.local_from_submap),
        )
    }
}
