//! Checks whether the loop closures of a map are correct.

use std::collections::BTreeMap;

use portolan_geometry::{Duration, Rigid3, Time};

use super::generate::{IdInMap, MapConstraint, MapGraph, bad, node};
use super::{Relation, RelationReport};
use crate::{EvaluationError, Trajectory};

/// Largest errors of a loop closure that counts as correct: metres and degrees.
pub const RIGHT_WITHIN: (f64, f64) = (0.2, 3.0);

/// Each loop closure as a motion between two times, in the order of the file. The motion goes to the node of
/// the loop closure, from the submap's own node that is nearest to it according to the loop closure. Compared
/// with a true trajectory, the motions show which loop closures are correct. This choice of the start keeps
/// the error of local SLAM within a submap small in the result.
///
/// # Errors
/// If a constraint refers to a node or submap that is not in the map, or a submap with a loop closure has no
/// nodes.
pub fn loop_closure_relations(map: &MapGraph) -> Result<Vec<Relation>, EvaluationError> {
    let mut own_nodes: OwnNodes = BTreeMap::new();
    for constraint in map.constraints.iter().filter(|c| c.is_intra) {
        own_nodes.entry(constraint.submap).or_default().push((constraint.node, constraint.submap_from_node));
    }
    let loops = map.constraints.iter().filter(|c| !c.is_intra);
    loops.map(|constraint| relation(map, constraint, &own_nodes)).collect()
}

/// The nodes of each submap, with their poses in the submap.
type OwnNodes = BTreeMap<IdInMap, Vec<(IdInMap, Rigid3)>>;

fn relation(
    map: &MapGraph,
    constraint: &MapConstraint,
    own_nodes: &OwnNodes,
) -> Result<Relation, EvaluationError> {
    let place = constraint.submap_from_node.translation.vector;
    let distance = |(_, pose): &&(IdInMap, Rigid3)| (pose.translation.vector - place).norm();
    let nearest = own_nodes
        .get(&constraint.submap)
        .and_then(|nodes| nodes.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))))
        .ok_or_else(|| {
            bad(format!("submap {:?} has a loop closure and no node of its own", constraint.submap))
        })?;
    Ok(Relation {
        time1: node(map, nearest.0)?.time,
        time2: node(map, constraint.node)?.time,
        expected_1_from_2: nearest.1.inverse() * constraint.submap_from_node,
        covered_distance: 0.0,
    })
}

/// The same motions, between the times of the true poses nearest to their own times, at most `longest` away.
/// Relations without such poses are left out. The short motions in between are taken from the estimate: a
/// true trajectory with a pose every few seconds does not contain the rotation between its poses.
pub fn at_times_of(
    truth: &Trajectory,
    estimate: &Trajectory,
    relations: &[Relation],
    longest: Duration,
) -> Vec<Relation> {
    let moved = |relation: &Relation| {
        let time1 = truth.nearest(relation.time1, longest)?.time;
        let time2 = truth.nearest(relation.time2, longest)?.time;
        let motion = |from: Time, to: Time| {
            Some(estimate.lookup_clamped(from)?.inverse() * estimate.lookup_clamped(to)?)
        };
        let expected_1_from_2 =
            motion(time1, relation.time1)? * relation.expected_1_from_2 * motion(relation.time2, time2)?;
        Some(Relation { time1, time2, expected_1_from_2, ..*relation })
    };
    relations.iter().filter_map(moved).collect()
}

impl RelationReport {
    /// Fraction of the relations with errors within these metres and degrees, 0 to 1.
    pub fn fraction_right(&self, (metres, degrees): (f64, f64)) -> f64 {
        let right = self.errors.iter().filter(|e| e.translation <= metres && e.rotation_degrees <= degrees);
        right.count() as f64 / self.errors.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{TimedPose, Trajectory, relation_errors};
    use portolan_geometry::{Time, Vector3};

    fn pose(i: u32) -> Rigid3 {
        Rigid3::new(Vector3::new(f64::from(i), 0.3, 0.0), Vector3::z() * 0.01 * f64::from(i))
    }

    fn constraint(submap: u32, node: u32, is_intra: bool, off: Rigid3) -> MapConstraint {
        let submap_from_node = pose(10 * submap).inverse() * pose(node) * off;
        MapConstraint { submap: (0, submap), node: (0, node), is_intra, submap_from_node }
    }

    #[test]
    fn right_and_wrong_loop_closures_are_distinguished() {
        let nodes: Vec<TimedPose> = (0..30)
            .map(|i| TimedPose { time: Time::from_ticks(i64::from(i)), map_from_tracking: pose(i) })
            .collect();
        let mut constraints: Vec<MapConstraint> =
            (0..10).map(|i| constraint(0, i, true, Rigid3::identity())).collect();
        constraints.push(constraint(0, 20, false, Rigid3::translation(0.05, 0.0, 0.0)));
        constraints.push(constraint(0, 22, false, Rigid3::translation(1.5, 0.0, 0.0)));
        constraints.push(constraint(0, 23, false, Rigid3::rotation(Vector3::z() * 0.1)));
        let by_id = (0..).zip(&nodes).map(|(i, node)| ((0, i), *node)).collect();
        let map = MapGraph { nodes: by_id, map_from_submap: [((0, 0), pose(0))].into(), constraints };
        let relations = loop_closure_relations(&map).unwrap();
        assert_eq!(relations.len(), 3);
        assert_eq!(relations[0].time1, Time::from_ticks(9));
        let report = relation_errors(&Trajectory::new(nodes).0, &relations).unwrap();
        assert!((report.fraction_right(RIGHT_WITHIN) - 1.0 / 3.0).abs() < 1e-12);
        assert!((report.errors[0].translation - 0.05).abs() < 1e-9);
        assert!((report.errors[2].rotation_degrees - 0.1f64.to_degrees()).abs() < 1e-6);
    }

    #[test]
    fn loop_closures_between_trajectories_are_judged_too() {
        let at = |i: u32| TimedPose { time: Time::from_ticks(i64::from(i)), map_from_tracking: pose(i) };
        let nodes = (0..10).map(|i| ((0, i), at(i))).chain((0..5).map(|i| ((1, i), at(20 + i)))).collect();
        let mut constraints: Vec<MapConstraint> =
            (0..10).map(|i| constraint(0, i, true, Rigid3::identity())).collect();
        let found = constraint(0, 24, false, Rigid3::identity());
        constraints.push(MapConstraint { node: (1, 4), ..found });
        let map = MapGraph { nodes, map_from_submap: [((0, 0), pose(0))].into(), constraints };
        let relations = loop_closure_relations(&map).unwrap();
        assert_eq!([relations[0].time1, relations[0].time2], [9, 24].map(Time::from_ticks));
    }

    #[test]
    fn sparse_truth_is_compared_at_its_own_times() {
        let at = |i: i64| Time::from_ticks(10_000_000 * i);
        let all: Vec<TimedPose> =
            (0..30).map(|i| TimedPose { time: at(i), map_from_tracking: pose((i * i) as u32) }).collect();
        let truth: Vec<TimedPose> = all.iter().step_by(7).copied().collect();
        let (estimate, truth) = (Trajectory::new(all).0, Trajectory::new(truth).0);
        let relation = Relation {
            time1: at(6),
            time2: at(22),
            expected_1_from_2: pose(36).inverse() * pose(22 * 22),
            covered_distance: 0.0,
        };
        let relations = [relation, relation];
        let moved = at_times_of(&truth, &estimate, &relations, Duration::from_seconds(1.0));
        assert_eq!((moved[0].time1, moved[0].time2), (at(7), at(21)));
        let report = relation_errors(&truth, &moved).unwrap();
        assert!(report.translation.max < 1e-9);
        assert!(at_times_of(&truth, &estimate, &relations, Duration::from_seconds(0.5)).is_empty());
    }

    #[test]
    fn a_loop_closure_of_a_submap_without_nodes_is_an_error() {
        let nodes = [((0, 0), TimedPose { time: Time::from_ticks(0), map_from_tracking: pose(0) })].into();
        let constraints = vec![constraint(0, 0, false, Rigid3::identity())];
        let map = MapGraph { nodes, map_from_submap: [((0, 0), pose(0))].into(), constraints };
        assert!(loop_closure_relations(&map).is_err());
    }
}
