//! Fine stages: every knot is solved for, with all planes free, by preconditioned conjugate gradients.

use nalgebra::Matrix6;
use portolan_geometry::Vector3;

use super::block_tridiagonal::BlockTridiagonal;
use super::information;
use super::odometry::{OdometryNoise, OdometryTerm, odometry_terms};
use super::pairs::place;
use super::plane_equations::PlaneEquations;
use super::planes::group;
use super::surfels::SurfelMap;
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
}

/// One Gauss–Newton step over all knots: surfels are grouped into planes at the current trajectory (a gap of
/// `gap` metres separates two), clusters are placed anew, and trajectory and planes are solved for together.
pub(crate) fn fine_step(
    map: &SurfelMap,
    trajectory: &mut DenseTrajectory,
    knots: &Knots,
    noise: OdometryNoise,
    gap: f64,
) -> Result<FineStep, RefineError> {
    let placed = place(map, trajectory);
    let groups = group(map, &placed, gap);
    let equations = PlaneEquations::new(map, &groups, &placed, trajectory, knots);
    let odometry = OdometryBlocks::new(&odometry_terms(trajectory, knots, noise));
    let preconditioner = preconditioner(&equations, &odometry)?;
    let mut right = vec![0.0; 6 * knots.count()];
    equations.gradient(&mut right);
    for (r, g) in right.iter_mut().zip(&odometry.gradient) {
        *r = -(*r + g);
    }
    let product = |x: &[f64], y: &mut [f64]| {
        y.fill(0.0);
        equations.multiply(x, y);
        odometry.multiply(x, y);
    };
    let increment = conjugate_gradients(&right, product, &preconditioner);
    trajectory.apply(knots, &increment);
    let shift = increment.chunks_exact(6).map(|k| Vector3::new(k[0], k[1], k[2]).norm()).fold(0.0, f64::max);
    let clusters = equations.clusters();
    let information = equations.information(knots, information::SECONDS);
    Ok(FineStep { clusters, rms: equations.rms, shift, information })
}

/// Odometry terms as a block-tridiagonal matrix and a gradient.
struct OdometryBlocks {
    diagonal: Vec<[f64; 36]>,
    below: Vec<[f64; 36]>,
    gradient: Vec<f64>,
}

impl OdometryBlocks {
    fn new(terms: &[OdometryTerm]) -> Self {
        let count = terms.len() + 1;
        let mut blocks = Self {
            diagonal: vec![[0.0; 36]; count],
            below: vec![[0.0; 36]; terms.len()],
            gradient: vec![0.0; 6 * count],
        };
        for (i, term) in terms.iter().enumerate() {
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
        blocks
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

fn preconditioner(
    equations: &PlaneEquations,
    odometry: &OdometryBlocks,
) -> Result<BlockTridiagonal, RefineError> {
    let (mut diagonal, mut below) = (odometry.diagonal.clone(), odometry.below.clone());
    equations.add_blocks(&mut diagonal, &mut below);
    // Nothing is known about the place of the whole, so that a trace of stiffness is needed without planes.
    let matrix = |block: &[f64; 36]| Matrix6::from_row_slice(block);
    let diagonal: Vec<Matrix6<f64>> =
        diagonal.iter().map(|b| matrix(b) + Matrix6::identity() * 1e-3).collect();
    BlockTridiagonal::factorize(&diagonal, below.iter().map(matrix).collect())
        .ok_or(RefineError::Numerical("fine step"))
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Solves `S x = right` (Hestenes and Stiefel 1952).
fn conjugate_gradients(
    right: &[f64],
    product: impl Fn(&[f64], &mut [f64]),
    preconditioner: &BlockTridiagonal,
) -> Vec<f64> {
    let size = right.len();
    let mut x = vec![0.0; size];
    let mut residual = right.to_vec();
    let mut z = residual.clone();
    preconditioner.solve(&mut z);
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
        preconditioner.solve(&mut z);
        let next = dot(&residual, &z);
        let ratio = next / rz;
        rz = next;
        for i in 0..size {
            direction[i] = z[i] + ratio * direction[i];
        }
    }
    x
}
