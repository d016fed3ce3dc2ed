//! Nodes whose scans do not constrain their position along a corridor.
//!
//! A direction that is degenerate in the very submap that the scan was inserted into is degenerate in others,
//! too: however far along the corridor such a node is searched, the pose found is one of many. Its loop
//! closures constrain the heading and the distance from the walls, which drift less than the position.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::PoseGraph;
use super::travel::{Lengths, TravelGraph};
use crate::{NodeId, Space, SubmapId};

/// Whether nodes have a degenerate direction, for those that were tested.
#[derive(Clone, Debug, Default)]
pub(super) struct OpenNodes {
    known: BTreeMap<NodeId, bool>,
}

impl OpenNodes {
    /// Whether a node is known to have a degenerate direction.
    pub fn contains(&self, node_id: NodeId) -> bool {
        self.known.get(&node_id) == Some(&true)
    }

    /// Forgets a node.
    pub fn forget(&mut self, node_id: NodeId) {
        self.known.remove(&node_id);
    }
}

impl<S: Space> PoseGraph<S> {
    /// Graph of the path lengths in the present map, for searching the waiting pairs.
    pub(super) fn travel_graph(&mut self) -> TravelGraph {
        let mut travel = TravelGraph::new(&self.state, &self.path_lengths);
        if self.policy.loops.drift > 0.0 {
            let drifting = drifting_nodes(&travel, self.search.waiting_pairs());
            self.ask_nodes(&drifting, &travel);
            travel.open_nodes = drifting.into_iter().filter(|id| self.open_nodes.contains(*id)).collect();
        }
        travel
    }

    /// Tests nodes whose first submap is finished for degenerate directions.
    fn ask_nodes(&mut self, nodes: &BTreeSet<NodeId>, travel: &TravelGraph) {
        let unknown: Vec<NodeId> =
            nodes.iter().copied().filter(|id| !self.open_nodes.known.contains_key(id)).collect();
        let ask = |node_id: &NodeId| {
            let entry = self.state.submaps.get(&travel.submap_of(*node_id)?)?;
            let local_from_node = self.problem.nodes.get(node_id)?.local_from_node;
            let submap_from_node = entry.local_from_submap.inverse() * local_from_node;
            let data = &self.state.nodes.get(node_id)?.data;
            Some((*node_id, S::leaves_open(entry.submap.as_ref()?, data, &submap_from_node)))
        };
        let answers: Vec<(NodeId, bool)> = unknown.par_iter().filter_map(ask).collect();
        self.open_nodes.known.extend(answers);
    }
}

/// The nodes of those pairs whose position has drifted over a longer path than their heading.
fn drifting_nodes(travel: &TravelGraph, pairs: impl Iterator<Item = (SubmapId, NodeId)>) -> BTreeSet<NodeId> {
    let mut known: BTreeMap<SubmapId, Lengths> = BTreeMap::new();
    let drifts = |(submap_id, node_id): &(SubmapId, NodeId)| {
        travel.submap_of(*node_id).is_some_and(|of_node| {
            let lengths = known.entry(of_node).or_insert_with(|| travel.lengths_from(of_node));
            lengths.of_place(*submap_id) != lengths.of_heading(*submap_id)
        })
    };
    let pairs = pairs.filter(|_| travel.has_open_ties());
    pairs.filter(drifts).map(|(_, node_id)| node_id).collect()
}
