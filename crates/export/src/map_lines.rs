//! Extracts trajectories and loop closures of a map file as lines.

use std::collections::BTreeMap;

use portolan_pbstream::proto::mapping::PoseGraph;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, submap_id, submap_poses};

use crate::overlay::{ConstraintLine, TrajectoryLine};

/// The trajectories of a map, coloured by their index in the file. Nodes without a valid pose are left out.
pub fn trajectory_lines(graph: &PoseGraph) -> Vec<TrajectoryLine> {
    let lines = graph.trajectory.iter().enumerate().map(|(index, trajectory)| {
        let poses = trajectory.node.iter().filter_map(|n| pose_from_proto(n.pose.as_ref()));
        TrajectoryLine { index, points: poses.map(|p| [p.translation.x, p.translation.y]).collect() }
    });
    lines.filter(|l| !l.points.is_empty()).collect()
}

/// The loop closures of a map, each from the origin of the submap to the node. Those with a missing submap or
/// node are left out.
pub fn constraint_lines(graph: &PoseGraph) -> Vec<ConstraintLine> {
    let submaps = submap_poses(graph);
    let nodes: BTreeMap<IdInFile, [f64; 2]> = graph
        .trajectory
        .iter()
        .flat_map(|t| t.node.iter().map(move |n| ((t.trajectory_id, n.node_index), n.pose.as_ref())))
        .filter_map(|(id, pose)| Some((id, pose_from_proto(pose)?)))
        .map(|(id, pose)| (id, [pose.translation.x, pose.translation.y]))
        .collect();
    let loops = graph.constraint.iter().filter(|c| c.tag() == Tag::InterSubmap);
    loops
        .filter_map(|c| {
            let (submap, node) = (submap_id(c.submap_id.as_ref()), node_id(c.node_id.as_ref()));
            let from = submaps.get(&submap)?.translation;
            let between_trajectories = submap.0 != node.0;
            Some(ConstraintLine { from: [from.x, from.y], to: *nodes.get(&node)?, between_trajectories })
        })
        .collect()
}
