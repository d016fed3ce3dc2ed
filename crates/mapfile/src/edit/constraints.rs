//! Evaluates, removes and adds loop closures.

use std::collections::BTreeMap;

use portolan_geometry::{Rigid3, rotation_angle};
use serde::Serialize;

use super::{EditError, MapDraft};
use portolan_pbstream::proto::mapping::pose_graph::Constraint;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::proto::mapping::{NodeId, SubmapId};
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, pose_to_proto, submap_id, submap_poses};

/// Residual of a loop closure against the poses of the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LoopResidual {
    /// The submap.
    pub submap: IdInFile,
    /// The node.
    pub node: IdInFile,
    /// Translation, metres.
    pub translation: f64,
    /// Rotation, radians.
    pub rotation: f64,
}

/// Weights of a loop closure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopWeights {
    /// Weight of the translation, 1/m.
    pub translation: f64,
    /// Weight of the rotation, 1/rad.
    pub rotation: f64,
}

/// Default weights, those of `loop_closure_translation_weight` and `loop_closure_rotation_weight`.
const DEFAULT_WEIGHTS: LoopWeights = LoopWeights { translation: 1.1e4, rotation: 1e5 };

/// Ids as text for messages: `0,0 to 0,7, 1,0 to 1,3`, by trajectory. `ids` ascend.
fn ranges<'a>(ids: impl Iterator<Item = &'a IdInFile>) -> String {
    let mut ranges: BTreeMap<i32, (i32, i32)> = BTreeMap::new();
    for (trajectory, index) in ids {
        ranges.entry(*trajectory).and_modify(|range| range.1 = *index).or_insert((*index, *index));
    }
    if ranges.is_empty() {
        return "none".to_owned();
    }
    let text = |(t, (first, last)): (&i32, &(i32, i32))| format!("{t},{first} to {t},{last}");
    ranges.iter().map(text).collect::<Vec<_>>().join(", ")
}

impl MapDraft {
    /// All loop closures with their residuals, the largest translation first.
    pub fn loop_residuals(&self) -> Vec<LoopResidual> {
        let submaps = submap_poses(&self.graph);
        let nodes = self.all_node_poses();
        let loops = self.graph.constraint.iter().filter(|c| c.tag() == Tag::InterSubmap);
        let mut residuals: Vec<LoopResidual> = loops
            .filter_map(|c| {
                let (submap, node) = (submap_id(c.submap_id.as_ref()), node_id(c.node_id.as_ref()));
                let measured = pose_from_proto(c.relative_pose.as_ref())?;
                let found = submaps.get(&submap)?.inverse() * nodes.get(&node)?;
                let error = measured.inverse() * found;
                let translation = (found.translation.vector - measured.translation.vector).norm();
                Some(LoopResidual { submap, node, translation, rotation: rotation_angle(&error) })
            })
            .collect();
        let order = |r: &LoopResidual| (r.submap, r.node);
        residuals.sort_by(|a, b| b.translation.total_cmp(&a.translation).then(order(a).cmp(&order(b))));
        residuals
    }

    /// Global poses of all nodes.
    pub(super) fn all_node_poses(&self) -> BTreeMap<IdInFile, Rigid3> {
        let nodes = self.graph.trajectory.iter().flat_map(|t| {
            t.node.iter().filter_map(move |n| {
                Some(((t.trajectory_id, n.node_index), pose_from_proto(n.pose.as_ref())?))
            })
        });
        nodes.collect()
    }

    /// Removes the loop closures between a submap and a node.
    ///
    /// # Errors
    /// If there is no such loop closure.
    pub fn drop_loop(&mut self, submap: IdInFile, node: IdInFile) -> Result<(), EditError> {
        let dropped = self
            .drop_loops(|c| submap_id(c.submap_id.as_ref()) == submap && node_id(c.node_id.as_ref()) == node);
        if dropped == 0 { Err(EditError::NoLoop { submap, node }) } else { Ok(()) }
    }

    /// Removes the loop closures with residuals above these limits, metres and radians. Returns their number.
    pub fn drop_loops_beyond(&mut self, translation: f64, rotation: f64) -> u64 {
        let bad: std::collections::BTreeSet<(IdInFile, IdInFile)> = self
            .loop_residuals()
            .into_iter()
            .filter(|r| r.translation > translation || r.rotation > rotation)
            .map(|r| (r.submap, r.node))
            .collect();
        self.drop_loops(|c| bad.contains(&(submap_id(c.submap_id.as_ref()), node_id(c.node_id.as_ref()))))
    }

    fn drop_loops(&mut self, bad: impl Fn(&Constraint) -> bool) -> u64 {
        let before = self.graph.constraint.len();
        self.graph.constraint.retain(|c| c.tag() != Tag::InterSubmap || !bad(c));
        let dropped = (before - self.graph.constraint.len()) as u64;
        self.report.constraints_removed += dropped;
        dropped
    }

    /// The median weights of the loop closures of this map, or the defaults if there are none.
    pub fn loop_weights(&self) -> LoopWeights {
        let loops = || self.graph.constraint.iter().filter(|c| c.tag() == Tag::InterSubmap);
        let median = |mut values: Vec<f64>| {
            values.retain(|v| v.is_finite());
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        LoopWeights {
            translation: median(loops().map(|c| c.translation_weight).collect())
                .unwrap_or(DEFAULT_WEIGHTS.translation),
            rotation: median(loops().map(|c| c.rotation_weight).collect())
                .unwrap_or(DEFAULT_WEIGHTS.rotation),
        }
    }

    /// Adds a loop closure: the pose of the node's tracking frame in the submap. Poses change only when the
    /// map is optimised.
    ///
    /// # Errors
    /// If the submap or node is missing.
    pub fn add_loop(
        &mut self,
        submap: IdInFile,
        node: IdInFile,
        submap_from_node: &Rigid3,
        weights: LoopWeights,
    ) -> Result<(), EditError> {
        self.require_parts(submap, node)?;
        self.graph.constraint.push(Constraint {
            submap_id: Some(SubmapId { trajectory_id: submap.0, submap_index: submap.1 }),
            node_id: Some(NodeId { trajectory_id: node.0, node_index: node.1 }),
            relative_pose: Some(pose_to_proto(submap_from_node)),
            translation_weight: weights.translation,
            rotation_weight: weights.rotation,
            tag: Tag::InterSubmap.into(),
        });
        self.report.constraints_added += 1;
        Ok(())
    }

    pub(super) fn require_parts(&self, submap: IdInFile, node: IdInFile) -> Result<(), EditError> {
        let (submaps, nodes) = (submap_poses(&self.graph), self.all_node_poses());
        if !submaps.contains_key(&submap) {
            let known = ranges(submaps.keys());
            return Err(EditError::NoPart { what: "submap", id: submap, known });
        }
        if !nodes.contains_key(&node) {
            return Err(EditError::NoPart { what: "node", id: node, known: ranges(nodes.keys()) });
        }
        Ok(())
    }
}
