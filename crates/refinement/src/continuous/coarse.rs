//! Coarse stages: windows are drawn together by pairs of surfels, from far to near.

use portolan_geometry::Vector3;
use portolan_solver::NormalBlocks;

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
    let mut equations = NormalBlocks::new(knots.count());
    let scale = 0.5 * gate;
    let (mut sum, mut weights) = (0.0, 0.0);
    for pair in &pairs {
        let robust = (scale * scale / (scale * scale + pair.distance * pair.distance)).powi(2);
        sum += robust * pair.distance * pair.distance;
        weights += robust;
        let row = pair_row(map, &placed, knots, pair);
        add(&mut equations, &row, pair.distance, robust / PAIR_DEVIATION.powi(2))?;
    }
    for (i, term) in odometry_terms(trajectory, knots, noise).iter().enumerate() {
        for (jacobian, residual, weight) in term.rows() {
            let part = |first: usize| std::array::from_fn(|k| jacobian[first + k]);
            add(&mut equations, &[(i, part(0)), (i + 1, part(6))], residual, weight)?;
        }
    }
    // The gauge: the first knot stays.
    equations.hold(0, 1e9);
    let failed = RefineError::Numerical("coarse step");
    let increment = equations.solve().map_err(|_| failed.clone())?.ok_or(failed)?;
    trajectory.apply(knots, &increment);
    let shift = (0..knots.count())
        .map(|k| Vector3::new(increment[6 * k], increment[6 * k + 1], increment[6 * k + 2]).norm())
        .fold(0.0, f64::max);
    Ok(CoarseStep { pairs: pairs.len(), rms: (sum / f64::max(weights, 1e-12)).sqrt(), shift })
}

fn add(
    equations: &mut NormalBlocks,
    row: &[(usize, [f64; 6])],
    residual: f64,
    weight: f64,
) -> Result<(), RefineError> {
    equations.add_row(row, residual, weight).map_err(|_| RefineError::Numerical("coarse step"))
}

/// The row of a pair: each end moves with the two knots around its time.
fn pair_row(map: &SurfelMap, placed: &[PlacedSurfel], knots: &Knots, pair: &Pair) -> [(usize, [f64; 6]); 4] {
    let mut row = [(0, [0.0; 6]); 4];
    for (end, (surfel, sign)) in [(pair.a, 1.0), (pair.b, -1.0)].into_iter().enumerate() {
        let at = &placed[surfel as usize];
        let (knot, f) = knots.place(map.surfels[surfel as usize].seconds);
        let n = pair.normal * sign;
        let lever = (at.mean - at.seen_from).cross(&n);
        let jacobian = [n.x, n.y, n.z, lever.x, lever.y, lever.z];
        row[2 * end] = (knot, jacobian.map(|v| v * (1.0 - f)));
        row[2 * end + 1] = (knot + 1, jacobian.map(|v| v * f));
    }
    row
}
