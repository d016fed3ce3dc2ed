//! Computes the odometric path length between a node and a submap.
//!
//! The relative error of two places grows with the path between them, and is reset where a loop is closed. So
//! the length of the shortest path over the trajectory and over loop closures determines the search window of
//! a node.

use std::collections::{BTreeMap, BTreeSet};

use crate::{NodeId, Space, SubmapId, of_trajectory};

use super::shortest_paths::shortest_paths;
use super::state::GraphState;

/// Path length that a loop closure counts as, metres: it is no more accurate than that much of a trajectory.
const LENGTH_OF_LOOP_CLOSURE: f64 = 2.0;

/// Submaps and the paths between neighbouring ones, metres.
#[derive(Clone, Debug, Default)]
pub(super) struct TravelGraph {
    neighbours: Neighbours,
    /// Loop closures with a degenerate direction; they constrain headings, but not positions.
    open: Neighbours,
    /// Nodes whose scans do not constrain their position along a corridor.
    pub open_nodes: BTreeSet<NodeId>,
    /// The first submap that each node was inserted into.
    submap_of_node: BTreeMap<NodeId, SubmapId>,
}

impl TravelGraph {
    /// The paths in the present map: from each submap to the next of its trajectory, and over loop closures.
    /// `path_lengths` are the distances of nodes along their trajectories, metres: where submaps between were
    /// dropped, the path was longer than the straight line.
    pub fn new<S: Space>(state: &GraphState<S>, path_lengths: &BTreeMap<NodeId, f64>) -> Self {
        let path_length = |entry: &crate::SubmapEntry<S>| path_lengths.get(entry.node_ids.first()?).copied();
        let mut graph = Self::default();
        let mut previous: Option<(SubmapId, &crate::SubmapEntry<S>)> = None;
        for (id, entry) in &state.submaps {
            for node_id in &entry.node_ids {
                graph.submap_of_node.entry(*node_id).or_insert(*id);
            }
            if let Some((before, known)) = previous.filter(|(b, _)| b.trajectory_id == id.trajectory_id) {
                let [from, to] = [known, entry].map(|e| e.local_from_submap.translation.vector);
                let line = (to - from).norm();
                let between =
                    path_length(entry).zip(path_length(known)).filter(|_| before.index + 1 < id.index);
                graph.connect(before, *id, between.map_or(line, |(to, from)| line.max(to - from)));
            }
            previous = Some((*id, entry));
        }
        for (id, trajectory) in &state.trajectories {
            let Some(gap) = trajectory.after_gap.filter(|gap| !gap.bridge.is_contradicted) else { continue };
            let last = of_trajectory(&state.submaps, gap.before).next_back();
            let first = of_trajectory(&state.submaps, *id).next();
            if let (Some((last, _)), Some((first, _))) = (last, first) {
                graph.connect(last, first, gap.path_length);
            }
        }
        for constraint in state.constraints.iter().filter(|c| c.is_loop_closure()) {
            if let Some(of_node) = graph.submap_of_node.get(&constraint.node_id).copied() {
                match constraint.open {
                    None => graph.connect(of_node, constraint.submap_id, LENGTH_OF_LOOP_CLOSURE),
                    Some(_) => {
                        connect(&mut graph.open, (of_node, constraint.submap_id), LENGTH_OF_LOOP_CLOSURE)
                    }
                }
            }
        }
        graph
    }

    fn connect(&mut self, a: SubmapId, b: SubmapId, length: f64) {
        connect(&mut self.neighbours, (a, b), length);
    }

    /// The first submap that a node was inserted into.
    pub fn submap_of(&self, node_id: NodeId) -> Option<SubmapId> {
        self.submap_of_node.get(&node_id).copied()
    }

    /// Lengths of the shortest paths from one submap to all that can be reached, metres.
    pub fn lengths_from(&self, start: SubmapId) -> Lengths {
        let place = shortest(start, &[&self.neighbours], f64::INFINITY);
        let heading = || shortest(start, &[&self.neighbours, &self.open], f64::INFINITY);
        let heading = (!self.open.is_empty()).then(heading);
        Lengths { place, heading }
    }

    /// Whether any loop closure has a degenerate direction.
    pub fn has_open_ties(&self) -> bool {
        !self.open.is_empty()
    }

    /// Whether the position of a node in a submap is constrained over a path of at most `longest` metres.
    pub fn is_tied(&self, (submap_id, node_id): (SubmapId, NodeId), longest: f64) -> bool {
        let reached = || shortest(submap_id, &[&self.neighbours], longest);
        self.submap_of(node_id).is_some_and(|of_node| reached().contains_key(&of_node))
    }
}

/// Lengths of the shortest paths from a submap to others, metres.
#[derive(Clone, Debug, Default)]
pub(super) struct Lengths {
    place: BTreeMap<SubmapId, f64>,
    /// Also over loop closures with a degenerate direction; none where there are none.
    heading: Option<BTreeMap<SubmapId, f64>>,
}

impl Lengths {
    /// Path length over which the position drifts.
    pub fn of_place(&self, submap_id: SubmapId) -> Option<f64> {
        self.place.get(&submap_id).copied()
    }

    /// Path length over which the heading drifts.
    pub fn of_heading(&self, submap_id: SubmapId) -> Option<f64> {
        self.heading.as_ref().unwrap_or(&self.place).get(&submap_id).copied()
    }
}

/// Neighbouring submaps and the lengths of the paths between them, metres.
type Neighbours = BTreeMap<SubmapId, BTreeMap<SubmapId, f64>>;

fn connect(neighbours: &mut Neighbours, (a, b): (SubmapId, SubmapId), length: f64) {
    let length = if length.is_finite() { length } else { f64::MAX };
    for (from, to) in [(a, b), (b, a)] {
        let known = neighbours.entry(from).or_default().entry(to).or_insert(length);
        *known = known.min(length);
    }
}

/// Lengths of the shortest paths from one submap over the neighbours of all of these, up to `longest`.
fn shortest(start: SubmapId, neighbours: &[&Neighbours], longest: f64) -> BTreeMap<SubmapId, f64> {
    let next_to = |at: SubmapId| neighbours.iter().filter_map(move |n| n.get(&at)).flatten();
    shortest_paths(start, longest, |at| next_to(at).map(|(next, length)| (*next, *length)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TrajectoryId;

    #[test]
    fn loop_closures_shorten_paths() {
        let id = |trajectory: u32, index: u32| SubmapId::new(TrajectoryId(trajectory), index);
        let mut graph = TravelGraph::default();
        for i in 0..10 {
            graph.connect(id(0, i), id(0, i + 1), 5.0);
        }
        graph.connect(id(1, 0), id(1, 1), f64::NAN);
        let lengths = |graph: &TravelGraph, to: SubmapId| {
            let lengths = graph.lengths_from(id(0, 2));
            (lengths.of_place(to), lengths.of_heading(to))
        };
        assert_eq!(lengths(&graph, id(0, 9)), (Some(35.0), Some(35.0)));
        assert_eq!(lengths(&graph, id(1, 0)), (None, None));
        graph.connect(id(0, 0), id(0, 10), LENGTH_OF_LOOP_CLOSURE);
        graph.connect(id(0, 0), id(0, 10), 80.0);
        assert_eq!(lengths(&graph, id(0, 9)), (Some(17.0), Some(17.0)));
        connect(&mut graph.open, (id(0, 2), id(0, 9)), LENGTH_OF_LOOP_CLOSURE);
        assert_eq!(lengths(&graph, id(0, 9)), (Some(17.0), Some(2.0)));
        graph.submap_of_node.insert(NodeId::new(TrajectoryId(0), 90), id(0, 9));
        let is_tied = |longest| graph.is_tied((id(0, 2), NodeId::new(TrajectoryId(0), 90)), longest);
        assert!(is_tied(17.0) && !is_tied(16.9));
        assert_eq!(graph.lengths_from(id(5, 5)).of_place(id(5, 5)), Some(0.0));
    }
}
