//! Searches for more loop closures at the end.
//!
//! While mapping, a fraction of the pairs of nodes and submaps is searched (`sampling_ratio`), small enough
//! for long recordings. In a short recording that leaves only a handful of loop closures, and walls stay
//! double where its two or three passes disagree.
//!
//! And a pair is searched around its relative pose at the time of the search. Later loop closures change it:
//! places that are beside each other in the optimised map, with a long path between them, are searched again
//! there.

use std::collections::BTreeSet;

use portolan_geometry::Vector3;
use portolan_sensor::FixedRatioSampler;

use super::PoseGraph;
use super::policy::{LoopSearchPolicy, Spacing};
use super::travel::{Lengths, TravelGraph};
use crate::{MatchAcceptance, NodeId, Space, SubmapId};

/// Maximum number of rounds of searching the optimised map; each further round requires that the one before
/// found something.
const MOST_ROUNDS: usize = 3;
/// Maximum number of pairs searched in a round, as a fraction of those searched while mapping.
const SHARE_OF_SEARCHES: f64 = 0.1;
/// Minimum path length between places that are searched again, metres: over less, more loop closures add
/// little.
const LONG_PATH: f64 = 50.0;
/// Factor on the minimum explained fraction of a scan at a known place in 2D. A scan taken in the other
/// direction sees sides of things that the submap does not know, which is no contradiction. A loop closure
/// that would bend the map still needs three nodes that agree.
const EXPLAINED_OF_USUAL: f32 = 0.65;

impl<S: Space> PoseGraph<S> {
    /// Schedules further pairs, evenly over all that are near enough and have no loop closure yet, until
    /// `min_searches` of the policy is reached.
    pub(super) fn search_more(&mut self) {
        let missing = self.policy.min_searches.saturating_sub(self.search.counts().window_searched);
        if missing > 0 && !self.stop.is_requested() {
            self.schedule(self.untied_pairs(), missing as f64);
        }
    }

    /// Searches the optimised map for loop closures that were missed at earlier, less accurate poses, and
    /// optimises with them, until no more are found.
    pub(super) fn search_missed(&mut self) {
        if !self.searches_whole_maps() {
            return;
        }
        let most = SHARE_OF_SEARCHES * self.search.counts().window_searched as f64;
        for _ in 0..MOST_ROUNDS {
            if self.stop.is_requested() {
                return;
            }
            let travel = TravelGraph::new(&self.state, &self.path_lengths);
            let loops = self.loop_search();
            self.search
                .set_policy(LoopSearchPolicy { acceptance: self.acceptance_of_known_place(), ..loops });
            self.schedule(self.distant_neighbours(&travel), most);
            self.search.set_policy(loops);
            let before = self.state.constraints.len();
            let travel = self.travel_graph();
            let found = self.search.run(&travel, &self.remembered);
            self.add_found(found);
            if self.state.constraints.len() == before {
                return;
            }
            self.run_optimization();
        }
    }

    /// Acceptance criteria for a match at the pose that the node has in the map.
    pub(super) fn acceptance_of_known_place(&self) -> MatchAcceptance {
        let usual = self.loop_search().acceptance;
        MatchAcceptance { min_explained: EXPLAINED_OF_USUAL * usual.min_explained, ..usual }
    }

    /// Untied pairs that are beside each other, with a long path between them; of each submap and trajectory
    /// one in `spacing` metres of path.
    fn distant_neighbours(&self, travel: &TravelGraph) -> Vec<(SubmapId, NodeId)> {
        let (mut spacing, mut lengths) = (Spacing::default(), Lengths::default());
        let mut of_submap: Option<SubmapId> = None;
        let mut pairs = self.untied_pairs();
        pairs.retain(|pair| {
            let (submap_id, node_id) = *pair;
            if of_submap.replace(submap_id) != Some(submap_id) {
                (spacing, lengths) = (Spacing::default(), travel.lengths_from(submap_id));
            }
            let length = travel.submap_of(node_id).and_then(|of_node| lengths.of_place(of_node));
            let path_length = self.path_lengths.get(&node_id).copied().unwrap_or(0.0);
            length.is_some_and(|length| length >= LONG_PATH)
                && spacing.is_due(*pair, path_length, self.policy.loops.spacing)
        });
        pairs
    }

    /// Schedules at most `most` pairs, evenly sampled.
    fn schedule(&mut self, pairs: Vec<(SubmapId, NodeId)>, most: f64) {
        let share = (most / pairs.len().max(1) as f64).min(1.0);
        let Ok(mut sampler) = FixedRatioSampler::new(share) else { return };
        for (submap_id, node_id) in pairs.into_iter().filter(|_| sampler.pulse()) {
            let Some((submap, node)) = self.state.pair(submap_id, node_id) else { continue };
            let Some(guess) = self.problem.submap_from_node(submap_id, node_id) else { continue };
            self.search.add_unsampled(submap, node, guess);
        }
    }

    /// Pairs that a constraint relates.
    pub(super) fn tied_pairs(&self) -> BTreeSet<(SubmapId, NodeId)> {
        self.state.constraints.iter().map(|c| (c.submap_id, c.node_id)).collect()
    }

    /// Pairs of connected trajectories, near each other, that no constraint relates.
    fn untied_pairs(&self) -> Vec<(SubmapId, NodeId)> {
        let tied = self.tied_pairs();
        let nodes: Vec<(NodeId, Vector3)> = self
            .problem
            .nodes
            .iter()
            .map(|(id, node)| (*id, node.map_from_node.translation.vector))
            .collect();
        let finished = self.state.submaps.iter().filter(|(_, s)| s.insertion_finished && s.submap.is_some());
        let near = finished
            .filter_map(|(id, entry)| Some(((*id, entry), self.problem.submaps.get(id)?)))
            .flat_map(|(submap, map_from_submap)| {
                let place = map_from_submap.translation.vector;
                let near = nodes
                    .iter()
                    .filter(move |(id, node)| self.is_in_reach(submap, *id, &(node - place), 0.0));
                near.map(move |(node_id, _)| (submap.0, *node_id))
            });
        near.filter(|pair| !tied.contains(pair) && !self.both_frozen(pair.1, pair.0))
            .filter(|(s, n)| self.state.connectivity.are_connected(s.trajectory_id, n.trajectory_id))
            .collect()
    }
}
