//! Coarse stages: windows are drawn together by pairs of surfels, from far to near.

use nalgebra::{DMatrix, DVector};
use portolan_geometry::Vector3;

use super::odometry::{OdometryNoise, odometry_terms};
use super::pairs::{Pair, PlacedSurfel, find_pairs, place};
use super::surfels::SurfelMap;
use super::{DenseTrajectory, Knots};
use crate::RefineError;

/// Standard deviation of the distance of a pair, metres: patches of half a metre of the same wall in passes
/// through it that are each good to a few centimetres.
const PAIR_DEVIATION: f64 = 0.05;

/// How one iteration went.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CoarseStep {
    pub pairs: usize,
    /// Root of the weighted mean square of the distances, metres.
    pub rms: f64,
    /// Largest shift of a knot, metres.
    pub shift: f64,
}

/// One Gauss–Newton step: pairs are searched anew, weighted (Geman–McClure with the given scale), and all
/// knots are solved for at once.
pub(crate) fn coarse_step(
    map: &SurfelMap,
    trajectory: &mut DenseTrajectory,
    knots: &Knots,
    noise: OdometryNoise,
    gate: f64,
) -> Result<CoarseStep, RefineError> {
    let placed = place(map, trajectory);
    let pairs = find_pairs(map, &placed, gate);
    let size = 6 * knots.count();
    let (mut matrix, mut vector) = (DMatrix::zeros(size, size), DVector::zeros(size));
    let scale = 0.5 * gate;
    let (mut sum, mut weights) = (0.0, 0.0);
    for pair in &pairs {
        let robust = (scale * scale / (scale * scale + pair.distance * pair.distance)).powi(2);
        sum += robust * pair.distance * pair.distance;
        weights += robust;
        add_pair(&mut matrix, &mut vector, map, &placed, knots, pair, robust / PAIR_DEVIATION.powi(2));
    }
    for (i, term) in odometry_terms(trajectory, knots, noise).iter().enumerate() {
        for (jacobian, residual, weight) in term.rows() {
            for r in 0..12 {
                vector[6 * i + r] -= weight * jacobian[r] * residual;
                for c in 0..12 {
                    matrix[(6 * i + r, 6 * i + c)] += weight * jacobian[r] * jacobian[c];
                }
            }
        }
    }
    // The gauge: the first knot stays.
    for k in 0..6 {
        matrix[(k, k)] += 1e12;
    }
    let factor = matrix.cholesky().ok_or(RefineError::Numerical("coarse step"))?;
    let increment = factor.solve(&vector);
    trajectory.apply(knots, increment.as_slice());
    let shift = (0..knots.count())
        .map(|k| Vector3::new(increment[6 * k], increment[6 * k + 1], increment[6 * k + 2]).norm())
        .fold(0.0, f64::max);
    Ok(CoarseStep { pairs: pairs.len(), rms: (sum / f64::max(weights, 1e-12)).sqrt(), shift })
}

fn add_pair(
    matrix: &mut DMatrix<f64>,
    vector: &mut DVector<f64>,
    map: &SurfelMap,
    placed: &[PlacedSurfel],
    knots: &Knots,
    pair: &Pair,
    weight: f64,
) {
    let mut columns = [(0usize, [0.0; 6]); 4];
    for (end, (surfel, sign)) in [(pair.a, 1.0), (pair.b, -1.0)].into_iter().enumerate() {
        let at = &placed[surfel as usize];
        let (knot, f) = knots.place(map.surfels[surfel as usize].seconds);
        let lever = (at.mean - at.seen_from).cross(&pair.normal) * sign;
        let n = pair.normal * sign;
        let row = [n.x, n.y, n.z, lever.x, lever.y, lever.z];
        columns[2 * end] = (knot, row.map(|v| v * (1.0 - f)));
        columns[2 * end + 1] = (knot + 1, row.map(|v| v * f));
    }
    for (i, a) in &columns {
        for r in 0..6 {
            let scaled = weight * a[r];
            vector[6 * i + r] -= scaled * pair.distance;
            for (k, b) in &columns {
                for c in 0..6 {
                    matrix[(6 * i + r, 6 * k + c)] += scaled * b[c];
                }
            }
        }
    }
}
