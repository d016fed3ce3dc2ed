//! The finished map.

use std::collections::BTreeMap;

use portolan_config::Options;
use portolan_geometry::{Rigid3, Time, interpolate};

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

/// A map: the pose graph with all that came along.
pub struct Map<S: Space> {
    /// The options that it was made with.
    pub options: Options,
    /// Nodes, submaps, constraints, measurements.
    pub graph: PoseGraph<S>,
    /// Options, sensors and scans of each trajectory.
    pub trajectories: BTreeMap<TrajectoryId, EndedTrajectory>,
}

impl<S: Space> Map<S> {
    /// Puts the parts together.
    pub fn new(
        options: Options,
        graph: PoseGraph<S>,
        trajectories: BTreeMap<TrajectoryId, EndedTrajectory>,
    ) -> Self {
        Self { options, graph, trajectories }
    }

    /// Time and global pose of every node of a trajectory, and of those that were trimmed.
    pub fn node_poses(&self, id: TrajectoryId) -> Vec<(Time, Rigid3)> {
        let state = self.graph.state();
        let kept = of_trajectory(&state.nodes, id).map(|(id, n)| (id, (n.data.time, n.map_from_tracking)));
        let trimmed = of_trajectory(&state.trimmed_nodes, id);
        let trimmed = trimmed.map(|(id, n)| (id, (n.time, n.map_from_tracking)));
        let all: BTreeMap<NodeId, (Time, Rigid3)> = kept.chain(trimmed).collect();
        all.into_values().collect()
    }

    /// Time and global pose of every scan of a trajectory, inserted or not: what local SLAM found,
    /// corrected as the nodes before and after it were.
    pub fn scan_poses(&self, id: TrajectoryId) -> Vec<(Time, Rigid3)> {
        let Some(trajectory) = self.trajectories.get(&id) else { return self.node_poses(id) };
        trajectory.scans.iter().filter_map(|scan| Some((scan.time, self.scan_pose(id, scan)?))).collect()
    }

    fn scan_pose(&self, id: TrajectoryId, scan: &ScanPose) -> Option<Rigid3> {
        let before = self.node_as_last(NodeId::new(id, scan.last_node_index?))?;
        let by = |node: &TrimmedNode| {
            node.map_from_tracking * node.local_from_tracking.inverse() * scan.local_from_tracking
        };
        match self.node_as_last(NodeId::new(id, scan.last_node_index? + 1)) {
            Some(after) if scan.time > before.time => {
                Some(interpolate(before.time, &by(&before), after.time, &by(&after), scan.time))
            }
            _ => Some(by(&before)),
        }
    }

    /// A node as it is, or as it was when it was trimmed.
    fn node_as_last(&self, id: NodeId) -> Option<TrimmedNode> {
        let state = self.graph.state();
        let kept = state.nodes.get(&id).map(|node| TrimmedNode {
            time: node.data.time,
            local_from_tracking: node.data.local_from_tracking,
            map_from_tracking: node.map_from_tracking,
        });
        kept.or_else(|| state.trimmed_nodes.get(&id).copied())
    }
}
