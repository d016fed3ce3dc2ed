//! Fine stages: every knot is solved for, with all planes free, by preconditioned conjugate gradients.

use nalgebra::{DMatrix, Matrix6};
use portolan_geometry::Vector3;

use super::conjugate_gradients::{TIGHT, conjugate_gradients};
use super::correction::Corrections;
use super::information;
use super::motion_blocks::MotionBlocks;
use super::motion_term::MotionTerm;
use super::pairs::place;
use super::plane_equations::{PlaneEquations, State};
use super::planes::group;
use super::surfels::SurfelMap;
use super::unary_term::UnaryTerm;
use super::unknowns::{Bordered, PER_SENSOR, SensorIncrement, SensorUnknowns, blocks, dot, seven};
use super::{DenseTrajectory, Knots};
use crate::RefineError;

/// Result of one iteration.
#[derive(Clone, Debug)]
pub(crate) struct FineStep {
    pub clusters: usize,
    /// Root of the weighted mean square distance from the planes before the step, metres.
    pub rms: f64,
    /// Largest shift of a knot, metres.
    pub shift: f64,
    /// Information of the surfaces, second by second.
    pub information: Vec<Matrix6<f64>>,
    /// Increment of the knots.
    pub knots: Vec<f64>,
    /// Increments of the sensors that are calibrated.
    pub sensors: Vec<SensorIncrement>,
}

/// Input of a fine step.
pub(crate) struct FineProblem<'a> {
    pub map: &'a SurfelMap,
    pub corrections: &'a Corrections,
    pub trajectory: &'a DenseTrajectory,
    pub knots: &'a Knots,
    /// Measurements of the motion from knot to knot.
    pub motion: &'a [MotionTerm],
    /// Measurements at single times.
    pub moments: &'a [UnaryTerm],
    pub sensors: &'a SensorUnknowns,
    /// Distance that separates planes, metres.
    pub gap: f64,
    /// Tolerance of the solution: the fraction of the residual that may remain.
    pub tolerance: f64,
    /// Whether covariances of the sensors are computed.
    pub covariance: bool,
}

/// One Gauss–Newton step over all knots: surfels are grouped into planes at the current trajectory, clusters
/// are placed anew, and trajectory, planes and sensors are solved for together. The state is not changed.
pub(crate) fn fine_step(problem: &FineProblem) -> Result<FineStep, RefineError> {
    let FineProblem { map, corrections, trajectory, knots, sensors, .. } = *problem;
    let placed = place(map, corrections, trajectory);
    let groups = group(map, &placed, problem.gap);
    let state = State { map, placed: &placed, corrections, trajectory, knots, sensors };
    let equations = PlaneEquations::new(&state, &groups);
    let motion = MotionBlocks::new(problem.motion, problem.moments, knots.count());
    let size = 6 * knots.count();
    let prior = sensors.prior();
    let product = |x: &[f64], y: &mut [f64]| {
        y.fill(0.0);
        equations.multiply(x, y);
        motion.multiply(x, y);
        for (i, weight) in prior.iter().enumerate() {
            y[size + i] += weight * x[size + i];
        }
    };
    let columns: Vec<Vec<f64>> =
        (0..prior.len()).map(|i| column(size + i, size + prior.len(), product)).collect();
    let failed = RefineError::Numerical("fine step");
    let blocks = motion.preconditioner(|diagonal, below| equations.add_blocks(diagonal, below));
    let blocks = blocks.ok_or(failed.clone())?;
    let preconditioner = Bordered::new(blocks, columns.clone()).ok_or(failed.clone())?;
    let mut right = vec![0.0; size + prior.len()];
    equations.gradient(&mut right);
    for (r, g) in right.iter_mut().zip(&motion.gradient) {
        *r += g;
    }
    right.iter_mut().for_each(|r| *r = -*r);
    let increment = conjugate_gradients(&right, product, |x| preconditioner.solve(x), problem.tolerance);
    let wanted = (problem.covariance && !sensors.is_empty()).then_some(());
    let covariance = match wanted {
        Some(()) => Some(covariance(&columns, product, &preconditioner, &equations).ok_or(failed)?),
        None => None,
    };
    let sensors = sensor_increments(sensors, &increment[size..], covariance.as_ref());
    let shift =
        increment[..size].chunks_exact(6).map(|k| Vector3::new(k[0], k[1], k[2]).norm()).fold(0.0, f64::max);
    let information = equations.information(knots, information::SECONDS);
    let clusters = equations.clusters();
    let knots = increment[..size].to_vec();
    Ok(FineStep { clusters, rms: equations.rms, shift, information, knots, sensors })
}

fn column(index: usize, size: usize, product: impl Fn(&[f64], &mut [f64])) -> Vec<f64> {
    let (mut unit, mut column) = (vec![0.0; size], vec![0.0; size]);
    unit[index] = 1.0;
    product(&unit, &mut column);
    column
}

/// Covariance of the sensors' unknowns with everything else free: the inverse of `C − Bᵀ S⁻¹ B`.
fn covariance(
    columns: &[Vec<f64>],
    product: impl Fn(&[f64], &mut [f64]),
    preconditioner: &Bordered,
    equations: &PlaneEquations,
) -> Option<DMatrix<f64>> {
    let count = columns.len();
    let size = columns.first()?.len() - count;
    let knots_only = |x: &[f64], y: &mut [f64]| {
        let mut full = vec![0.0; size + count];
        let mut image = vec![0.0; size + count];
        full[..size].copy_from_slice(x);
        product(&full, &mut image);
        y.copy_from_slice(&image[..size]);
    };
    let solved: Vec<Vec<f64>> = columns
        .iter()
        .map(|c| conjugate_gradients(&c[..size], knots_only, |x| preconditioner.knots.solve(x), TIGHT))
        .collect();
    let rest = DMatrix::from_fn(count, count, |r, c| {
        let eliminated = dot(&columns[r][..size], &solved[c]) + dot(&columns[c][..size], &solved[r]);
        0.5 * (columns[r][size + c] + columns[c][size + r] - eliminated)
    });
    Some(rest.try_inverse()? * equations.variance_factor)
}

fn sensor_increments(
    sensors: &SensorUnknowns,
    values: &[f64],
    covariance: Option<&DMatrix<f64>>,
) -> Vec<SensorIncrement> {
    let covariances = covariance.map(blocks);
    let increment = |(i, sensor): (usize, &usize)| SensorIncrement {
        sensor: *sensor,
        value: seven(&values[PER_SENSOR * i..]),
        covariance: covariances.as_ref().map(|c| c[i]),
    };
    sensors.sensors.iter().enumerate().map(increment).collect()
}
