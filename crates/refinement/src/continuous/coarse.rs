//! Coarse stages: windows are aligned by pairs of surfels, from far to near.

use portolan_geometry::Vector3;
use portolan_solver::NormalBlocks;

use super::correction::Corrections;
use super::motion_term::MotionTerm;
use super::pairs::{Pair, PlacedSurfel, find_pairs, place};
use super::surfels::SurfelMap;
use super::{DenseTrajectory, Knots};
use crate::RefineError;

/// Standard deviation of the distance of a pair, metres: patches of half a metre of the same wall in passes,
/// each accurate to a few centimetres; and neighbouring pairs have correlated errors.
const PAIR_DEVIATION: f64 = 0.15;
/// Addition to it for each metre between both along the surface: normals are not exact.
const TILT: f64 = 0.1;
/// Number of points with which a patch has half weight: furniture is confused with other furniture more often
/// than walls with other walls.
const HALF_COUNT: f64 = 40.0;

/// Difference of window numbers above which pairs count in the test of loop closure.
const FAR_APART: usize = 5;
/// Approximate distance up to which such pairs fit, metres.
const FITTING: f64 = 0.06;

/// Result of one iteration.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CoarseStep {
    pub pairs: usize,
    /// Root of the weighted mean square of the distances, metres.
    pub rms: f64,
    /// Largest shift of a knot, metres.
    pub shift: f64,
}

/// One Gauss–Newton step: pairs up to `gate` metres apart are searched anew (of windows at most `horizon`
/// numbers apart) and weighted (Geman–McClure with half of `gate`), and all knots are solved for at once.
pub(crate) fn coarse_step(
    map: &SurfelMap,
    corrections: &Corrections,
    trajectory: &mut DenseTrajectory,
    knots: &Knots,
    motion: &[MotionTerm],
    (gate, horizon): (f64, Option<usize>),
) -> Result<CoarseStep, RefineError> {
    let placed = place(map, corrections, trajectory);
    let pairs = find_pairs(map, &placed, gate, horizon);
    let mut equations = NormalBlocks::new(knots.count());
    let scale = 0.5 * gate;
    let (mut sum, mut weights) = (0.0, 0.0);
    for pair in &pairs {
        let robust = (scale * scale / (scale * scale + pair.distance * pair.distance)).powi(2);
        sum += robust * pair.distance * pair.distance;
        weights += robust;
        let row = pair_row(&placed, knots, pair);
        add(&mut equations, &row, pair.distance, robust * reliability(map, pair))?;
    }
    for term in motion {
        let i = term.knot();
        for (jacobian, residual, weight) in term.rows() {
            let part = |first: usize| std::array::from_fn(|k| jacobian[first + k]);
            add(&mut equations, &[(i, part(0)), (i + 1, part(6))], residual, weight)?;
        }
    }
    // The gauge: the first knot is fixed.
    equations.hold(0, 1e9);
    let failed = RefineError::Numerical("coarse step");
    let increment = equations.solve().map_err(|_| failed.clone())?.ok_or(failed)?;
    trajectory.apply(knots, &increment);
    let shift = (0..knots.count())
        .map(|k| Vector3::new(increment[6 * k], increment[6 * k + 1], increment[6 * k + 2]).norm())
        .fold(0.0, f64::max);
    Ok(CoarseStep { pairs: pairs.len(), rms: (sum / f64::max(weights, 1e-12)).sqrt(), shift })
}

/// Inverse variance of the distance of a pair.
fn reliability(map: &SurfelMap, pair: &Pair) -> f64 {
    let count = map.surfels[pair.a as usize].count.min(map.surfels[pair.b as usize].count);
    count / (count + HALF_COUNT) / (PAIR_DEVIATION.powi(2) + (TILT * pair.aside).powi(2))
}

/// Fraction of the pairs up to `gate` metres apart, of windows that are not neighbours, that fit together, 0
/// to 1, and their total weight.
pub(crate) fn agreement(
    map: &SurfelMap,
    corrections: &Corrections,
    trajectory: &DenseTrajectory,
    gate: f64,
) -> (f64, f64) {
    let placed = place(map, corrections, trajectory);
    let window = |surfel: u32| {
        let index = map.windows.partition_point(|w| w.surfels.end <= surfel as usize);
        map.windows[index].number
    };
    let (mut fitting, mut all) = (0.0, 0.0);
    for pair in find_pairs(map, &placed, gate, None) {
        if window(pair.a).abs_diff(window(pair.b)) > FAR_APART {
            let robust = (FITTING * FITTING / (FITTING * FITTING + pair.distance.powi(2))).powi(2);
            let weight = reliability(map, &pair) * PAIR_DEVIATION.powi(2);
            fitting += robust * weight;
            all += weight;
        }
    }
    (if all > 0.0 { fitting / all } else { 1.0 }, fitting)
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
fn pair_row(placed: &[PlacedSurfel], knots: &Knots, pair: &Pair) -> [(usize, [f64; 6]); 4] {
    let mut row = [(0, [0.0; 6]); 4];
    for (end, (surfel, sign)) in [(pair.a, 1.0), (pair.b, -1.0)].into_iter().enumerate() {
        let at = &placed[surfel as usize];
        let (knot, f) = knots.place(at.seconds);
        let n = pair.normal * sign;
        let lever = (at.mean - at.seen_from).cross(&n);
        let jacobian = [n.x, n.y, n.z, lever.x, lever.y, lever.z];
        row[2 * end] = (knot, jacobian.map(|v| v * (1.0 - f)));
        row[2 * end + 1] = (knot + 1, jacobian.map(|v| v * f));
    }
    row
}
