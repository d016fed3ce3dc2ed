//! Condition number of the normal equations.

use super::block_system::SINGULAR_PIVOT;
use super::problem::{Problem, ProblemError};
use super::solve::Prepared;

/// Number of power iterations for each end of the spectrum.
const ITERATIONS: usize = 12;

impl Problem {
    /// Ratio of the largest to the smallest eigenvalue of `JᵀJ` scaled to a unit diagonal, at the current
    /// values. It is infinite if the matrix is singular, and `None` if there are no unknowns. Power iteration
    /// gives an estimate from below.
    pub(crate) fn condition_prepared(&self, prepared: &mut Prepared) -> Result<Option<f64>, ProblemError> {
        let Prepared { linearization, system } = prepared;
        let n = system.size();
        if n == 0 {
            return Ok(None);
        }
        let mut gradient = vec![0.0; n];
        if !linearization.linearize(self, &self.values, system, &mut gradient) {
            return Err(ProblemError::NotEvaluable);
        }
        let root: Vec<f64> = system.diagonal().iter().map(|d| d.sqrt()).collect();
        if root.contains(&0.0)
            || !system.factorize(&vec![0.0; n])
            || system.smallest_pivot_ratio() <= SINGULAR_PIVOT
        {
            return Ok(Some(f64::INFINITY));
        }
        // A start vector with all frequencies and without symmetry.
        let start: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7548776662466927).fract() - 0.5).collect();
        let mut product = vec![0.0; n];
        let largest = dominant(&start, |x| {
            x.iter_mut().zip(&root).for_each(|(x, r)| *x /= r);
            system.multiply(x, &mut product);
            x.iter_mut().zip(&product).zip(&root).for_each(|((x, p), r)| *x = p / r);
        });
        let inverse_smallest = dominant(&start, |x| {
            x.iter_mut().zip(&root).for_each(|(x, r)| *x *= r);
            system.solve(x);
            x.iter_mut().zip(&root).for_each(|(x, r)| *x *= r);
        });
        Ok(Some(largest * inverse_smallest))
    }
}

/// Largest eigenvalue of a positive operator.
fn dominant(start: &[f64], mut apply: impl FnMut(&mut [f64])) -> f64 {
    let mut x = start.to_vec();
    let mut norm = 0.0;
    for _ in 0..ITERATIONS {
        let scale = 1.0 / x.iter().map(|v| v * v).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        x.iter_mut().for_each(|v| *v *= scale);
        apply(&mut x);
        norm = x.iter().map(|v| v * v).sum::<f64>().sqrt();
    }
    norm
}
