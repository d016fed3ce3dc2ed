//! Transforms the poses of the whole graph, or replaces them by poses of another program.

use std::collections::BTreeMap;

use portolan_geometry::{Rigid3, Time, interpolate};
use serde::Serialize;

use super::{EditError, MapDraft};
use portolan_pbstream::proto::mapping::PoseGraph;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::proto::transform::Rigid3d;
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, pose_to_proto, submap_id};

/// Report of a replacement of poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PoseReplacement {
    /// Nodes that got a new pose.
    pub nodes: u64,
    /// Nodes outside of the times of the given poses: moved with the nearest node that has a new pose.
    pub nodes_moved_along: u64,
    /// Submaps that got a new pose, from the nodes in them.
    pub submaps: u64,
}

/// Applies a transform to every global pose.
pub(super) fn transform_graph(graph: &mut PoseGraph, new_from_old: &Rigid3) {
    let apply = |pose: &mut Option<Rigid3d>| {
        if let Some(old) = pose_from_proto(pose.as_ref()) {
            *pose = Some(pose_to_proto(&(new_from_old * old)));
        }
    };
    for trajectory in &mut graph.trajectory {
        trajectory.submap.iter_mut().for_each(|s| apply(&mut s.pose));
        trajectory.node.iter_mut().for_each(|n| apply(&mut n.pose));
    }
    graph.landmark_poses.iter_mut().for_each(|l| apply(&mut l.global_pose));
}

impl MapDraft {
    /// Sets global poses of submaps and nodes; those that are not given keep theirs.
    pub fn set_poses(&mut self, submaps: &BTreeMap<IdInFile, Rigid3>, nodes: &BTreeMap<IdInFile, Rigid3>) {
        for trajectory in &mut self.graph.trajectory {
            let t = trajectory.trajectory_id;
            for submap in &mut trajectory.submap {
                if let Some(pose) = submaps.get(&(t, submap.submap_index)) {
                    submap.pose = Some(pose_to_proto(pose));
                }
            }
            for node in &mut trajectory.node {
                if let Some(pose) = nodes.get(&(t, node.node_index)) {
                    node.pose = Some(pose_to_proto(pose));
                }
            }
        }
    }

    /// Replaces the poses of a trajectory by external ones (a refinement, a survey). Nodes get poses
    /// interpolated at their times, submaps the pose by the first node inserted into them. `poses` must
    /// ascend in time.
    ///
    /// # Errors
    /// If the trajectory is missing, or if no node is within the times of the poses.
    pub fn replace_trajectory(
        &mut self,
        id: i32,
        poses: &[(Time, Rigid3)],
    ) -> Result<PoseReplacement, EditError> {
        self.require_trajectory(id)?;
        let mut done = PoseReplacement::default();
        let old = self.node_poses(id);
        let mut corrections: Vec<(Time, Rigid3)> = Vec::new();
        for (_, time, pose) in &old {
            if let Some(new) = pose_at(poses, *time) {
                corrections.push((*time, new * pose.inverse()));
            }
        }
        if corrections.is_empty() {
            return Err(EditError::Poses(
                "no node of the map is within the time span of the trajectory: do both have the same clock?"
                    .to_owned(),
            ));
        }
        let mut nodes = BTreeMap::new();
        for (index, time, pose) in &old {
            let after = corrections.partition_point(|(t, _)| t < time);
            let nearest = [after.checked_sub(1), Some(after)].into_iter().flatten();
            let nearest = nearest.filter_map(|i| corrections.get(i));
            let Some((at, correction)) = nearest.min_by_key(|(t, _)| (*t - *time).ticks().unsigned_abs())
            else {
                continue;
            };
            if at == time {
                done.nodes += 1;
            } else {
                done.nodes_moved_along += 1;
            }
            nodes.insert((id, *index), correction * pose);
        }
        let submaps = self.submaps_by_nodes(&nodes);
        done.submaps = submaps.len() as u64;
        self.set_poses(&submaps, &nodes);
        Ok(done)
    }

    /// Poses of submaps by the first intra-submap constraint to a node that has a new pose.
    fn submaps_by_nodes(&self, nodes: &BTreeMap<IdInFile, Rigid3>) -> BTreeMap<IdInFile, Rigid3> {
        let mut submaps = BTreeMap::new();
        for constraint in self.graph.constraint.iter().filter(|c| c.tag() == Tag::IntraSubmap) {
            let submap = submap_id(constraint.submap_id.as_ref());
            let (Some(node), Some(measured)) = (
                nodes.get(&node_id(constraint.node_id.as_ref())),
                pose_from_proto(constraint.relative_pose.as_ref()),
            ) else {
                continue;
            };
            submaps.entry(submap).or_insert_with(|| node * measured.inverse());
        }
        submaps
    }

    /// Index, time and global pose of the nodes of a trajectory.
    pub(super) fn node_poses(&self, id: i32) -> Vec<(i32, Time, Rigid3)> {
        let trajectories = self.graph.trajectory.iter().filter(|t| t.trajectory_id == id);
        let nodes = trajectories.flat_map(|t| &t.node);
        nodes
            .filter_map(|n| {
                Some((n.node_index, Time::from_ticks(n.timestamp), pose_from_proto(n.pose.as_ref())?))
            })
            .collect()
    }
}

/// Pose interpolated at a time; none outside of the times of the list.
fn pose_at(poses: &[(Time, Rigid3)], time: Time) -> Option<Rigid3> {
    let after = poses.partition_point(|(t, _)| *t < time);
    let (end, end_pose) = poses.get(after)?;
    if *end == time {
        return Some(*end_pose);
    }
    let (start, start_pose) = poses.get(after.checked_sub(1)?)?;
    Some(interpolate(*start, start_pose, *end, end_pose, time))
}
