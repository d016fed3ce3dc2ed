//! Checks of the pose graph.

use crate::check::{Check, FindingKind, GraphIds};
use crate::pose::{node_id, submap_id};
use crate::proto::mapping::pose_graph::Constraint;
use crate::proto::mapping::pose_graph::constraint::Tag;
use crate::proto::mapping::{PoseGraph, Trajectory};

/// Checks poses, ids and constraints; returns the ids.
pub(crate) fn check_pose_graph(check: &mut Check, graph: &PoseGraph) -> GraphIds {
    let mut ids = GraphIds::default();
    for trajectory in &graph.trajectory {
        check_trajectory(check, trajectory, &mut ids);
    }
    for (i, constraint) in graph.constraint.iter().enumerate() {
        check_constraint(check, i, constraint, &ids);
        ids.constrained.insert(node_id(constraint.node_id.as_ref()).0);
    }
    for landmark in &graph.landmark_poses {
        check.pose(&format!("landmark {:?}", landmark.landmark_id), landmark.global_pose.as_ref());
    }
    ids
}

fn check_trajectory(check: &mut Check, trajectory: &Trajectory, ids: &mut GraphIds) {
    let t = trajectory.trajectory_id;
    ids.order.push(t);
    if t < 0 || !ids.trajectories.insert(t) {
        check.error(FindingKind::DuplicateId, format!("trajectory {t} is repeated or negative"));
    }
    for submap in &trajectory.submap {
        let i = submap.submap_index;
        if i < 0 || !ids.submaps.insert((t, i)) {
            check.error(
                FindingKind::DuplicateId,
                format!("submap ({t}, {i}) has two poses or a negative index"),
            );
        }
        check.pose(&format!("submap ({t}, {i})"), submap.pose.as_ref());
    }
    let mut last: Option<(i32, i64)> = None;
    for node in &trajectory.node {
        let i = node.node_index;
        if i < 0 || ids.nodes.insert((t, i), node.timestamp).is_some() {
            check.error(
                FindingKind::DuplicateId,
                format!("node ({t}, {i}) has two poses or a negative index"),
            );
        }
        check.pose(&format!("node ({t}, {i})"), node.pose.as_ref());
        if let Some((_, earlier)) = last.filter(|(j, time)| *j < i && *time >= node.timestamp) {
            let text = format!(
                "node ({t}, {i}) is not later than the one before ({} ticks)",
                i128::from(node.timestamp) - i128::from(earlier)
            );
            check.error(FindingKind::Time, text);
        }
        if last.is_some_and(|(j, _)| j > i) {
            check.warn(FindingKind::Order, format!("node ({t}, {i}) comes after one with a larger index"));
        }
        last = Some((i, node.timestamp));
    }
}

fn check_constraint(check: &mut Check, i: usize, constraint: &Constraint, ids: &GraphIds) {
    let submap = submap_id(constraint.submap_id.as_ref());
    let node = node_id(constraint.node_id.as_ref());
    if !ids.submaps.contains(&submap) {
        let text = format!("constraint {i} is to submap {submap:?}, which is not in the pose graph");
        check.error(FindingKind::Constraint, text);
    }
    if !ids.nodes.contains_key(&node) {
        let text = format!("constraint {i} is to node {node:?}, which is not in the pose graph");
        check.error(FindingKind::Constraint, text);
    }
    check.pose(&format!("constraint {i}"), constraint.relative_pose.as_ref());
    let weights = [constraint.translation_weight, constraint.rotation_weight];
    if !weights.iter().all(|w| w.is_finite() && *w >= 0.0) {
        check.error(FindingKind::Constraint, format!("constraint {i} has the weights {weights:?}"));
    }
    if Tag::try_from(constraint.tag).is_err() {
        let text = format!("constraint {i} is of the unknown kind {}", constraint.tag);
        check.error(FindingKind::Constraint, text);
    }
}
