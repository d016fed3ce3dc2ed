//! Trajectories that continue after a gap in which only odometry measured the motion: there were no scans, or
//! they contradicted the map.
//!
//! Odometry may have failed in the gap without any sign of it. So the parts before and after a gap stay
//! unconnected until scans agree on their relative pose. Where none do, odometry ties them at the end,
//! weighted by its known uncertainty. Where scans contradicted the map, the scanner may have been carried
//! elsewhere, and the part after the gap is searched everywhere. But wheels seldom roll while a robot is
//! carried: matches that agree with odometry, and with each other, are accepted before any others.

use std::collections::BTreeSet;

use portolan_geometry::rotation_angle;

use super::PoseGraph;
use super::state::Gap;
use super::travel::TravelGraph;
use crate::{Constraint, ConstraintTag, Space, TrajectoryId, of_trajectory};

impl<S: Space> PoseGraph<S> {
    /// Whether odometry alone constrains the part of the map that continues after a gap: no match connects
    /// it with the part before.
    pub fn is_tied_by_odometry_alone(&self, id: TrajectoryId) -> bool {
        let gap = self.state.trajectories.get(&id).and_then(|entry| entry.after_gap);
        gap.is_some_and(|gap| {
            self.has_odometry_tie(id)
                && !self.connectivity_by(|tie| tie.score.is_some(), |_| true).are_connected(id, gap.before)
        })
    }

    pub(super) fn has_odometry_tie(&self, id: TrajectoryId) -> bool {
        self.tied_by_odometry.contains(&id)
    }

    /// Whether two trajectories are parts of one, with gaps without scans between.
    pub(super) fn is_beyond_gap(&self, a: TrajectoryId, b: TrajectoryId) -> bool {
        self.first_before_gaps(a) == self.first_before_gaps(b)
    }

    /// The trajectories that a trajectory is connected with, and those that continue these after gaps.
    pub(super) fn parts_beyond_gaps(&self, id: TrajectoryId) -> BTreeSet<TrajectoryId> {
        let beyond = self.state.trajectories.keys().filter(|other| self.is_beyond_gap(id, **other));
        let connected = self.state.connectivity.members(id);
        beyond.chain(&connected).flat_map(|id| self.state.connectivity.members(*id)).collect()
    }

    fn first_before_gaps(&self, mut id: TrajectoryId) -> TrajectoryId {
        let gap = |id| self.state.trajectories.get(&id).and_then(|entry| entry.after_gap);
        while let Some(gap) = gap(id).filter(|gap| !gap.bridge.is_contradicted) {
            id = gap.before;
        }
        id
    }

    /// Whether a match agrees with odometry for a part of the map that continues after scans had contradicted
    /// the map: within the errors of odometry and of the paths to the matched node and submap.
    pub(super) fn agrees_with_odometry(&self, constraint: &Constraint) -> bool {
        if self.policy.loops.drift == 0.0 {
            return false;
        }
        let mut contradicted =
            self.state.trajectories.iter().filter_map(|(id, entry)| {
                Some((*id, entry.after_gap.filter(|gap| gap.bridge.is_contradicted)?))
            });
        let mut travel = None;
        contradicted.any(|(id, gap)| {
            let travel = travel.get_or_insert_with(|| TravelGraph::new(&self.state, &self.path_lengths));
            self.is_near_odometry(constraint, (id, gap), travel).unwrap_or(false)
        })
    }

    /// None if the match does not relate the map before the gap to the map after it.
    fn is_near_odometry(
        &self,
        constraint: &Constraint,
        (after, gap): (TrajectoryId, Gap),
        travel: &TravelGraph,
    ) -> Option<bool> {
        let tie = self.tie_over_gap(after)?;
        let node = self.problem.nodes.get(&tie.node_id)?;
        let before_from_after =
            self.problem.submaps.get(&tie.submap_id)? * tie.submap_from_node * node.map_from_node.inverse();
        let is_in = |part, id| self.state.connectivity.are_connected(part, id);
        let Constraint { submap_id, node_id, .. } = *constraint;
        let found = self.problem.submaps.get(&submap_id)? * constraint.submap_from_node;
        let known = self.problem.nodes.get(&node_id)?.map_from_node;
        let submap_of_node = travel.submap_of(node_id)?;
        let (error, before, later) = if is_in(after, node_id.trajectory_id) {
            is_in(gap.before, submap_id.trajectory_id).then_some(())?;
            (found.inverse() * (before_from_after * known), submap_id, submap_of_node)
        } else {
            (is_in(gap.before, node_id.trajectory_id) && is_in(after, submap_id.trajectory_id))
                .then_some(())?;
            ((before_from_after * found).inverse() * known, submap_of_node, submap_id)
        };
        let (to_gap, from_gap) =
            (travel.lengths_from(tie.submap_id), travel.lengths_from(travel.submap_of(tie.node_id)?));
        let path_length = to_gap.of_place(before)? + gap.path_length + from_gap.of_place(later)?;
        let turned = to_gap.of_heading(before)? + gap.path_length + from_gap.of_heading(later)?;
        let window = self.policy.loops.window(path_length, turned);
        Some(error.translation.vector.norm() <= window.linear && rotation_angle(&error) <= window.angular)
    }

    /// Ties trajectories to the ones before their gaps by odometry, where nothing else ties them.
    pub(super) fn tie_over_gaps(&mut self) {
        let ids: BTreeSet<TrajectoryId> = self.state.trajectories.keys().copied().collect();
        for id in ids {
            let Some(constraint) = self.tie_over_gap(id) else { continue };
            self.take(constraint);
            self.tied_by_odometry.insert(id);
        }
    }

    /// Odometry constraint for the first node after a gap; none where something else ties it.
    fn tie_over_gap(&self, id: TrajectoryId) -> Option<Constraint> {
        let gap = self.state.trajectories.get(&id)?.after_gap?;
        let is_tied = self.state.connectivity.are_connected(id, gap.before);
        if is_tied { None } else { self.odometry_over_gap(id) }
    }

    /// What odometry says of the first node after a gap.
    pub(super) fn odometry_over_gap(&self, id: TrajectoryId) -> Option<Constraint> {
        let gap = self.state.trajectories.get(&id)?.after_gap?;
        let (submap_id, submap) = of_trajectory(&self.state.submaps, gap.before).next_back()?;
        let (node_id, node) = of_trajectory(&self.problem.nodes, id).next()?;
        Some(Constraint {
            submap_id,
            node_id,
            submap_from_node: submap.local_from_submap.inverse() * node.local_from_node,
            translation_weight: 1.0 / gap.bridge.translation,
            rotation_weight: 1.0 / gap.bridge.rotation,
            tag: ConstraintTag::InterSubmap,
            open: None,
            score: None,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use portolan_config::Options;
    use portolan_geometry::{Rigid3, Time, Vector3};

    use super::*;
    use crate::made_rooms::{node, submap};
    use crate::{InsertedNode, InsertionSubmap, NodeData, NodeId, OpenShift, Space2d, SubmapId};
    use portolan_local_slam::OdometryBridge;

    /// A scan of a room of this size at `x` metres in the local map, and the submap that it completes.
    fn inserted(room: (f32, f32), seconds: f64, x: f64) -> InsertedNode<Space2d> {
        let local = Rigid3::translation(x, 0.0, 0.0);
        let data = NodeData {
            time: Time::from_unix_seconds(seconds),
            local_from_tracking: local,
            ..node(room, (0.0, 0.0))
        };
        let finished = Some(Arc::new(submap(room)));
        let submaps = vec![InsertionSubmap { index: 0, local_from_submap: local, finished }];
        InsertedNode::new(Arc::new(data), submaps)
    }

    #[test]
    fn degenerate_matches_connect_parts_only_with_odometry() {
        let options = Options::for_2d().map_builder.pose_graph;
        let mut graph = PoseGraph::<Space2d>::new(options);
        graph.policy.min_agreeing = 3;
        let [before, after] = [0, 1].map(TrajectoryId);
        graph.add_trajectory(before, None);
        graph.add_node(before, inserted((9.0, 7.0), 0.0, 0.0));
        let bridge = OdometryBridge { translation: 0.5, rotation: 0.1, is_contradicted: false };
        graph.begin_piece(before, Vec::new(), after, &Rigid3::identity(), Some(bridge));
        let nodes = [0, 1, 2].map(|i| {
            let mut node = inserted((6.0, 5.0), 10.0 + f64::from(i), 20.0 + f64::from(i));
            node.submaps.iter_mut().for_each(|submap| submap.index = i);
            graph.add_node(after, node)
        });
        let along = OpenShift { direction: Vector3::x() };
        let found = |node_id: NodeId| Constraint {
            submap_id: SubmapId::new(before, 0),
            node_id,
            submap_from_node: Rigid3::translation(17.0 + f64::from(node_id.index), 0.1, 0.0),
            translation_weight: 500.0,
            rotation_weight: 1600.0,
            tag: ConstraintTag::InterSubmap,
            open: Some(along),
            score: Some(0.8),
        };
        graph.add_found(nodes.map(found).to_vec());
        assert!(!graph.state().connectivity.are_connected(before, after));
        graph.tie_over_gaps();
        graph.add_found(Vec::new());
        graph.run_final_optimization();
        let at = graph.state().nodes.get(&nodes[1]).unwrap().map_from_tracking.translation.vector;
        assert!((at.x - 21.0).abs() < 1e-3 && (at.y - 0.1).abs() < 0.02, "{at}");
    }

    /// Three nodes place the part after a gap where odometry predicts it, two metres beside it, and three
    /// more place it elsewhere: returns whether any are accepted.
    fn is_odometry_accepted(is_contradicted: bool) -> bool {
        let options = Options::for_2d().map_builder.pose_graph;
        let mut graph = PoseGraph::<Space2d>::new(options);
        graph.policy.min_agreeing = 3;
        graph.policy.loops.drift = 0.05;
        let [before, after] = [0, 1].map(TrajectoryId);
        graph.add_trajectory(before, None);
        graph.add_node(before, inserted((9.0, 7.0), 0.0, 0.0));
        let bridge = OdometryBridge { translation: 0.5, rotation: 0.1, is_contradicted };
        graph.begin_piece(before, Vec::new(), after, &Rigid3::identity(), Some(bridge));
        let nodes = [0, 1, 2, 3, 4, 5].map(|i| {
            let mut node = inserted((6.0, 5.0), 10.0 + f64::from(i), 20.0 + f64::from(i));
            node.submaps.iter_mut().for_each(|submap| submap.index = i);
            graph.add_node(after, node)
        });
        for (i, node_id) in nodes.into_iter().enumerate() {
            let x = 20.0 + f64::from(node_id.index);
            let submap_from_node = match i % 2 {
                0 => Rigid3::translation(60.0 + x, 0.0, 0.0),
                _ => Rigid3::translation(x, 2.0, 0.0),
            };
            graph.add_found(vec![Constraint {
                submap_id: SubmapId::new(before, 0),
                node_id,
                submap_from_node,
                translation_weight: 500.0,
                rotation_weight: 1600.0,
                tag: ConstraintTag::InterSubmap,
                open: None,
                score: Some(0.8),
            }]);
        }
        let place = graph.problem.nodes[&nodes[1]].map_from_node.translation.vector;
        graph.state().connectivity.are_connected(before, after) && (place.y - 2.0).abs() < 1e-6
    }

    #[test]
    fn places_that_agree_with_odometry_are_preferred() {
        assert!(is_odometry_accepted(true));
        // A gap without scans: odometry is used for searching, and matches have to agree all the same.
        assert!(!is_odometry_accepted(false));
    }

    /// Where the part after a gap ends up, metres, that odometry puts 20 m ahead of a room of 6 by 5 m, and whose three matches put it into that room;
    /// its scans are of a room of this size.
    fn place_of(room: (f32, f32)) -> f64 {
        let mut graph = PoseGraph::<Space2d>::new(Options::for_2d().map_builder.pose_graph);
        graph.policy.min_agreeing = 3;
        graph.policy.loops.drift = 0.05;
        let [before, after] = [0, 1].map(TrajectoryId);
        graph.add_trajectory(before, None);
        graph.add_node(before, inserted((6.0, 5.0), 0.0, 0.0));
        let bridge = OdometryBridge { translation: 0.5, rotation: 0.1, is_contradicted: false };
        graph.begin_piece(before, Vec::new(), after, &Rigid3::identity(), Some(bridge));
        let found = [0, 1, 2].map(|i| {
            let x = 1.5 * f64::from(i) - 1.5;
            let data = NodeData {
                time: Time::from_unix_seconds(10.0 + f64::from(i)),
                local_from_tracking: Rigid3::translation(20.0 + x, 0.0, 0.0),
                ..node(room, (x as f32, 0.0))
            };
            let (finished, centre) = (Some(Arc::new(submap(room))), Rigid3::translation(20.0, 0.0, 0.0));
            let submaps = vec![InsertionSubmap { index: i, local_from_submap: centre, finished }];
            Constraint {
                submap_id: SubmapId::new(before, 0),
                node_id: graph.add_node(after, InsertedNode::new(Arc::new(data), submaps)),
                submap_from_node: Rigid3::translation(x, 0.0, 0.0),
                translation_weight: 500.0,
                rotation_weight: 1600.0,
                tag: ConstraintTag::InterSubmap,
                open: None,
                score: Some(0.8),
            }
        });
        let middle = found[1].node_id;
        graph.add_found(found.to_vec());
        assert!(graph.state().connectivity.are_connected(before, after));
        graph.run_final_optimization();
        assert!(graph.state().connectivity.are_connected(before, after));
        assert_eq!(graph.is_tied_by_odometry_alone(after), room != (6.0, 5.0));
        graph.state().nodes.get(&middle).unwrap().map_from_tracking.translation.vector.x
    }

    #[test]
    fn places_far_from_odometry_are_accepted_if_scans_confirm_them() {
        let (same_room, another_room) = (place_of((6.0, 5.0)), place_of((9.0, 7.0)));
        assert!(same_room.abs() < 0.05, "{same_room}");
        assert!((another_room - 20.0).abs() < 0.05, "{another_room}");
    }

    #[test]
    fn parts_without_matching_scans_are_placed_by_odometry() {
        is_tied_after_a_gap(false);
        is_tied_after_a_gap(true);
    }

    fn is_tied_after_a_gap(is_contradicted: bool) {
        let options = Options::for_2d().map_builder.pose_graph;
        let mut graph = PoseGraph::<Space2d>::new(options);
        let [before, after] = [0, 1].map(TrajectoryId);
        graph.add_trajectory(before, None);
        let first = graph.add_node(before, inserted((9.0, 7.0), 0.0, 0.0));
        let bridge = OdometryBridge { translation: 0.5, rotation: 0.1, is_contradicted };
        graph.begin_piece(before, Vec::new(), after, &Rigid3::identity(), Some(bridge));
        assert!(
            graph.is_beyond_gap(before, after) != is_contradicted
                && !graph.is_beyond_gap(before, TrajectoryId(2))
        );
        let second = graph.add_node(after, inserted((6.0, 5.0), 10.0, 200.0));
        assert!(!graph.state().connectivity.are_connected(before, after));
        graph.run_final_optimization();
        assert!(graph.is_tied_by_odometry_alone(after) && !graph.is_tied_by_odometry_alone(before));
        assert!(graph.state().connectivity.are_connected(before, after));
        let at = |id| graph.state().nodes.get(&id).unwrap().map_from_tracking.translation.vector;
        assert!(((at(second) - at(first)).x - 200.0).abs() < 1e-6, "{} {}", at(first), at(second));
    }
}
