//! Decides which submaps are near enough to a node for the node to be searched in them.

use portolan_geometry::Vector3;

use super::PoseGraph;
use crate::{NodeId, Space, SubmapEntry, SubmapId};

impl<S: Space> PoseGraph<S> {
    /// Whether a node at offset `from_origin` from the origin of a submap (metres, in the frame of either) is
    /// within `max_constraint_distance` plus `more`, metres. A car makes submaps that are a hundred metres
    /// long: if the policy says so, the distance is measured from the nodes of the submap.
    pub(super) fn is_in_reach(
        &self,
        (submap_id, entry): (SubmapId, &SubmapEntry<S>),
        node_id: NodeId,
        from_origin: &Vector3,
        more: f64,
    ) -> bool {
        let farthest = self.options.constraint_builder.max_constraint_distance + more;
        let distance = from_origin.norm();
        if distance <= farthest || !self.policy.loops.is_from_nodes {
            return distance <= farthest;
        }
        if distance - self.extents.get(&submap_id).copied().unwrap_or(f64::INFINITY) > farthest {
            return false;
        }
        let place = |id: &NodeId| Some(self.problem.nodes.get(id)?.map_from_node.translation.vector);
        let Some(here) = place(&node_id) else { return false };
        entry.node_ids.iter().filter_map(place).any(|other| (other - here).norm() <= farthest)
    }

    /// Stores the extent of a complete submap.
    pub(super) fn note_extent(&mut self, id: SubmapId) {
        let Some(entry) = self.state.submaps.get(&id) else { return };
        let origin = entry.local_from_submap.translation.vector;
        let nodes = entry.node_ids.iter().filter_map(|id| self.state.nodes.get(id));
        let places = nodes.map(|node| node.data.local_from_tracking.translation.vector);
        let extent = places.map(|place| (place - origin).norm()).fold(0.0, f64::max);
        self.extents.insert(id, extent);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use portolan_config::Options;
    use portolan_geometry::{Rigid3, Time};

    use super::*;
    use crate::made_rooms::{node, submap};
    use crate::{InsertedNode, InsertionSubmap, NodeData, Space2d, TrajectoryId};

    /// Whether a node at this distance, metres, is in reach of a submap whose nodes are along 100 m.
    fn reaches(is_from_nodes: bool, x: f64) -> bool {
        let mut graph = PoseGraph::<Space2d>::new(Options::for_2d().map_builder.pose_graph);
        graph.policy.loops.is_from_nodes = is_from_nodes;
        let id = TrajectoryId(0);
        graph.add_trajectory(id, None);
        let finished = Arc::new(submap((9.0, 7.0)));
        let mut add = |i: u32, x: f64, index: u32, finished| {
            let data = NodeData {
                time: Time::from_unix_seconds(f64::from(i)),
                local_from_tracking: Rigid3::translation(x, 0.0, 0.0),
                ..node((9.0, 7.0), (0.0, 0.0))
            };
            let submaps = vec![InsertionSubmap { index, local_from_submap: Rigid3::identity(), finished }];
            graph.add_node(id, InsertedNode::new(Arc::new(data), submaps))
        };
        for i in 0..10 {
            add(i, 10.0 * f64::from(i), 0, None);
        }
        add(10, 100.0, 0, Some(finished));
        let last = add(11, x, 1, None);
        let submap_id = SubmapId::new(id, 0);
        let entry = graph.state.submaps.get(&submap_id).unwrap();
        graph.is_in_reach((submap_id, entry), last, &Vector3::new(x, 0.0, 0.0), 0.0)
    }

    #[test]
    fn the_reach_of_a_long_submap_includes_its_nodes() {
        assert!(reaches(true, 14.0) && reaches(true, 50.0) && reaches(true, 114.0));
        assert!(!reaches(true, 116.0) && !reaches(true, -16.0));
        assert!(reaches(false, 14.0) && !reaches(false, 50.0));
    }
}
