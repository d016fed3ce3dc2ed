//! Relations made from the loop closures of a map (`spec/tools.md` §1.2).

use std::collections::BTreeMap;

use portolan_geometry::{Rigid3, rotation_angle};

use super::Relation;
use crate::trajectory::covered_distances;
use crate::{EvaluationError, TimedPose};

/// Trajectory and index of a node or a submap.
pub type IdInMap = (u32, u32);

/// The part of a map from which relations are made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapGraph {
    /// Optimised nodes, tracking frame in the global map.
    pub nodes: BTreeMap<IdInMap, TimedPose>,
    /// Optimised submaps in the global map.
    pub map_from_submap: BTreeMap<IdInMap, Rigid3>,
    /// Constraints in the order of the file.
    pub constraints: Vec<MapConstraint>,
}

/// A constraint as stored in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapConstraint {
    /// The submap.
    pub submap: IdInMap,
    /// The node.
    pub node: IdInMap,
    /// Whether the node was inserted into the submap; if not, the constraint is a loop closure.
    pub is_intra: bool,
    /// The node's tracking frame in the submap.
    pub submap_from_node: Rigid3,
}

/// Which loop closures become relations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GenerateOptions {
    /// Minimum path length between both ends, metres; default 100.
    pub min_covered_distance: f64,
    /// Largest difference from the optimised map, metres; default 0.15.
    pub outlier_threshold_meters: f64,
    /// Largest difference from the optimised map, radians; default 0.02.
    pub outlier_threshold_radians: f64,
}

impl Default for GenerateOptions {
    fn default() -> Self {
        Self { min_covered_distance: 100.0, outlier_threshold_meters: 0.15, outlier_threshold_radians: 0.02 }
    }
}

/// Relations, and the number of rejected loop closures.
#[derive(Clone, Debug, PartialEq)]
pub struct GeneratedRelations {
    /// In the order of the constraints.
    pub relations: Vec<Relation>,
    /// Number of loop closures that disagree with the optimised map.
    pub outliers: usize,
}

impl GeneratedRelations {
    /// The line that Cartographer's tool prints.
    pub fn summary(&self) -> String {
        format!("Generated {} relations and ignored {} outliers.", self.relations.len(), self.outliers)
    }
}

pub(super) fn bad(reason: impl Into<String>) -> EvaluationError {
    EvaluationError::BadMap(reason.into())
}

/// Relates the node of every loop closure of a one-trajectory map to the middle of its submap. Loop closures
/// that span enough of the trajectory and agree with the optimised map are taken as true.
///
/// # Errors
/// If a constraint refers to a node or submap that is not in the map, or the map has more than one
/// trajectory.
pub fn generate_relations(
    map: &MapGraph,
    options: &GenerateOptions,
) -> Result<GeneratedRelations, EvaluationError> {
    if map.nodes.is_empty() {
        return Err(bad("it has no nodes"));
    }
    let is_of_one = |c: &MapConstraint| c.submap.0 == 0 && c.node.0 == 0;
    if !map.constraints.iter().all(is_of_one) {
        return Err(bad("it has constraints of more than one trajectory"));
    }
    let covered = covered_distances(map.nodes.values().map(|n| &n.map_from_tracking));
    let covered: BTreeMap<IdInMap, f64> = map.nodes.keys().copied().zip(covered).collect();
    let representatives = representative_nodes(map)?;
    let mut generated = GeneratedRelations { relations: Vec::new(), outliers: 0 };
    for constraint in map.constraints.iter().filter(|c| !c.is_intra) {
        let (submap_id, a) = (constraint.submap, constraint.node);
        let Some(b) = representatives.get(submap_id.1 as usize).copied() else { continue };
        let (node_a, node_b) = (node(map, a)?, node(map, b)?);
        let covered_at = |id: IdInMap| covered.get(&id).copied().unwrap_or_default();
        let covered_distance = (covered_at(a) - covered_at(b)).abs();
        if covered_distance < options.min_covered_distance {
            continue;
        }
        let map_from_submap = map
            .map_from_submap
            .get(&submap_id)
            .ok_or_else(|| bad(format!("a constraint names submap {}, which is not there", submap_id.1)))?;
        let b_from_map = node_b.map_from_tracking.inverse();
        let expected_1_from_2 = product(&product(&b_from_map, map_from_submap), &constraint.submap_from_node);
        let error = product(&(b_from_map * node_a.map_from_tracking), &expected_1_from_2.inverse());
        if error.translation.vector.norm() > options.outlier_threshold_meters
            || rotation_angle(&error) > options.outlier_threshold_radians
        {
            generated.outliers += 1;
            continue;
        }
        generated.relations.push(Relation {
            time1: node_b.time,
            time2: node_a.time,
            expected_1_from_2,
            covered_distance,
        });
    }
    Ok(generated)
}

/// Product with the rotation normalised: quaternions in files are slightly off unit length, and Cartographer
/// normalises every product.
fn product(a: &Rigid3, b: &Rigid3) -> Rigid3 {
    let mut product = a * b;
    product.rotation.renormalize();
    product
}

/// For each submap but the last, the first node of the next submap. It is at the middle of the submap,
/// because submaps overlap by half.
fn representative_nodes(map: &MapGraph) -> Result<Vec<IdInMap>, EvaluationError> {
    let mut representatives = Vec::new();
    for constraint in map.constraints.iter().filter(|c| c.is_intra) {
        let submap_index = constraint.submap.1 as usize;
        if submap_index <= representatives.len() {
            continue;
        }
        if submap_index != representatives.len() + 1 {
            return Err(bad(format!(
                "the first node of submap {} is missing; was the map trimmed?",
                representatives.len() + 1
            )));
        }
        representatives.push(constraint.node);
    }
    Ok(representatives)
}

pub(super) fn node(map: &MapGraph, id: IdInMap) -> Result<&TimedPose, EvaluationError> {
    map.nodes.get(&id).ok_or_else(|| bad(format!("a constraint names node {}, which is not there", id.1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Time, Vector3};

    /// Out and back along a line of forty nodes, with submaps of ten nodes that overlap by five. Nodes of the
    /// return path have loop closures to submaps of the outward path.
    fn map() -> MapGraph {
        let position = |i: u32| if i < 40 { f64::from(i) } else { f64::from(79 - i) };
        let pose = |i: u32| {
            Rigid3::new(Vector3::new(position(i), 0.0, 0.0), Vector3::z() * if i < 40 { 0.0 } else { 3.1 })
        };
        let time = |i: u32| Time::from_ticks(1000 * i64::from(i));
        let node = |i: u32| ((0, i), TimedPose { time: time(i), map_from_tracking: pose(i) });
        let nodes = (0..80).map(node).collect();
        let map_from_submap = (0..15).map(|k| ((0, k), pose(5 * k))).collect();
        let mut constraints = Vec::new();
        let constraint = |submap: u32, node: u32, is_intra| MapConstraint {
            submap: (0, submap),
            node: (0, node),
            is_intra,
            submap_from_node: pose(5 * submap).inverse() * pose(node),
        };
        for node in 0..80_u32 {
            for submap in
                [(node / 5).checked_sub(1), Some(node / 5)].into_iter().flatten().filter(|k| *k < 15)
            {
                constraints.push(constraint(submap, node, true));
            }
            if node >= 45 {
                constraints.push(constraint((79 - node) / 5, node, false));
            }
        }
        MapGraph { nodes, map_from_submap, constraints }
    }

    #[test]
    fn agreeing_loop_closures_become_relations() {
        let options = GenerateOptions { min_covered_distance: 30.0, ..Default::default() };
        let generated = generate_relations(&map(), &options).unwrap();
        assert_eq!(generated.outliers, 0);
        assert!(generated.relations.iter().all(|r| r.covered_distance >= 30.0 && r.time1 < r.time2));
        let last = generated.relations.last().unwrap();
        // Node 79 found in submap 0, whose middle is node 5.
        assert_eq!((last.time1.ticks(), last.time2.ticks()), (5000, 79_000));
        assert!((last.expected_1_from_2.translation.vector - Vector3::new(-5.0, 0.0, 0.0)).norm() < 1e-9);
        assert!((last.covered_distance - 73.0).abs() < 1e-9);
        assert!(generate_relations(&map(), &GenerateOptions::default()).unwrap().relations.is_empty());
    }

    #[test]
    fn disagreeing_loop_closures_are_outliers() {
        let options = GenerateOptions { min_covered_distance: 0.0, ..Default::default() };
        let all = generate_relations(&map(), &options).unwrap();
        let mut map = map();
        let mut found = map.constraints.iter_mut().filter(|c| !c.is_intra);
        found.next().unwrap().submap_from_node.translation.x += 0.2;
        let turn = Rigid3::rotation(Vector3::z() * 0.03);
        found.next().unwrap().submap_from_node *= turn;
        let generated = generate_relations(&map, &options).unwrap();
        assert_eq!((generated.outliers, generated.relations.len()), (2, all.relations.len() - 2));
        assert!(generated.summary().ends_with("and ignored 2 outliers."));
    }

    #[test]
    fn odd_maps_are_refused_by_name() {
        let options = GenerateOptions { min_covered_distance: 0.0, ..Default::default() };
        let error = |map: MapGraph| generate_relations(&map, &options).unwrap_err().to_string();
        assert!(error(MapGraph::default()).contains("no nodes"));
        let mut other = map();
        other.constraints[3].node.0 = 1;
        assert!(error(other).contains("more than one trajectory"));
        let mut trimmed = map();
        trimmed.constraints.retain(|c| c.submap.1 != 3 || !c.is_intra);
        assert!(error(trimmed).contains("first node of submap 3"));
        let mut cut = map();
        cut.nodes.retain(|id, _| id.1 < 70);
        assert!(error(cut).contains("node 70"));
    }
}
