//! Whether the loop closures of a map are right.

use std::collections::BTreeMap;

use portolan_geometry::Rigid3;

use super::generate::{MapConstraint, MapGraph, bad, indices, node};
use super::{Relation, RelationReport};
use crate::EvaluationError;

/// Loop closures within these errors count as right: metres and degrees.
pub const RIGHT_WITHIN: (f64, f64) = (0.2, 3.0);

/// Each loop closure as a motion between two times, in the order of the file: from the node of the
/// submap that is nearest to where the loop closure says the other node is, to that other node. Compare
/// them with a true trajectory to learn which loop closures are right; local SLAM's own error within a
/// submap is then hardly in the figures.
///
/// # Errors
/// If a constraint names what is not there, or the map has more than one trajectory.
pub fn loop_closure_relations(map: &MapGraph) -> Result<Vec<Relation>, EvaluationError> {
    let mut own_nodes: BTreeMap<usize, Vec<(usize, Rigid3)>> = BTreeMap::new();
    for constraint in map.constraints.iter().filter(|c| c.is_intra) {
        let (submap, node) = indices(constraint)?;
        own_nodes.entry(submap).or_default().push((node, constraint.submap_from_node));
    }
    let loops = map.constraints.iter().filter(|c| !c.is_intra);
    loops.map(|constraint| relation(map, constraint, &own_nodes)).collect()
}

fn relation(
    map: &MapGraph,
    constraint: &MapConstraint,
    own_nodes: &BTreeMap<usize, Vec<(usize, Rigid3)>>,
) -> Result<Relation, EvaluationError> {
    let (submap, found) = indices(constraint)?;
    let place = constraint.submap_from_node.translation.vector;
    let distance = |(_, pose): &&(usize, Rigid3)| (pose.translation.vector - place).norm();
    let nearest = own_nodes
        .get(&submap)
        .and_then(|nodes| nodes.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))))
        .ok_or_else(|| bad(format!("submap {submap} has a loop closure and no node of its own")))?;
    Ok(Relation {
        time1: node(map, nearest.0)?.time,
        time2: node(map, found)?.time,
        expected_1_from_2: nearest.1.inverse() * constraint.submap_from_node,
        covered_distance: 0.0,
    })
}

impl RelationReport {
    /// Share of the relations within metres and degrees, 0 to 1.
    pub fn share_right(&self, (metres, degrees): (f64, f64)) -> f64 {
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
    fn right_and_wrong_loop_closures_are_told_apart() {
        let nodes: Vec<TimedPose> = (0..30)
            .map(|i| TimedPose { time: Time::from_ticks(i64::from(i)), map_from_tracking: pose(i) })
            .collect();
        let mut constraints: Vec<MapConstraint> =
            (0..10).map(|i| constraint(0, i, true, Rigid3::identity())).collect();
        constraints.push(constraint(0, 20, false, Rigid3::translation(0.05, 0.0, 0.0)));
        constraints.push(constraint(0, 22, false, Rigid3::translation(1.5, 0.0, 0.0)));
        constraints.push(constraint(0, 23, false, Rigid3::rotation(Vector3::z() * 0.1)));
        let map = MapGraph { nodes: nodes.clone(), map_from_submap: vec![pose(0)], constraints };
        let relations = loop_closure_relations(&map).unwrap();
        assert_eq!(relations.len(), 3);
        assert_eq!(relations[0].time1, Time::from_ticks(9));
        let report = relation_errors(&Trajectory::new(nodes).0, &relations).unwrap();
        assert!((report.share_right(RIGHT_WITHIN) - 1.0 / 3.0).abs() < 1e-12);
        assert!((report.errors[0].translation - 0.05).abs() < 1e-9);
        assert!((report.errors[2].rotation_degrees - 0.1f64.to_degrees()).abs() < 1e-6);
    }

    #[test]
    fn a_loop_closure_of_a_submap_without_nodes_is_an_error() {
        let nodes = vec![TimedPose { time: Time::from_ticks(0), map_from_tracking: pose(0) }];
        let constraints = vec![constraint(0, 0, false, Rigid3::identity())];
        let map = MapGraph { nodes, map_from_submap: vec![pose(0)], constraints };
        assert!(loop_closure_relations(&map).is_err());
    }
}
