//! Matches the scans of a 3D map to the map itself: at their true poses to measure the error of the map, and
//! at wrong poses to measure what it explains by chance.

use nalgebra::Matrix3;
use portolan_geometry::{Rigid3, Vector3, rotation_from_roll_pitch_yaw, to_f32};
use portolan_mapping::{GraphState, Node, Space3d};
use rayon::prelude::*;

use crate::belief::{MapError, Matrix6, Vector6, offset};
use crate::known_map::KnownMap;
use crate::known_map_3d::KnownMap3d;
use crate::scan_3d::Scan3d;
use crate::settings::maps::{
    LEAST_MAP_ERROR, MOST_CHANCE_FRACTION, MOST_MAP_ERROR, OWN_SCANS, USUAL_CHANCE_FRACTION, USUAL_MAP_ERROR,
};
use crate::settings::matching::NARROWEST_WINDOW;
use crate::settings::search::AROUND_PROPOSAL_3D;

/// Angle by which consecutive misplaced scans are rotated against each other (golden angle), radians.
const GOLDEN_ANGLE: f64 = 2.399_963;
/// Ratio of consecutive standard deviations that are tried.
const FINENESS: f64 = 1.05;
/// Median of the sum of squares of three standard normal variables.
const MEDIAN_OF_THREE: f64 = 2.366;
/// Information that is assumed in degenerate directions.
const NOTHING: f64 = 1e-6;

/// The scan of a node, and the pose in the map of the frame in which it is level.
fn scan_of(node: &Node) -> (Scan3d, Rigid3) {
    let level = KnownMap3d::local_from_scan(&node.map_from_tracking);
    let scan_from_tracking = to_f32(&(level.inverse() * node.map_from_tracking));
    let points = KnownMap3d::points_in_tracking(&node.data);
    (Scan3d::new(&points.transformed(&scan_from_tracking)), level)
}

/// Median fraction that the map explains of its own scans at wrong poses.
pub(crate) fn explained_by_chance(map: &KnownMap3d, state: &GraphState<Space3d>) -> f32 {
    let nodes: Vec<_> = state.nodes.values().collect();
    let misplaced = |k: usize| {
        let (here, there) = (k * nodes.len() / OWN_SCANS, (k * 7 + 1) * nodes.len() / OWN_SCANS / 2);
        let (node, other) = (nodes.get(here)?, nodes.get(there % nodes.len())?);
        let (scan, level) = scan_of(node);
        let turn = rotation_from_roll_pitch_yaw(0.0, 0.0, 1.0 + GOLDEN_ANGLE * k as f64);
        let mut guess = KnownMap3d::local_from_scan(&other.map_from_tracking);
        guess.rotation = turn * level.rotation;
        let pose = map.register(&scan.points, &guess, AROUND_PROPOSAL_3D);
        (!scan.judged.is_empty()).then(|| map.agreement_of(&scan.judged, &pose).explained)
    };
    let mut shares: Vec<f32> = (0..OWN_SCANS).into_par_iter().filter_map(misplaced).collect();
    shares.sort_by(f32::total_cmp);
    shares.get(shares.len() / 2).map_or(USUAL_CHANCE_FRACTION, |share| share.min(MOST_CHANCE_FRACTION))
}

/// Error of the map, measured by matching every other of its scans to planes made from the rest. It is the
/// variance, along and about each axis and in addition to the covariances of the matches, with which half of
/// the scans are within the median bound of their true poses (as Paule and Mandel 1982 estimate the variance
/// between laboratories, with the median for the mean).
pub(crate) fn error_of_own_scans(map: &KnownMap3d, state: &GraphState<Space3d>) -> MapError {
    let nodes: Vec<_> = state.nodes.values().skip(1).step_by(2).collect();
    let asked = OWN_SCANS.min(nodes.len());
    let found = |k: usize| {
        let (scan, level) = scan_of(nodes.get(k * nodes.len() / asked)?);
        let found = map.find(&scan, &level, NARROWEST_WINDOW);
        let covariance = (found.information + Matrix6::identity() * NOTHING).try_inverse()?;
        (!scan.judged.is_empty()).then(|| (offset(&level, &found.pose), covariance))
    };
    let found: Vec<(Vector6, Matrix6)> = (0..asked).into_par_iter().filter_map(found).collect();
    if found.is_empty() {
        return USUAL_MAP_ERROR;
    }
    let of_block = |first: usize, least: f64| {
        let block = |(offset, covariance): &(Vector6, Matrix6)| {
            (
                offset.fixed_rows::<3>(first).into_owned(),
                covariance.fixed_view::<3, 3>(first, first).into_owned(),
            )
        };
        unexplained(&found.iter().map(block).collect::<Vec<_>>(), least)
    };
    MapError { metres: of_block(0, LEAST_MAP_ERROR.metres), radians: of_block(3, LEAST_MAP_ERROR.radians) }
}

/// The smallest standard deviation along each axis, at least `least`, with which half of the offsets are
/// within the median bound.
fn unexplained(offsets: &[(Vector3, Matrix3<f64>)], least: f64) -> f64 {
    let half_is_within = |sigma: f64| {
        let more = Matrix3::identity() * (sigma * sigma);
        let is_within = |(offset, covariance): &&(Vector3, Matrix3<f64>)| {
            let inverse = (covariance + more).try_inverse();
            inverse.is_some_and(|inverse| offset.dot(&(inverse * offset)) < MEDIAN_OF_THREE)
        };
        2 * offsets.iter().filter(is_within).count() >= offsets.len()
    };
    let steps = (0..).map(|i| least * FINENESS.powi(i)).take_while(|sigma| *sigma < MOST_MAP_ERROR);
    steps.into_iter().find(|sigma| half_is_within(*sigma)).unwrap_or(MOST_MAP_ERROR)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Offsets at the quantiles of a normal distribution, combined along the three axes.
    fn offsets(sigma: f64) -> Vec<Vector3> {
        let normal = [-1.53, -0.89, -0.49, -0.16, 0.16, 0.49, 0.89, 1.53];
        let pairs = normal.into_iter().flat_map(|x| normal.map(|y| (x, y)));
        pairs.flat_map(|(x, y)| normal.map(|z| sigma * Vector3::new(x, y, z))).collect()
    }

    #[test]
    fn errors_not_explained_by_scans_are_those_of_the_map() {
        let with = |sigma: f64, known: f64| {
            let covariance = Matrix3::identity() * (known * known);
            let offsets: Vec<_> = offsets(sigma).into_iter().map(|offset| (offset, covariance)).collect();
            unexplained(&offsets, 0.005)
        };
        assert!((with(0.05, 0.01) - 0.05).abs() < 0.008, "{}", with(0.05, 0.01));
        assert!((with(0.05, 0.03) - 0.04).abs() < 0.008, "{}", with(0.05, 0.03));
        assert!((with(0.02, 0.03) - 0.005).abs() < 1e-9, "explained, and no map is better than that");
    }
}
