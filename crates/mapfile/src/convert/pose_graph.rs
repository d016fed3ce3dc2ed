//! Writes the pose graph as the second message of a file (`formats.md` §2.1).

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Quaternion, Rigid3};
use portolan_mapping::{
    Constraint, ConstraintTag, GraphState, PoseGraph, SubmapId, TrajectoryId, TrajectoryState,
};

use super::grid::MapFileSpace;
use super::values::{id_to_proto, node_id_to_proto, submap_id_to_proto};
use super::{MapConversionError, WriteReport};
use portolan_pbstream::pose_to_proto;
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::proto::mapping::{pose_graph, trajectory};

/// Parts of a pose graph that are written to a file.
pub(super) struct Selection {
    /// Trajectories in the order of the file: by their first submap, then by their first node; then those
    /// that have neither.
    pub trajectories: Vec<TrajectoryId>,
    /// Submaps that are written.
    pub submaps: BTreeSet<SubmapId>,
}

impl Selection {
    /// Selects all trajectories that are not deleted, and the submaps that have a grid and are finished (or
    /// all with a grid with `include_unfinished`).
    pub fn new<S: MapFileSpace>(state: &GraphState<S>, include_unfinished: bool) -> Self {
        let mut seen = BTreeSet::new();
        let living = state.trajectories.iter().filter(|(_, t)| t.state != TrajectoryState::Deleted);
        let trajectories = (state.submaps.keys().map(|id| id.trajectory_id))
            .chain(state.nodes.keys().map(|id| id.trajectory_id))
            .chain(living.map(|(id, _)| *id))
            .filter(|id| seen.insert(*id))
            .collect();
        let submaps = (state.submaps.iter())
            .filter(|(_, s)| s.submap.is_some() && (include_unfinished || s.insertion_finished))
            .map(|(id, _)| *id)
            .collect();
        Self { trajectories, submaps }
    }
}

/// The message. Omitted parts are counted.
pub(super) fn pose_graph_to_proto<S: MapFileSpace>(
    graph: &PoseGraph<S>,
    selection: &Selection,
    report: &mut WriteReport,
) -> Result<m::PoseGraph, MapConversionError> {
    let state = graph.state();
    report.submaps_left_out += (state.submaps.len() - selection.submaps.len()) as u64;
    Ok(m::PoseGraph {
        constraint: constraints(state, selection, report)?,
        trajectory: trajectories(state, selection)?,
        landmark_poses: (graph.problem().landmarks.iter())
            .filter_map(|(id, landmark)| {
                let global_pose = Some(pose_to_proto(&landmark.map_from_landmark?));
                Some(pose_graph::LandmarkPose { landmark_id: id.clone(), global_pose })
            })
            .collect(),
    })
}

fn trajectories<S: MapFileSpace>(
    state: &GraphState<S>,
    selection: &Selection,
) -> Result<Vec<m::Trajectory>, MapConversionError> {
    let mut by_id = BTreeMap::new();
    for id in &selection.trajectories {
        by_id.insert(*id, m::Trajectory { trajectory_id: id_to_proto(id.0)?, ..Default::default() });
    }
    for id in &selection.submaps {
        if let (Some(trajectory), Some(pose)) = (by_id.get_mut(&id.trajectory_id), state.map_from_submap(*id))
        {
            let pose = Some(pose_to_proto(&pose));
            trajectory.submap.push(trajectory::Submap { submap_index: id_to_proto(id.index)?, pose });
        }
    }
    for (id, node) in &state.nodes {
        if let Some(trajectory) = by_id.get_mut(&id.trajectory_id) {
            trajectory.node.push(trajectory::Node {
                node_index: id_to_proto(id.index)?,
                timestamp: node.data.time.ticks(),
                pose: Some(pose_to_proto(&node.map_from_tracking)),
            });
        }
    }
    Ok(selection.trajectories.iter().filter_map(|id| by_id.remove(id)).collect())
}

fn constraints<S: MapFileSpace>(
    state: &GraphState<S>,
    selection: &Selection,
    report: &mut WriteReport,
) -> Result<Vec<pose_graph::Constraint>, MapConversionError> {
    let mut messages = Vec::with_capacity(state.constraints.len());
    for constraint in &state.constraints {
        let node = state.nodes.get(&constraint.node_id);
        let Some(node) = node.filter(|_| selection.submaps.contains(&constraint.submap_id)) else {
            report.constraints_left_out += 1;
            continue;
        };
        let pose = pose_for_file::<S>(&constraint.submap_from_node, &node.data.gravity_alignment);
        messages.push(pose_graph::Constraint {
            submap_id: Some(submap_id_to_proto(constraint.submap_id)?),
            node_id: Some(node_id_to_proto(constraint.node_id)?),
            relative_pose: Some(pose_to_proto(&pose)),
            translation_weight: constraint.translation_weight,
            rotation_weight: constraint.rotation_weight,
            tag: tag_to_proto(constraint).into(),
        });
    }
    Ok(messages)
}

fn tag_to_proto(constraint: &Constraint) -> Tag {
    match constraint.tag {
        ConstraintTag::IntraSubmap => Tag::IntraSubmap,
        ConstraintTag::InterSubmap => Tag::InterSubmap,
    }
}

/// Constraints in files refer to the tracking frame, in 2D too. A rotated pose is rounded to 1e-12, so that
/// repeated reading and writing always gives the same bytes.
fn pose_for_file<S: MapFileSpace>(submap_from_node: &Rigid3, gravity_alignment: &Quaternion) -> Rigid3 {
    let turned = S::tracking_pose(submap_from_node, gravity_alignment);
    if turned == *submap_from_node {
        return *submap_from_node;
    }
    // Adding 0.0 turns a computed −0.0 into 0.0.
    let rounded = |v: f64| (v * ROUNDING).round() / ROUNDING + 0.0;
    Rigid3::from_parts(
        turned.translation.vector.map(rounded).into(),
        Quaternion::new_unchecked(turned.rotation.quaternion().coords.map(rounded).into()),
    )
}

/// Inverse of the rounding step, 2⁴⁰: about 1e-12 m or rad.
const ROUNDING: f64 = 1_099_511_627_776.0;

/// The inverse of [`pose_for_file`].
pub(super) fn pose_in_memory<S: MapFileSpace>(
    submap_from_tracking: Rigid3,
    gravity_alignment: &Quaternion,
) -> Rigid3 {
    let turned = S::tracking_pose(&submap_from_tracking, &gravity_alignment.inverse());
    if turned == submap_from_tracking { submap_from_tracking } else { turned }
}
