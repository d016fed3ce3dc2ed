//! Repairs the pose graph, so that the rest of it is consistent.

use std::collections::{BTreeMap, BTreeSet};

use crate::mend::mend_pose;
use crate::repair::Repair;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::proto::mapping::{AllTrajectoryBuilderOptions, PoseGraph, Trajectory, trajectory};
use portolan_pbstream::proto::transform::Rigid3d;
use portolan_pbstream::{IdInFile, node_id, submap_id};
use portolan_pbstream::{bad_starts, start_of};

/// Nodes and submaps with intact messages.
#[derive(Default)]
pub(crate) struct Parts {
    /// Time, ticks, and pose in the local map.
    pub nodes: BTreeMap<IdInFile, (i64, Option<Rigid3d>)>,
    /// Pose in the local map.
    pub submaps: BTreeMap<IdInFile, Option<Rigid3d>>,
}

impl Parts {
    /// A pose graph from the local poses: without loop closures, each trajectory in its own local map.
    pub fn pose_graph(&self) -> PoseGraph {
        let ids = self.submaps.keys().chain(self.nodes.keys()).map(|(t, _)| *t);
        let ids: BTreeSet<i32> = ids.collect();
        let trajectory = ids.into_iter().map(|trajectory_id| Trajectory {
            trajectory_id,
            node: self
                .nodes
                .range((trajectory_id, i32::MIN)..=(trajectory_id, i32::MAX))
                .map(|(&(_, node_index), &(timestamp, pose))| trajectory::Node {
                    node_index,
                    timestamp,
                    pose,
                })
                .collect(),
            submap: self
                .submaps
                .range((trajectory_id, i32::MIN)..=(trajectory_id, i32::MAX))
                .map(|(&(_, submap_index), &pose)| trajectory::Submap { submap_index, pose })
                .collect(),
        });
        PoseGraph { trajectory: trajectory.collect(), ..PoseGraph::default() }
    }
}

/// Removes from the pose graph all parts that occur twice, have no valid pose or no intact message, and the
/// constraints to them. Options stay with their trajectories; missing ones become empty.
pub(crate) fn mend_pose_graph(
    graph: &mut PoseGraph,
    options: &mut AllTrajectoryBuilderOptions,
    parts: &Parts,
    repairs: &mut Vec<Repair>,
) {
    let mut seen = BTreeSet::new();
    let keep: Vec<bool> =
        graph.trajectory.iter().map(|t| t.trajectory_id >= 0 && seen.insert(t.trajectory_id)).collect();
    let wanted = graph.trajectory.len();
    if options.options_with_sensor_ids.len() != wanted {
        options.options_with_sensor_ids.resize(wanted, Default::default());
        repairs.push(Repair::OptionsMade);
    }
    let mut flags = keep.iter();
    options.options_with_sensor_ids.retain(|_| flags.next().copied().unwrap_or(false));
    let mut flags = keep.iter();
    graph.trajectory.retain(|_| flags.next().copied().unwrap_or(false));
    repairs.extend(keep.iter().filter(|k| !**k).map(|_| Repair::TrajectoryDropped));
    mend_starts(graph, options, repairs);

    let mut nodes = BTreeSet::new();
    let mut submaps = BTreeSet::new();
    for trajectory in &mut graph.trajectory {
        mend_trajectory(trajectory, parts, &mut nodes, &mut submaps, repairs);
    }
    graph.constraint.retain_mut(|c| {
        let weights = [c.translation_weight, c.rotation_weight];
        let good = submaps.contains(&submap_id(c.submap_id.as_ref()))
            && nodes.contains(&node_id(c.node_id.as_ref()))
            && weights.iter().all(|w| w.is_finite() && *w >= 0.0)
            && Tag::try_from(c.tag).is_ok()
            && mend_pose(c.relative_pose.as_mut(), repairs);
        if !good {
            repairs.push(Repair::ConstraintDropped);
        }
        good
    });
    graph.landmark_poses.retain_mut(|l| {
        let good = mend_pose(l.global_pose.as_mut(), repairs);
        if !good {
            repairs.push(Repair::LandmarkDropped);
        }
        good
    });
}

/// Removes starts that are relative to a missing trajectory or that form a cycle.
fn mend_starts(graph: &PoseGraph, options: &mut AllTrajectoryBuilderOptions, repairs: &mut Vec<Repair>) {
    let ids: Vec<i32> = graph.trajectory.iter().map(|t| t.trajectory_id).collect();
    let starts: Vec<Option<i32>> = options.options_with_sensor_ids.iter().map(start_of).collect();
    for (place, _) in bad_starts(&ids, &starts) {
        let options = options.options_with_sensor_ids.get_mut(place);
        if let Some(options) = options.and_then(|o| o.trajectory_builder_options.as_mut()) {
            options.initial_trajectory_pose = None;
            repairs.push(Repair::StartDropped);
        }
    }
}

fn mend_trajectory(
    trajectory: &mut Trajectory,
    parts: &Parts,
    nodes: &mut BTreeSet<IdInFile>,
    submaps: &mut BTreeSet<IdInFile>,
    repairs: &mut Vec<Repair>,
) {
    let t = trajectory.trajectory_id;
    trajectory.submap.retain_mut(|s| {
        let id = (t, s.submap_index);
        let good = id.1 >= 0
            && parts.submaps.contains_key(&id)
            && !submaps.contains(&id)
            && mend_pose(s.pose.as_mut(), repairs);
        if good {
            submaps.insert(id);
        } else {
            repairs.push(Repair::SubmapPoseDropped);
        }
        good
    });
    let mut last = i64::MIN;
    trajectory.node.retain_mut(|n| {
        let id = (t, n.node_index);
        let good = id.1 >= 0
            && n.timestamp > last
            && parts.nodes.contains_key(&id)
            && !nodes.contains(&id)
            && mend_pose(n.pose.as_mut(), repairs);
        if good {
            nodes.insert(id);
            last = n.timestamp;
        } else {
            repairs.push(Repair::NodePoseDropped);
        }
        good
    });
}
