//! Merges maps: searches loaded trajectories in other loaded trajectories.

use std::collections::BTreeSet;

use portolan_sensor::FixedRatioSampler;

use super::PoseGraph;
use super::policy::{GOLDEN, LoopSearchPolicy};
use crate::{NodeId, Space, SubmapId, TrajectoryId, of_trajectory};

/// Number of nodes of a trajectory that are searched in whole submaps before the matches are checked for
/// agreement.
const NODES_A_ROUND: usize = 8;
/// Maximum number of nodes of a trajectory that are searched in whole submaps.
const MOST_NODES: usize = 64;
/// Number of nodes, evenly spread, after which a piece is given up if none was found, where whole maps are
/// searched. Assumed: a piece is worth connecting if at least a quarter of it is in the rest, and a node
/// there is found at least every second time. Then all nodes miss by chance in 4 of 100 such pieces, (1 −
/// 1/8)^24; in 1 of 1000 if half of the piece is in the rest.
const MAX_UNMATCHED_NODES: usize = 24;
/// Maximum number of pairs that are matched around their guess in a round, once a trajectory has its place.
const MOST_PAIRS: usize = 3000;
/// Maximum number of such rounds.
const MOST_ROUNDS: usize = 6;
/// Minimum distance between nodes along the trajectory, metres; nodes closer together are redundant.
const LEAST_SPACING: f64 = 1.0;

impl<S: Space> PoseGraph<S> {
    /// Searches each of these trajectories in the rest of the graph, moves it to the pose on which matches
    /// agree, closes loops in both directions, and optimises. Returns the trajectories that were not found;
    /// if there are any, nothing is optimised.
    pub fn join(&mut self, joining: &BTreeSet<TrajectoryId>) -> BTreeSet<TrajectoryId> {
        let all: Vec<TrajectoryId> = self.state.trajectories.keys().copied().collect();
        all.into_iter().for_each(|id| self.measure_path_lengths(id));
        self.places.save_without_limit();
        for id in joining {
            self.place(*id, joining);
        }
        let lost: BTreeSet<TrajectoryId> =
            joining.iter().copied().filter(|id| !self.is_joined(*id, joining)).collect();
        if lost.is_empty() {
            self.close_loops_with(joining);
            self.placed_parts.clear();
            self.run_final_optimization();
        }
        lost
    }

    /// Searches pieces of map, and recordings, that are not connected with the rest yet, with scans from all
    /// over each. The largest comes first. Searching ends when the budget for searches is used up.
    pub(super) fn place_pieces(&mut self) {
        let mut looked_for = self.pieces.clone();
        looked_for.extend(self.places.looked_for());
        self.places.save_for(self.state.nodes.len());
        let size = |id: &TrajectoryId| of_trajectory(&self.state.nodes, *id).count();
        let mut by_size: Vec<(usize, TrajectoryId)> = looked_for.iter().map(|id| (size(id), *id)).collect();
        by_size.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
        for (_, id) in by_size {
            let part: BTreeSet<TrajectoryId> = self.state.connectivity.members(id).into_iter().collect();
            let is_placed = part.iter().any(|member| !looked_for.contains(member));
            if !is_placed
                && !self.stop.is_requested()
                && of_trajectory(&self.state.nodes, id).next().is_some()
            {
                self.place(id, &part);
            }
        }
        // Pairs that only became neighbours when parts were connected have not been searched yet.
        let placed = std::mem::take(&mut self.placed_parts);
        if !placed.is_empty() {
            self.close_loops_with(&placed);
        }
    }

    /// Computes the distance of nodes along their trajectory: files do not keep it.
    fn measure_path_lengths(&mut self, id: TrajectoryId) {
        let mut path_length = 0.0;
        let mut before: Option<portolan_geometry::Rigid3> = None;
        for (node_id, node) in of_trajectory(&self.state.nodes, id) {
            let pose = node.data.local_from_tracking;
            path_length += before.map_or(0.0, |b| super::insertion::step_length(&(b.inverse() * pose)));
            self.path_lengths.insert(node_id, path_length);
            before = Some(pose);
        }
    }

    pub(super) fn is_joined(&self, id: TrajectoryId, joining: &BTreeSet<TrajectoryId>) -> bool {
        let members = self.state.connectivity.members(id);
        members.iter().any(|member| !joining.contains(member))
    }

    /// Searches nodes of a trajectory, spread over all of it, in whole submaps of the rest until enough
    /// matches agree.
    pub(super) fn place(&mut self, id: TrajectoryId, joining: &BTreeSet<TrajectoryId>) {
        let nodes: Vec<NodeId> = of_trajectory(&self.state.nodes, id).map(|(id, _)| id).collect();
        let mut seen = BTreeSet::new();
        let spread = (0..MOST_NODES)
            .map(|i| ((i as f64 * GOLDEN).fract() * nodes.len() as f64) as usize)
            .filter(|i| seen.insert(*i))
            .filter_map(|i| nodes.get(i).copied());
        let spread: Vec<NodeId> = spread.collect();
        let parts = self.searched_parts(joining);
        let mut is_found = false;
        for (i, round) in spread.chunks(NODES_A_ROUND).enumerate() {
            let is_given_up = !parts.is_empty() && !is_found && i * NODES_A_ROUND >= MAX_UNMATCHED_NODES;
            let may_search = self.places.may_search() && !self.stop.is_requested();
            if self.is_joined(id, joining) || is_given_up || !may_search {
                return;
            }
            if !parts.is_empty() {
                let most_lookups = self.places.most_lookups_of_round();
                let lookups = self.add_proposed(round, &parts, most_lookups);
                self.places.spend(lookups);
            } else {
                self.add_everywhere(round, joining);
            }
            let found = self.search.run_unplaced(&self.remembered);
            is_found |= !found.is_empty();
            self.add_found(found);
        }
    }

    /// Schedules the search for nodes in each submap of the rest.
    fn add_everywhere(&mut self, node_ids: &[NodeId], joining: &BTreeSet<TrajectoryId>) {
        for (submap_id, node_id) in self.pairs(node_ids, |id| !joining.contains(&id)) {
            if let Some((submap, node)) = self.state.pair(submap_id, node_id) {
                self.search.add_anywhere(submap, node);
            }
        }
    }

    /// All pairs of these nodes and the complete submaps of some trajectories.
    fn pairs(&self, nodes: &[NodeId], of: impl Fn(TrajectoryId) -> bool) -> Vec<(SubmapId, NodeId)> {
        let submaps = self.state.submaps.iter();
        let complete =
            submaps.filter(|(id, s)| s.insertion_finished && s.submap.is_some() && of(id.trajectory_id));
        complete.flat_map(|(submap_id, _)| nodes.iter().map(|node_id| (*submap_id, *node_id))).collect()
    }

    /// Closes loops of these trajectories with all others: optimises, searches pairs that are near each other
    /// then, and repeats as long as that finds more. Far from their first constraint the trajectories are off
    /// by the drift of both, and come within reach step by step.
    pub(super) fn close_loops_with(&mut self, joining: &BTreeSet<TrajectoryId>) {
        for _ in 0..MOST_ROUNDS {
            if self.stop.is_requested() {
                return;
            }
            self.run_optimization();
            let before = self.state.constraints.len();
            self.try_pairs_with(joining);
            if self.state.constraints.len() == before {
                return;
            }
        }
    }

    /// Matches pairs of a node of one side and a submap of the other that are near each other now.
    fn try_pairs_with(&mut self, joining: &BTreeSet<TrajectoryId>) {
        let tied = self.tied_pairs();
        let (new, old): (Vec<NodeId>, Vec<NodeId>) =
            self.spaced_nodes().into_iter().partition(|id| joining.contains(&id.trajectory_id));
        let mut pairs = self.pairs(&new, |id| !joining.contains(&id));
        pairs.extend(self.pairs(&old, |id| joining.contains(&id)));
        let untied = pairs.into_iter().filter(|pair| !tied.contains(pair));
        let with_guess = untied.filter_map(|(submap_id, node_id)| {
            let map_from_submap = self.problem.submaps.get(&submap_id)?;
            let guess = map_from_submap.inverse() * self.problem.nodes.get(&node_id)?.map_from_node;
            let entry = self.state.submaps.get(&submap_id)?;
            let off = guess.translation.vector;
            self.is_in_reach((submap_id, entry), node_id, &off, 0.0).then_some((submap_id, node_id, guess))
        });
        let near: Vec<_> = with_guess.collect();
        let share = (MOST_PAIRS as f64 / near.len().max(1) as f64).min(1.0);
        let Ok(mut sampler) = FixedRatioSampler::new(share) else { return };
        // Every pair constrains the relative pose of the two sides, however short the path over other
        // constraints is.
        self.search.set_policy(LoopSearchPolicy { spacing: 0.0, ..self.loop_search() });
        for (submap_id, node_id, guess) in near.into_iter().filter(|_| sampler.pulse()) {
            if let Some((submap, node)) = self.state.pair(submap_id, node_id) {
                self.search.add_unsampled(submap, node, guess);
            }
        }
        let travel = self.travel_graph();
        let found = self.search.run(&travel, &self.remembered);
        self.search.set_policy(self.loop_search());
        self.add_found(found);
    }

    /// Nodes at least a minimum distance along the trajectory from the one before.
    fn spaced_nodes(&self) -> Vec<NodeId> {
        let spacing = self.policy.loops.spacing.max(LEAST_SPACING);
        let mut last: Option<(TrajectoryId, f64)> = None;
        let path_lengths = self.path_lengths.iter().filter(|(id, path_length)| {
            let is_due = last.is_none_or(|(trajectory, at)| {
                trajectory != id.trajectory_id || **path_length - at >= spacing
            });
            if is_due {
                last = Some((id.trajectory_id, **path_length));
            }
            is_due
        });
        path_lengths.map(|(id, _)| *id).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use portolan_config::Options;
    use portolan_geometry::{Rigid3, Time};

    use super::*;
    use crate::made_rooms::{node, submap};
    use crate::{InsertedNode, InsertionSubmap, NodeData, PoseGraphPolicy, Space2d};

    const ROOM: (f32, f32) = (9.0, 7.0);

    /// A graph of `pieces` unconnected pieces, each of which saw the same room.
    fn lost_again_and_again(pieces: u32) -> PoseGraph<Space2d> {
        let options = Options::for_2d();
        let mut graph = PoseGraph::<Space2d>::new(options.map_builder.pose_graph.clone());
        graph.set_policy(PoseGraphPolicy::new(&options.portolan));
        graph.add_trajectory(TrajectoryId(0), None);
        let finished = Arc::new(submap(ROOM));
        for id in (0..pieces).map(TrajectoryId) {
            if let Some(before) = id.0.checked_sub(1).map(TrajectoryId) {
                graph.begin_piece(before, Vec::new(), id, &Rigid3::identity(), None);
            }
            let data = NodeData { time: Time::from_unix_seconds(f64::from(id.0)), ..node(ROOM, (0.5, 0.2)) };
            let finished = Some(Arc::clone(&finished));
            let submaps = vec![InsertionSubmap { index: 0, local_from_submap: Rigid3::identity(), finished }];
            graph.add_node(id, InsertedNode::new(Arc::new(data), submaps));
        }
        graph
    }

    #[test]
    fn repeated_loss_of_tracking_searches_a_bounded_number_of_parts() {
        let graph = lost_again_and_again(20);
        assert_eq!(graph.state().connectivity.components().len(), 20);
        assert_eq!(graph.searched_parts(&BTreeSet::new()).len(), 8);
        let few = lost_again_and_again(3);
        assert_eq!(few.searched_parts(&BTreeSet::from([TrajectoryId(0)])).len(), 2);
    }

    #[test]
    fn no_search_after_a_stop_request() {
        let searched = |is_wanted: bool| {
            let mut graph = lost_again_and_again(3);
            if is_wanted {
                graph.stop().request();
            }
            let before = graph.optimizations().0;
            graph.run_final_optimization();
            assert!(graph.optimizations().0 > before);
            let counts = graph.search_counts();
            counts.whole_submap_searched + counts.window_searched
        };
        assert!(searched(false) > 0);
        assert_eq!(searched(true), 0);
    }
}
