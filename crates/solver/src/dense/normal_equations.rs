//! The normal equations of a small problem.

use std::cmp::Ordering;

use nalgebra::{SMatrix, SVector};

/// `JᵀJ` and `Jᵀr`. Only the lower triangle of the matrix is read and written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalEquations<const N: usize> {
    /// `JᵀJ`, lower triangle.
    pub hessian: SMatrix<f64, N, N>,
    /// `Jᵀr`.
    pub gradient: SVector<f64, N>,
}

impl<const N: usize> Default for NormalEquations<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> NormalEquations<N> {
    /// Equations without residuals.
    pub fn new() -> Self {
        Self { hessian: SMatrix::zeros(), gradient: SVector::zeros() }
    }

    /// Adds one residual with its row of the Jacobian.
    #[inline]
    pub fn add(&mut self, residual: f64, row: &SVector<f64, N>) {
        for j in 0..N {
            self.gradient[j] += row[j] * residual;
            for i in j..N {
                self.hessian[(i, j)] += row[i] * row[j];
            }
        }
    }

    /// Adds the sums of another part of the problem.
    pub fn merge(&mut self, other: &Self) {
        self.hessian += other.hessian;
        self.gradient += other.gradient;
    }

    /// The full symmetric `JᵀJ`.
    pub fn symmetric_hessian(&self) -> SMatrix<f64, N, N> {
        SMatrix::from_fn(|i, j| if i >= j { self.hessian[(i, j)] } else { self.hessian[(j, i)] })
    }

    pub(super) fn is_finite(&self) -> bool {
        // Sums of products: any value that is not finite makes the sum not finite.
        (self.hessian.sum() + self.gradient.sum()).is_finite()
    }

    /// The equations for a Jacobian whose columns are multiplied by `scale`.
    pub(super) fn scaled(&self, scale: &SVector<f64, N>) -> Self {
        let mut scaled = *self;
        for j in 0..N {
            scaled.gradient[j] *= scale[j];
            for i in j..N {
                scaled.hessian[(i, j)] *= scale[i] * scale[j];
            }
        }
        scaled
    }

    /// `−(JᵀJ + D/radius)⁻¹ Jᵀr`, where D is the diagonal, limited to the bounds; `None` unless positive
    /// definite.
    pub(super) fn solve_damped(&self, radius: f64, (min, max): (f64, f64)) -> Option<SVector<f64, N>> {
        let mut damped = self.hessian;
        for i in 0..N {
            damped[(i, i)] += self.hessian[(i, i)].clamp(min, max) / radius;
        }
        let step = -cholesky_solve(damped, self.gradient)?;
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Decrease of the cost along `step` predicted by the linear model: `−(gᵀδ + ½ δᵀHδ)`.
    pub(super) fn model_cost_change(&self, step: &SVector<f64, N>) -> f64 {
        -step.dot(&(self.gradient + 0.5 * (self.symmetric_hessian() * step)))
    }
}

/// Solves `A x = b` for a positive definite `A` given by its lower triangle.
fn cholesky_solve<const N: usize>(
    mut a: SMatrix<f64, N, N>,
    mut b: SVector<f64, N>,
) -> Option<SVector<f64, N>> {
    for j in 0..N {
        for k in 0..j {
            for i in j..N {
                a[(i, j)] -= a[(i, k)] * a[(j, k)];
            }
        }
        if a[(j, j)].partial_cmp(&0.0) != Some(Ordering::Greater) {
            return None;
        }
        let pivot = a[(j, j)].sqrt();
        for i in j..N {
            a[(i, j)] /= pivot;
        }
    }
    for j in 0..N {
        b[j] /= a[(j, j)];
        for i in j + 1..N {
            b[i] -= a[(i, j)] * b[j];
        }
    }
    for j in (0..N).rev() {
        for i in j + 1..N {
            b[j] -= a[(i, j)] * b[i];
        }
        b[j] /= a[(j, j)];
    }
    Some(b)
}
