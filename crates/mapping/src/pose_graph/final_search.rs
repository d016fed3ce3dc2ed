//! Searching once more at the end of a short recording.
//!
//! While mapping, a fraction of the pairs of nodes and submaps is tried (`sampling_ratio`), small enough for
//! long recordings. A short one leaves only a handful of loop closures that way, and its walls stay
//! double where its two or three rounds disagree.

use portolan_sensor::FixedRatioSampler;

use super::PoseGraph;
use crate::{NodeId, Space, SubmapId};

impl<S: Space> PoseGraph<S> {
    /// Schedules further pairs, evenly over all that are near enough and have no loop closure yet, until
    /// as many as wanted have been tried.
    pub(super) fn search_more(&mut self) {
        let missing = self.policy.min_searches.saturating_sub(self.search.counts().window_searched);
        if missing == 0 {
            return;
        }
        let pairs = self.untied_pairs();
        let share = (missing as f64 / pairs.len().max(1) as f64).min(1.0);
        let Ok(mut sampler) = FixedRatioSampler::new(share) else { return };
        for (submap_id, node_id) in pairs.into_iter().filter(|_| sampler.pulse()) {
            let (Some(entry), Some(node)) =
                (self.state.submaps.get(&submap_id), self.state.nodes.get(&node_id))
            else {
                continue;
            };
            let Some(submap) = &entry.submap else { continue };
            let guess =
                self.problem.submaps[&submap_id].inverse() * self.problem.nodes[&node_id].map_from_node;
            self.search.add_unsampled((submap_id, submap), (node_id, &node.data), guess);
        }
    }

    /// Pairs of connected trajectories, near each other, that no constraint relates.
    fn untied_pairs(&self) -> Vec<(SubmapId, NodeId)> {
        let tied: std::collections::BTreeSet<(SubmapId, NodeId)> =
            self.state.constraints.iter().map(|c| (c.submap_id, c.node_id)).collect();
        let finished = self.state.submaps.iter().filter(|(_, s)| s.insertion_finished && s.submap.is_some());
        let near = |submap_id: &SubmapId, node_id: &NodeId| {
            let (Some(submap), Some(node)) =
                (self.problem.submaps.get(submap_id), self.problem.nodes.get(node_id))
            else {
                return false;
            };
            let offset = submap.translation.vector - node.map_from_node.translation.vector;
            offset.norm() <= self.options.constraint_builder.max_constraint_distance
        };
        finished
            .flat_map(|(submap_id, _)| self.state.nodes.keys().map(move |node_id| (*submap_id, *node_id)))
            .filter(|pair| !tied.contains(pair) && !self.both_frozen(pair.1, pair.0))
            .filter(|(s, n)| self.state.connectivity.are_connected(s.trajectory_id, n.trajectory_id))
            .filter(|(s, n)| near(s, n))
            .collect()
    }
}
