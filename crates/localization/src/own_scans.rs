//! What a map of space says to its own scans: put where they were taken, and where they were not.

use portolan_geometry::{Rigid3, rotation_from_roll_pitch_yaw, to_f32};
use portolan_mapping::{GraphState, Node, Spatial};
use rayon::prelude::*;

use crate::belief::MapError;
use crate::known_map::{KnownMap, ON_THE_WAY};
use crate::spatial_map::{AROUND_PROPOSAL, SpatialMap};
use crate::spatial_scan::SpatialScan;

/// So many nodes are asked, evenly from all of them.
const ASKED: usize = 48;
/// Misplaced ones are turned by the golden angle against each other, radians.
const GOLDEN_ANGLE: f64 = 2.399_963;
/// The share that is explained by chance is taken for no more than this, and for this if no node has points.
const MOST_BY_CHANCE: f32 = 0.9;
const USUAL_CHANCE: f32 = 0.6;
/// No map is known better than this, metres: about what the noise of ranges leaves.
const LEAST: f64 = 0.005;

/// The scan of a node, and the frame in which it is level, in the map.
fn scan_of(node: &Node) -> (SpatialScan, Rigid3) {
    let level = SpatialMap::local_from_scan(&node.map_from_tracking);
    let scan_from_tracking = to_f32(&(level.inverse() * node.map_from_tracking));
    let points = SpatialMap::points_in_tracking(&node.data);
    (SpatialScan::new(&points.transformed(&scan_from_tracking)), level)
}

/// The median share that the map explains of its own scans, put to wrong places.
pub(crate) fn explained_by_chance(map: &SpatialMap, state: &GraphState<Spatial>) -> f32 {
    let nodes: Vec<_> = state.nodes.values().collect();
    let misplaced = |k: usize| {
        let (here, there) = (k * nodes.len() / ASKED, (k * 7 + 1) * nodes.len() / ASKED / 2);
        let (node, other) = (nodes.get(here)?, nodes.get(there % nodes.len())?);
        let (scan, level) = scan_of(node);
        let turn = rotation_from_roll_pitch_yaw(0.0, 0.0, 1.0 + GOLDEN_ANGLE * k as f64);
        let mut guess = SpatialMap::local_from_scan(&other.map_from_tracking);
        guess.rotation = turn * level.rotation;
        let pose = map.register(&scan.points, &guess, AROUND_PROPOSAL);
        (!scan.judged.is_empty()).then(|| map.agreement_of(&scan.judged, &pose).explained)
    };
    let mut shares: Vec<f32> = (0..ASKED).into_par_iter().filter_map(misplaced).collect();
    shares.sort_by(f32::total_cmp);
    shares.get(shares.len() / 2).map_or(USUAL_CHANCE, |share| share.min(MOST_BY_CHANCE))
}

/// How far from where they were taken the map finds its own scans: root mean square along each axis. Turns are those of any
/// map: own scans lie in its planes, and tell too little of them.
pub(crate) fn error_of_own_scans(map: &SpatialMap, state: &GraphState<Spatial>) -> MapError {
    let nodes: Vec<_> = state.nodes.values().collect();
    let square = |k: usize| {
        let (scan, level) = scan_of(nodes.get(k * nodes.len() / ASKED)?);
        let found = map.find(&scan, &level, ON_THE_WAY).pose.translation.vector;
        (!scan.judged.is_empty()).then(|| (found - level.translation.vector).norm_squared())
    };
    let squares: Vec<f64> = (0..ASKED).into_par_iter().filter_map(square).collect();
    if squares.is_empty() {
        return MapError::USUAL;
    }
    let of_axis = (squares.iter().sum::<f64>() / squares.len() as f64 / 3.0).sqrt();
    MapError { metres: of_axis.max(LEAST), ..MapError::USUAL }
}
