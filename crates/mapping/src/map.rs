//! The finished map.

use std::collections::BTreeMap;

use portolan_config::Options;
use portolan_geometry::{Rigid3, Time, interpolate};
use portolan_recall::{Answer, Sink, Words};

use crate::mapper::EndedTrajectory;
use crate::{NodeId, PoseGraph, Space, TrajectoryId, TrimmedNode, of_trajectory};

/// One scan, inserted or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanPose {
    /// Time of its last point.
    pub time: Time,
    /// Pose of the tracking frame in the local map.
    pub local_from_tracking: Rigid3,
    /// Index of the last node at this time.
    pub last_node_index: Option<u32>,
}

impl Answer for ScanPose {
    fn write(&self, words: &mut impl Sink) {
        (self.time, (self.local_from_tracking, self.last_node_index.map_or(NO_NODE, u64::from))).write(words);
    }

    fn read(words: &mut Words<'_>) -> Option<Self> {
        let (time, (local_from_tracking, index)) = <(_, (_, u64))>::read(words)?;
        let last_node_index = if index == NO_NODE { None } else { Some(u32::try_from(index).ok()?) };
        Some(Self { time, local_from_tracking, last_node_index })
    }
}

/// Stands in files for scans before the first node.
const NO_NODE: u64 = u64::MAX;

/// A map: the pose graph with its options and trajectories.
pub struct Map<S: Space> {
    /// The options that it was made with.
    pub options: Options,
    /// Nodes, submaps, constraints, measurements.
    pub graph: PoseGraph<S>,
    /// Options, sensors and scans of each trajectory.
    pub trajectories: BTreeMap<TrajectoryId, EndedTrajectory>,
}

impl<S: Space> Map<S> {
    /// A map of these parts.
    pub fn new(
        options: Options,
        graph: PoseGraph<S>,
        trajectories: BTreeMap<TrajectoryId, EndedTrajectory>,
    ) -> Self {
        Self { options, graph, trajectories }
    }

    /// Time and global pose of every node of a trajectory, and of those that were trimmed.
    pub fn node_poses(&self, id: TrajectoryId) -> Vec<(Time, Rigid3)> {
        self.nodes_as_last(id).into_values().map(|node| (node.time, node.map_from_tracking)).collect()
    }

    /// Time and global pose of every scan of a trajectory, inserted or not: the pose of local SLAM, corrected
    /// as the nodes before and after it were.
    pub fn scan_poses(&self, id: TrajectoryId) -> Vec<(Time, Rigid3)> {
        let Some(trajectory) = self.trajectories.get(&id) else { return self.node_poses(id) };
        let nodes = self.nodes_as_last(id);
        let pose = |scan: ScanPose| Some((scan.time, scan_pose(id, &scan, &nodes)?));
        trajectory.scans.iter().filter_map(pose).collect()
    }

    /// Whether all poses requested so far could be read.
    ///
    /// # Errors
    /// Some of them were kept in a file that could not be read again, and were missing.
    pub fn whole(&self) -> std::io::Result<()> {
        self.trajectories.values().try_for_each(|trajectory| trajectory.scans.whole())?;
        self.graph.state().trimmed_nodes.whole()
    }

    /// The nodes of a trajectory as they are, or as they were when they were trimmed.
    fn nodes_as_last(&self, id: TrajectoryId) -> BTreeMap<NodeId, TrimmedNode> {
        let state = self.graph.state();
        let mut nodes = state.trimmed_nodes.of(id, &state.nodes);
        nodes.extend(of_trajectory(&state.nodes, id).map(|(id, node)| {
            let (time, local_from_tracking) = (node.data.time, node.data.local_from_tracking);
            (id, TrimmedNode { time, local_from_tracking, map_from_tracking: node.map_from_tracking })
        }));
        nodes
    }
}

/// Pose of a scan, interpolated between the corrections of the nodes before and after it.
fn scan_pose(id: TrajectoryId, scan: &ScanPose, nodes: &BTreeMap<NodeId, TrimmedNode>) -> Option<Rigid3> {
    let before = nodes.get(&NodeId::new(id, scan.last_node_index?))?;
    let by = |node: &TrimmedNode| {
        node.map_from_tracking * node.local_from_tracking.inverse() * scan.local_from_tracking
    };
    match nodes.get(&NodeId::new(id, scan.last_node_index? + 1)) {
        Some(after) if scan.time > before.time => {
            Some(interpolate(before.time, &by(before), after.time, &by(after), scan.time))
        }
        _ => Some(by(before)),
    }
}
