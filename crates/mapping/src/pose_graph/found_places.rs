//! Scans of a recording that were found in a known map by something else than the pose graph: what they tie.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Rigid3, Time};

use super::PoseGraph;
use super::extension::{NearestSubmaps, TIE_SPACING};
use super::insertion::step_length;
use crate::{NodeId, Space, SubmapId, TrajectoryId};

/// Where the tracking frame was in a known map when a scan was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundPlace {
    /// When the scan was taken.
    pub time: Time,
    /// In the frame of the pose graph, as the known map lay when it was loaded.
    pub map_from_tracking: Rigid3,
}

/// A node found in a known submap.
struct Tie {
    node_id: NodeId,
    submap_id: SubmapId,
    submap_from_node: Rigid3,
}

impl<S: Space> PoseGraph<S> {
    /// Ties nodes that were found in known submaps, which lay at these poses then, to the nearest of them, one in half a metre of
    /// way. A part of the map that nothing ties to the known ones yet is put there. How many ties there are.
    pub fn tie_found(&mut self, known: &BTreeMap<SubmapId, Rigid3>, places: &[FoundPlace]) -> usize {
        let ties = self.ties_of(known, places);
        for tie in &ties {
            self.put_where_found(tie);
            let constraint = self.loop_closure(tie.submap_id, tie.node_id, tie.submap_from_node);
            self.load_constraint(constraint);
        }
        ties.len()
    }

    fn ties_of(&self, known: &BTreeMap<SubmapId, Rigid3>, places: &[FoundPlace]) -> Vec<Tie> {
        let trajectories: BTreeSet<TrajectoryId> = known.keys().map(|id| id.trajectory_id).collect();
        let new = self.state.nodes.iter().filter(|(id, _)| !trajectories.contains(&id.trajectory_id));
        let by_time: BTreeMap<Time, NodeId> = new.map(|(id, node)| (node.data.time, *id)).collect();
        let nearest = NearestSubmaps::new(self, &known.keys().copied().collect());
        let mut ties = Vec::new();
        let mut last: Option<Rigid3> = None;
        for FoundPlace { time, map_from_tracking } in places {
            let step = last.map(|last| step_length(&(last.inverse() * map_from_tracking)));
            let Some(node_id) = by_time.get(time).filter(|_| step.is_none_or(|step| step >= TIE_SPACING))
            else {
                continue;
            };
            let found = nearest.find(map_from_tracking);
            let (Some(node), Some((submap_id, map_from_submap))) =
                (self.state.nodes.get(node_id), found.and_then(|id| Some((id, known.get(&id)?))))
            else {
                continue;
            };
            let map_from_node = S::graph_pose(map_from_tracking, &node.data.gravity_alignment);
            let submap_from_node = map_from_submap.inverse() * map_from_node;
            ties.push(Tie { node_id: *node_id, submap_id, submap_from_node });
            last = Some(*map_from_tracking);
        }
        ties
    }

    /// Moves the part of the map that a node belongs to, if it has no place in the known one yet.
    fn put_where_found(&mut self, tie: &Tie) {
        let part = tie.node_id.trajectory_id;
        if self.state.connectivity.are_connected(part, tie.submap_id.trajectory_id) {
            return;
        }
        let (Some(node), Some(map_from_submap)) =
            (self.problem.nodes.get(&tie.node_id), self.problem.submaps.get(&tie.submap_id))
        else {
            return;
        };
        let by = map_from_submap * tie.submap_from_node * node.map_from_node.inverse();
        self.localisation.placed_at = self.localisation.placed_at.or(Some(node.time));
        self.move_part(self.state.connectivity.first_connected(part), &by);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use portolan_config::Options;

    use super::*;
    use crate::made_rooms::{node, submap};
    use crate::{InsertedNode, InsertionSubmap, NodeData, Planar, of_trajectory};

    const ROOM: (f32, f32) = (9.0, 7.0);

    /// Adds a node that was taken after so many seconds, with a complete submap of the room.
    fn add(graph: &mut PoseGraph<Planar>, id: TrajectoryId, seconds: f64) {
        let data = NodeData { time: Time::from_unix_seconds(seconds), ..node(ROOM, (0.5, 0.2)) };
        let finished = Some(Arc::new(submap(ROOM)));
        let submaps = vec![InsertionSubmap { index: 0, local_from_submap: Rigid3::identity(), finished }];
        graph.add_node(id, InsertedNode::new(Arc::new(data), submaps));
    }

    #[test]
    fn what_was_found_is_put_there_and_tied() {
        let mut graph = PoseGraph::<Planar>::new(Options::for_2d().map_builder.pose_graph);
        let [known, new] = [TrajectoryId(0), TrajectoryId(1)];
        for (id, seconds) in [(known, 1.0), (new, 100.0)] {
            graph.add_trajectory(id, None);
            add(&mut graph, id, seconds);
        }
        let submaps: BTreeMap<SubmapId, Rigid3> = graph
            .problem
            .submaps
            .iter()
            .filter(|(id, _)| id.trajectory_id == known)
            .map(|(id, p)| (*id, *p))
            .collect();
        assert!(!submaps.is_empty() && !graph.state.connectivity.are_connected(known, new));
        let map_from_tracking = Rigid3::translation(2.0, -1.0, 0.0);
        let at = |seconds| FoundPlace { time: Time::from_unix_seconds(seconds), map_from_tracking };
        assert_eq!(graph.tie_found(&submaps, &[at(1.0), at(50.0)]), 0, "known nodes, and no nodes at all");
        assert_eq!(graph.tie_found(&submaps, &[at(100.0), at(100.0)]), 1, "once in half a metre");
        assert!(graph.state.connectivity.are_connected(known, new));
        let (_, placed) = of_trajectory(&graph.problem.nodes, new).next().unwrap();
        assert!(
            (placed.map_from_node.translation.vector - map_from_tracking.translation.vector).norm() < 1e-9
        );
        let ties =
            graph.state.constraints.iter().filter(|c| c.node_id.trajectory_id != c.submap_id.trajectory_id);
        assert_eq!(ties.count(), 1);
    }
}
