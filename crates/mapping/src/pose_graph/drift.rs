//! Estimates the drift of a finished map where neither scans nor loop closures constrain the motion.
//!
//! In degenerate directions of scans, odometry or constant velocity determines the motion, and its errors
//! accumulate. A loop closure removes them. So the uncertainty of a place relative to the first one is the
//! smallest variance accumulated over any path between them: over the trajectory, over gaps and over loop
//! closures.

use super::PoseGraph;
use super::shortest_paths::shortest_paths;
use crate::{Constraint, NodeId, Space, of_trajectory};

/// Standard deviation of the most uncertain place relative to the first place that it is tied to, from the
/// motion that scans did not constrain.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drift {
    /// Metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
}

/// Standard deviations above which places of the map count as unknown, metres and radians.
const LARGE: Drift = Drift { translation: 1.0, rotation: 0.175 };

impl Drift {
    /// Whether parts of the map are only where odometry or a guess put them, and may as well be elsewhere.
    pub fn is_large(&self) -> bool {
        self.translation > LARGE.translation || self.rotation > LARGE.rotation
    }
}

impl<S: Space> PoseGraph<S> {
    /// Drift of the map where only odometry, or nothing, measured the motion (2D); known after the final
    /// optimisation.
    pub fn drift(&self) -> Drift {
        self.drift
    }

    pub(super) fn judge_drift(&self) -> Drift {
        let graph = self.drift_graph();
        Drift { translation: graph.farthest(|e| e.translation), rotation: graph.farthest(|e| e.rotation) }
    }

    fn drift_graph(&self) -> DriftGraph {
        let ids: Vec<NodeId> = self.state.nodes.keys().copied().collect();
        let gathered = |id: &NodeId| self.gathered.get(id).copied().unwrap_or_default();
        let mut graph = DriftGraph::new(ids.len());
        for (i, pair) in ids.windows(2).enumerate() {
            let [a, b] = pair else { continue };
            if a.trajectory_id == b.trajectory_id {
                let (from, to) = (gathered(a), gathered(b));
                let since = |to: f64, from: f64| (to - from).max(0.0);
                graph.add(
                    i,
                    i + 1,
                    since(to.translation, from.translation),
                    since(to.rotation, from.rotation),
                );
            }
        }
        let index_of = |id: &NodeId| ids.binary_search(id).ok();
        for (id, entry) in &self.state.trajectories {
            let Some(gap) = entry.after_gap else { continue };
            let last = of_trajectory(&self.state.nodes, gap.before).next_back();
            let first = of_trajectory(&self.state.nodes, *id).next();
            let is_trusted = !gap.bridge.is_contradicted || self.has_odometry_tie(*id);
            if let Some(((last, _), (first, _))) = last.zip(first).filter(|_| is_trusted)
                && let Some((a, b)) = index_of(&last).zip(index_of(&first))
            {
                graph.add(a, b, gap.bridge.translation.powi(2), gap.bridge.rotation.powi(2));
            }
        }
        for constraint in self.state.constraints.iter().filter(|c| c.is_loop_closure()) {
            let nearest = self.nearest_of_submap(constraint).filter(|_| !self.is_tie_over_gap(constraint));
            if let Some((a, b)) = nearest.and_then(|id| index_of(&id)).zip(index_of(&constraint.node_id)) {
                // One with a degenerate direction constrains headings, but not positions.
                let translation = if constraint.open.is_some() { f64::INFINITY } else { 0.0 };
                graph.add(a, b, translation, 0.0);
            }
        }
        graph
    }

    fn is_tie_over_gap(&self, constraint: &Constraint) -> bool {
        let id = constraint.node_id.trajectory_id;
        let gap = self.state.trajectories.get(&id).and_then(|entry| entry.after_gap);
        let is_first =
            || of_trajectory(&self.state.nodes, id).next().is_some_and(|(n, _)| n == constraint.node_id);
        let is_before = gap.is_some_and(|gap| gap.before == constraint.submap_id.trajectory_id);
        self.has_odometry_tie(id) && is_before && is_first()
    }

    /// The node of a submap that is nearest to the node of a loop closure.
    fn nearest_of_submap(&self, constraint: &Constraint) -> Option<NodeId> {
        let at = |id: &NodeId| Some(self.problem.nodes.get(id)?.map_from_node.translation.vector);
        let found = at(&constraint.node_id)?;
        let nodes = &self.state.submaps.get(&constraint.submap_id)?.node_ids;
        let distance = |id: &NodeId| Some(((at(id)? - found).norm_squared(), *id));
        let nearest =
            nodes.iter().filter_map(distance).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        nearest.map(|(_, id)| id)
    }
}

/// Variances of the relative pose of two nodes.
#[derive(Clone, Copy, Debug)]
struct Edge {
    to: usize,
    /// Metres².
    translation: f64,
    /// Radians².
    rotation: f64,
}

/// Graph of paths between nodes, which are numbered from zero.
struct DriftGraph {
    from: Vec<Vec<Edge>>,
}

impl DriftGraph {
    fn new(nodes: usize) -> Self {
        Self { from: vec![Vec::new(); nodes] }
    }

    fn add(&mut self, a: usize, b: usize, translation: f64, rotation: f64) {
        for (from, to) in [(a, b), (b, a)] {
            if let Some(edges) = self.from.get_mut(from) {
                edges.push(Edge { to, translation, rotation });
            }
        }
    }

    /// Largest standard deviation of a node relative to the first node that it is tied to, over the paths
    /// with the least variance.
    fn farthest(&self, variance: impl Fn(&Edge) -> f64) -> f64 {
        let mut is_reached = vec![false; self.from.len()];
        let mut farthest: f64 = 0.0;
        for start in 0..self.from.len() {
            if is_reached.get(start) == Some(&true) {
                continue;
            }
            let edges =
                |at: usize| self.from.get(at).into_iter().flatten().map(|edge| (edge.to, variance(edge)));
            for (at, variance) in shortest_paths(start, f64::MAX, edges) {
                farthest = farthest.max(variance);
                is_reached.get_mut(at).into_iter().for_each(|reached| *reached = true);
            }
        }
        farthest.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loop_closures_reduce_drift() {
        let mut graph = DriftGraph::new(6);
        for i in 0..4 {
            graph.add(i, i + 1, 0.04, 0.0001);
        }
        let metres = |graph: &DriftGraph| graph.farthest(|edge| edge.translation);
        let radians = |graph: &DriftGraph| graph.farthest(|edge| edge.rotation);
        assert!((metres(&graph) - 0.4).abs() < 1e-12 && (radians(&graph) - 0.02).abs() < 1e-12);
        graph.add(0, 4, f64::INFINITY, 0.0);
        assert!((metres(&graph) - 0.4).abs() < 1e-12, "such a loop closure does not constrain the position");
        assert!((radians(&graph) - 0.0002_f64.sqrt()).abs() < 1e-12);
        graph.add(0, 4, 0.0, 0.0);
        assert!((metres(&graph) - 0.08_f64.sqrt()).abs() < 1e-12);
    }
}
