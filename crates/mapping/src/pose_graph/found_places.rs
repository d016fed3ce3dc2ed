//! Ties scans of a recording to a known map in which something other than the pose graph localised them.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Rigid3, Time};

use super::PoseGraph;
use super::extension::{NearestSubmaps, TIE_SPACING};
use super::insertion::step_length;
use super::places::{AROUND_PROPOSAL, Steps};
use crate::{NodeId, Space, SubmapId, TrajectoryId};

/// Pose of the tracking frame in a known map when a scan was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundPlace {
    /// Time of the scan.
    pub time: Time,
    /// In the frame of the pose graph, with the known map at its pose when it was loaded.
    pub map_from_tracking: Rigid3,
}

/// Known submaps in which something other than the pose graph localises nodes as they come.
#[derive(Default)]
pub(super) struct Tracked {
    /// Their poses at the start.
    known: BTreeMap<SubmapId, Rigid3>,
    /// Distance along its trajectory of the last node that was searched at its localised pose, metres.
    last: Steps,
}

impl Tracked {
    /// The trajectories of the known submaps.
    pub fn trajectories(&self) -> BTreeSet<TrajectoryId> {
        self.known.keys().map(|id| id.trajectory_id).collect()
    }
}

/// A node found in a known submap.
struct Tie {
    node_id: NodeId,
    submap_id: SubmapId,
    submap_from_node: Rigid3,
}

impl<S: Space> PoseGraph<S> {
    /// While nodes come, something other than the pose graph localises them in these submaps, which have
    /// these poses, and reports their poses ([`Self::look_where_found`], [`Self::tie_found`]). The whole map
    /// is searched only at the end, for trajectories without a place then.
    pub fn leave_to_tracker(&mut self, known: BTreeMap<SubmapId, Rigid3>) {
        self.tracked = Tracked { known, last: Steps::default() };
    }

    /// Schedules the search for a node around its localised pose in the known submaps, unless its part of the
    /// map is tied to them. The matcher of submaps accepts or rejects the pose as if the pose graph had found
    /// it.
    pub fn look_where_found(&mut self, place: &FoundPlace) {
        let newest_first = self.state.nodes.iter().rev();
        let mut not_older = newest_first.take_while(|(_, node)| node.data.time >= place.time);
        let Some((node_id, _)) = not_older.find(|(_, node)| node.data.time == place.time) else { return };
        let (node_id, part) = (*node_id, node_id.trajectory_id);
        let known = self.tracked.trajectories();
        let is_tied = known.iter().any(|id| self.state.connectivity.are_connected(part, *id));
        let path_length = self.path_lengths.get(&node_id).copied().unwrap_or(0.0);
        let spacing = self.spacing_of_searches();
        if is_tied || !self.tracked.last.is_due(part, path_length, spacing) {
            return;
        }
        let Some(tie) = self.tie_of(node_id, place, &self.nearest_known()) else { return };
        if let Some((submap, node)) = self.state.pair(tie.submap_id, node_id) {
            self.search.add_proposed(submap, node, tie.submap_from_node, AROUND_PROPOSAL);
        }
    }

    /// Ties nodes that were localised in the known submaps ([`Self::leave_to_tracker`]) to the nearest of
    /// these, one per half a metre of path. A part of the map that nothing ties to the known ones yet is
    /// moved there. Returns the number of ties.
    pub fn tie_found(&mut self, places: &[FoundPlace]) -> usize {
        let ties = self.ties_of(places);
        for tie in &ties {
            self.put_where_found(tie);
            let constraint = self.loop_closure(tie.submap_id, tie.node_id, tie.submap_from_node);
            self.load_constraint(constraint);
        }
        ties.len()
    }

    fn ties_of(&self, places: &[FoundPlace]) -> Vec<Tie> {
        let trajectories = self.tracked.trajectories();
        let new = self.state.nodes.iter().filter(|(id, _)| !trajectories.contains(&id.trajectory_id));
        let by_time: BTreeMap<Time, NodeId> = new.map(|(id, node)| (node.data.time, *id)).collect();
        let nearest = self.nearest_known();
        let mut ties = Vec::new();
        let mut last: Option<Rigid3> = None;
        for place in places {
            let step = last.map(|last| step_length(&(last.inverse() * place.map_from_tracking)));
            let is_due = step.is_none_or(|step| step >= TIE_SPACING);
            let node_id = by_time.get(&place.time).filter(|_| is_due);
            if let Some(tie) = node_id.and_then(|id| self.tie_of(*id, place, &nearest)) {
                ties.push(tie);
                last = Some(place.map_from_tracking);
            }
        }
        ties
    }

    fn nearest_known(&self) -> NearestSubmaps {
        NearestSubmaps::new(self, &self.tracked.known.keys().copied().collect())
    }

    /// The tie between a node and the nearest known submap.
    fn tie_of(&self, node_id: NodeId, place: &FoundPlace, nearest: &NearestSubmaps) -> Option<Tie> {
        let submap_id = nearest.find(&place.map_from_tracking)?;
        let map_from_submap = self.tracked.known.get(&submap_id)?;
        let node = self.state.nodes.get(&node_id)?;
        let map_from_node = S::graph_pose(&place.map_from_tracking, &node.data.gravity_alignment);
        Some(Tie { node_id, submap_id, submap_from_node: map_from_submap.inverse() * map_from_node })
    }

    /// Moves the part of the map that a node belongs to, if it is not connected with the known one yet.
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
    use crate::{InsertedNode, InsertionSubmap, NodeData, PoseGraphPolicy, Space2d, of_trajectory};

    const ROOM: (f32, f32) = (9.0, 7.0);

    /// Adds a node taken at this time, with a complete submap of the room.
    fn add(graph: &mut PoseGraph<Space2d>, id: TrajectoryId, seconds: f64) {
        let data = NodeData { time: Time::from_unix_seconds(seconds), ..node(ROOM, (0.5, 0.2)) };
        let finished = Some(Arc::new(submap(ROOM)));
        let submaps = vec![InsertionSubmap { index: 0, local_from_submap: Rigid3::identity(), finished }];
        graph.add_node(id, InsertedNode::new(Arc::new(data), submaps));
    }

    /// A known trajectory, and another one a hundred seconds later that nothing ties to it.
    fn known_and_new() -> (PoseGraph<Space2d>, [TrajectoryId; 2]) {
        let mut options = Options::for_2d();
        options.portolan.loop_search_drift = 0.02;
        let mut graph = PoseGraph::<Space2d>::new(options.map_builder.pose_graph.clone());
        graph.set_policy(PoseGraphPolicy::new(&options.portolan));
        let [known, new] = [TrajectoryId(0), TrajectoryId(1)];
        graph.add_trajectory(known, None);
        add(&mut graph, known, 1.0);
        let submaps: BTreeMap<SubmapId, Rigid3> =
            graph.problem.submaps.iter().map(|(id, p)| (*id, *p)).collect();
        assert!(!submaps.is_empty());
        graph.leave_to_tracker(submaps);
        graph.add_trajectory(new, None);
        add(&mut graph, new, 100.0);
        (graph, [known, new])
    }

    #[test]
    fn nodes_are_searched_at_their_localised_poses() {
        let (mut graph, [known, new]) = known_and_new();
        let map_from_tracking = Rigid3::translation(0.5, 0.2, 0.0);
        let at = |seconds| FoundPlace { time: Time::from_unix_seconds(seconds), map_from_tracking };
        graph.look_where_found(&at(50.0));
        assert!(!graph.search.has_unplaced(), "no node was found");
        graph.look_where_found(&at(100.0));
        assert!(graph.search.has_unplaced());
        graph.optimize();
        assert!(graph.state.connectivity.are_connected(known, new));
    }

    #[test]
    fn localised_nodes_are_placed_and_connected() {
        let (mut graph, [known, new]) = known_and_new();
        assert!(!graph.state.connectivity.are_connected(known, new));
        let map_from_tracking = Rigid3::translation(2.0, -1.0, 0.0);
        let at = |seconds| FoundPlace { time: Time::from_unix_seconds(seconds), map_from_tracking };
        assert_eq!(graph.tie_found(&[at(1.0), at(50.0)]), 0, "known nodes, and no nodes at all");
        assert_eq!(graph.tie_found(&[at(100.0), at(100.0)]), 1, "once in half a metre");
        assert!(graph.state.connectivity.are_connected(known, new));
        graph.look_where_found(&at(100.0));
        assert!(!graph.search.has_unplaced(), "what is tied is not looked for");
        let (_, placed) = of_trajectory(&graph.problem.nodes, new).next().unwrap();
        assert!(
            (placed.map_from_node.translation.vector - map_from_tracking.translation.vector).norm() < 1e-9
        );
        let ties =
            graph.state.constraints.iter().filter(|c| c.node_id.trajectory_id != c.submap_id.trajectory_id);
        assert_eq!(ties.count(), 1);
    }
}
