//! Fine stages: every knot is solved for, with all planes free, by preconditioned conjugate gradients.

use nalgebra::{DMatrix, Matrix6};
use portolan_geometry::Vector3;

use super::block_tridiagonal::BlockTridiagonal;
use super::correction::Corrections;
use super::information;
use super::motion_term::MotionTerm;
use super::pairs::place;
use super::plane_equations::{PlaneEquations, State};
use super::planes::group;
use super::surfels::SurfelMap;
use super::unary_term::UnaryTerm;
use super::unknowns::{Bordered, PER_SENSOR, SensorIncrement, SensorUnknowns, blocks, dot, seven};
use super::{DenseTrajectory, Knots};
use crate::RefineError;

/// The equations are solved until the residual has fallen to this share.
const TOLERANCE: f64 = 1e-3;
/// At most so many steps of conjugate gradients.
const MAX_STEPS: usize = 150;

/// How one iteration went.
#[derive(Clone, Debug)]
pub(crate) struct FineStep {
    pub clusters: usize,
    /// Root of the weighted mean square distance from the planes before the step, metres.
    pub rms: f64,
    /// Largest shift of a knot, metres.
    pub shift: f64,
    /// What the surfaces determine, second by second.
    pub information: Vec<Matrix6<f64>>,
    /// Increment of the knots.
    pub knots: Vec<f64>,
    /// Increments of the sensors that are calibrated.
    pub sensors: Vec<SensorIncrement>,
}

/// What a fine step works with.
pub(crate) struct FineProblem<'a> {
    pub map: &'a SurfelMap,
    pub corrections: &'a Corrections,
    pub trajectory: &'a DenseTrajectory,
    pub knots: &'a Knots,
    /// What is known of the motion from knot to knot.
    pub motion: &'a [MotionTerm],
    /// What is known of single moments.
    pub moments: &'a [UnaryTerm],
    pub sensors: &'a SensorUnknowns,
    /// A gap of so many metres separates planes.
    pub gap: f64,
    /// Whether covariances of the sensors are wanted.
    pub covariance: bool,
}

/// One Gauss–Newton step over all knots: surfels are grouped into planes at the current trajectory, clusters are placed
/// anew, and trajectory, planes and sensors are solved for together. Nothing is changed.
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
    let blocks = knot_blocks(&equations, &motion)?;
    let preconditioner = Bordered::new(blocks, columns.clone()).ok_or(failed.clone())?;
    let mut right = vec![0.0; size + prior.len()];
    equations.gradient(&mut right);
    for (r, g) in right.iter_mut().zip(&motion.gradient) {
        *r += g;
    }
    right.iter_mut().for_each(|r| *r = -*r);
    let increment = conjugate_gradients(&right, product, |x| preconditioner.solve(x));
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
        .map(|c| conjugate_gradients(&c[..size], knots_only, |x| preconditioner.knots.solve(x)))
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

/// Terms of the motion as a block-tridiagonal matrix and a gradient.
struct MotionBlocks {
    diagonal: Vec<[f64; 36]>,
    below: Vec<[f64; 36]>,
    gradient: Vec<f64>,
}

impl MotionBlocks {
    fn new(terms: &[MotionTerm], moments: &[UnaryTerm], count: usize) -> Self {
        let mut blocks = Self {
            diagonal: vec![[0.0; 36]; count],
            below: vec![[0.0; 36]; count - 1],
            gradient: vec![0.0; 6 * count],
        };
        for term in terms {
            let i = term.knot();
            for (jacobian, residual, weight) in term.rows() {
                for (gradient, j) in blocks.gradient[6 * i..].iter_mut().zip(jacobian) {
                    *gradient += weight * residual * j;
                }
                for r in 0..6 {
                    for c in 0..6 {
                        let at = 6 * r + c;
                        blocks.diagonal[i][at] += weight * jacobian[r] * jacobian[c];
                        blocks.diagonal[i + 1][at] += weight * jacobian[6 + r] * jacobian[6 + c];
                        blocks.below[i][at] += weight * jacobian[6 + r] * jacobian[c];
                    }
                }
            }
        }
        moments.iter().for_each(|moment| blocks.add_moment(moment));
        blocks
    }

    fn add_moment(&mut self, moment: &UnaryTerm) {
        let (i, f, w) = (moment.knot, moment.fraction, moment.weight);
        for (jacobian, residual) in &moment.rows {
            for r in 0..6 {
                self.gradient[6 * i + r] += w * (1.0 - f) * residual * jacobian[r];
                self.gradient[6 * i + 6 + r] += w * f * residual * jacobian[r];
                for c in 0..6 {
                    let (at, product) = (6 * r + c, w * jacobian[r] * jacobian[c]);
                    self.diagonal[i][at] += (1.0 - f) * (1.0 - f) * product;
                    self.diagonal[i + 1][at] += f * f * product;
                    self.below[i][at] += f * (1.0 - f) * product;
                }
            }
        }
    }

    /// `y += H x`.
    fn multiply(&self, x: &[f64], y: &mut [f64]) {
        for (i, block) in self.diagonal.iter().enumerate() {
            for r in 0..6 {
                let sum: f64 = (0..6).map(|c| block[6 * r + c] * x[6 * i + c]).sum();
                y[6 * i + r] += sum;
            }
        }
        for (i, block) in self.below.iter().enumerate() {
            for r in 0..6 {
                for c in 0..6 {
                    y[6 * i + 6 + r] += block[6 * r + c] * x[6 * i + c];
                    y[6 * i + c] += block[6 * r + c] * x[6 * i + 6 + r];
                }
            }
        }
    }
}

/// The block-tridiagonal part of the matrix over the knots, planes held.
fn knot_blocks(equations: &PlaneEquations, motion: &MotionBlocks) -> Result<BlockTridiagonal, RefineError> {
    let (mut diagonal, mut below) = (motion.diagonal.clone(), motion.below.clone());
    equations.add_blocks(&mut diagonal, &mut below);
    // Nothing is known about the place of the whole, so that a trace of stiffness is needed without planes.
    let matrix = |block: &[f64; 36]| Matrix6::from_row_slice(block);
    let diagonal: Vec<Matrix6<f64>> =
        diagonal.iter().map(|b| matrix(b) + Matrix6::identity() * 1e-3).collect();
    BlockTridiagonal::factorize(&diagonal, below.iter().map(matrix).collect())
        .ok_or(RefineError::Numerical("fine step"))
}

/// Solves `S x = right` (Hestenes and Stiefel 1952).
fn conjugate_gradients(
    right: &[f64],
    product: impl Fn(&[f64], &mut [f64]),
    precondition: impl Fn(&mut [f64]),
) -> Vec<f64> {
    let size = right.len();
    let mut x = vec![0.0; size];
    let mut residual = right.to_vec();
    let mut z = residual.clone();
    precondition(&mut z);
    let mut direction = z.clone();
    let mut rz = dot(&residual, &z);
    let goal = rz * TOLERANCE * TOLERANCE;
    let mut image = vec![0.0; size];
    for _ in 0..MAX_STEPS {
        if rz <= goal || rz <= 0.0 {
            return x;
        }
        product(&direction, &mut image);
        let curvature = dot(&direction, &image);
        if curvature <= 0.0 {
            return x;
        }
        let length = rz / curvature;
        for i in 0..size {
            x[i] += length * direction[i];
            residual[i] -= length * image[i];
        }
        z.copy_from_slice(&residual);
        precondition(&mut z);
        let next = dot(&residual, &z);
        let ratio = next / rz;
        rz = next;
        for i in 0..size {
            direction[i] = z[i] + ratio * direction[i];
        }
    }
    x
}
