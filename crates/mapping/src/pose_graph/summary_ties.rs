//! Summarises the constraints of a removed submap as a few constraints between the submaps that stay.
//!
//! Marginalising its pose and those of its nodes would tie every two of its neighbours. A tree keeps nearly
//! all of that information (Kretzschmar and Stachniss, "Information-theoretic compression of pose graphs for
//! laser-based SLAM", IJRR 2012, §5): the neighbour with the strongest tie is tied to each of the others, at
//! their present relative poses. The strength follows from the constraints on the path, as resistances in
//! series; repeated summaries of the same pair add up.

use std::collections::BTreeMap;

use super::PoseGraph;
use crate::{Constraint, NodeId, Space, SubmapId};

/// Maximum number of neighbours that are tied, the strongest first.
const NEIGHBOURS: usize = 8;
/// Maximum strength of a tie, in loop closures: errors of the same submap do not average out.
const STRONGEST: f64 = 25.0;

/// Summary ties, by submap and node: their strength in loop closures.
pub(super) type SummaryTies = BTreeMap<(SubmapId, NodeId), f64>;

impl<S: Space> PoseGraph<S> {
    /// Ties the neighbours of a submap that is about to be removed.
    pub(super) fn summarise(&mut self, id: SubmapId) {
        let mut neighbours: Vec<(SubmapId, f64)> = self.neighbours(id).into_iter().collect();
        neighbours.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let Some(((hub, to_hub), others)) = neighbours.split_first() else { return };
        for (other, to_other) in others.iter().take(NEIGHBOURS) {
            self.add_summary(*hub, *other, 1.0 / (1.0 / to_hub + 1.0 / to_other));
        }
    }

    /// The submaps that share constraints with this one, and the strength of their ties in loop closures.
    fn neighbours(&self, id: SubmapId) -> BTreeMap<SubmapId, f64> {
        let mut neighbours: BTreeMap<SubmapId, f64> = BTreeMap::new();
        let Some(entry) = self.state.submaps.get(&id) else { return neighbours };
        let mut visitors: BTreeMap<NodeId, f64> = BTreeMap::new();
        for c in &self.state.constraints {
            let strength = || self.summaries.get(&(c.submap_id, c.node_id)).copied().unwrap_or(1.0);
            if c.submap_id != id && entry.node_ids.contains(&c.node_id) {
                *neighbours.entry(c.submap_id).or_default() += strength();
            } else if c.submap_id == id && !entry.node_ids.contains(&c.node_id) {
                *visitors.entry(c.node_id).or_default() += strength();
            }
        }
        for (node_id, strength) in visitors {
            let of_node = self.state.submaps.iter().find(|(_, s)| s.node_ids.contains(&node_id));
            if let Some((submap_id, _)) = of_node {
                *neighbours.entry(*submap_id).or_default() += strength;
            }
        }
        neighbours
    }

    /// Ties one submap to the middle node of another, or strengthens that tie.
    fn add_summary(&mut self, submap_id: SubmapId, other: SubmapId, strength: f64) {
        let nodes = self.state.submaps.get(&other).map(|entry| &entry.node_ids);
        let Some(node_id) = nodes.and_then(|nodes| nodes.iter().nth(nodes.len() / 2).copied()) else {
            return;
        };
        let Some(submap_from_node) = self.problem.submap_from_node(submap_id, node_id) else { return };
        let known = self.summaries.entry((submap_id, node_id)).or_insert(0.0);
        let is_new = *known == 0.0;
        *known = (*known + strength).min(STRONGEST);
        // Information adds up; weights are its square root.
        let factor = known.sqrt();
        let tie = self.loop_closure(submap_id, node_id, submap_from_node);
        let tie = Constraint {
            translation_weight: factor * tie.translation_weight,
            rotation_weight: factor * tie.rotation_weight,
            ..tie
        };
        if is_new {
            self.load_constraint(tie);
            return;
        }
        let is_it = |c: &&mut Constraint| c.submap_id == submap_id && c.node_id == node_id && is_summary(c);
        if let Some(constraint) = self.state.constraints.iter_mut().find(is_it) {
            *constraint = tie;
        }
    }

    /// Forgets ties one end of which was removed.
    pub(super) fn forget_summaries(&mut self) {
        let state = &self.state;
        self.summaries
            .retain(|(submap, node), _| state.submaps.contains_key(submap) && state.nodes.contains_key(node));
    }
}

fn is_summary(constraint: &Constraint) -> bool {
    constraint.is_loop_closure() && constraint.score.is_none()
}
