//! Sums up measurements of the motion as a block-tridiagonal matrix over the knots.

use nalgebra::Matrix6;

use super::block_tridiagonal::BlockTridiagonal;
use super::motion_term::MotionTerm;
use super::unary_term::UnaryTerm;

/// Terms of the motion as a block-tridiagonal matrix and a gradient.
pub(crate) struct MotionBlocks {
    diagonal: Vec<[f64; 36]>,
    below: Vec<[f64; 36]>,
    /// `Jᵀ W e`.
    pub gradient: Vec<f64>,
}

impl MotionBlocks {
    pub fn new(terms: &[MotionTerm], moments: &[UnaryTerm], count: usize) -> Self {
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
    pub fn multiply(&self, x: &[f64], y: &mut [f64]) {
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

    /// A preconditioner: the matrix with the blocks of other terms (diagonal and below it, row-major 6×6)
    /// that `add` adds. None if it is not positive definite.
    pub fn preconditioner(
        &self,
        add: impl FnOnce(&mut [[f64; 36]], &mut [[f64; 36]]),
    ) -> Option<BlockTridiagonal> {
        let (mut diagonal, mut below) = (self.diagonal.clone(), self.below.clone());
        add(&mut diagonal, &mut below);
        // The pose of the whole is unconstrained, so a small stiffness is needed.
        let matrix = |block: &[f64; 36]| Matrix6::from_row_slice(block);
        let diagonal: Vec<Matrix6<f64>> =
            diagonal.iter().map(|b| matrix(b) + Matrix6::identity() * 1e-3).collect();
        BlockTridiagonal::factorize(&diagonal, below.iter().map(matrix).collect())
    }
}
