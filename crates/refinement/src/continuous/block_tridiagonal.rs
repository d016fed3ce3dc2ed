//! Symmetric positive definite block-tridiagonal matrices with blocks of 6×6.

use nalgebra::{Cholesky, Const, Matrix6, Vector6};

/// Factorised matrix: the preconditioner of the fine stages.
pub(crate) struct BlockTridiagonal {
    /// Cholesky factors of the diagonal blocks after elimination.
    pivots: Vec<Cholesky<f64, Const<6>>>,
    /// Blocks below the diagonal.
    below: Vec<Matrix6<f64>>,
}

impl BlockTridiagonal {
    /// Factorises diagonal blocks and the blocks below them; none if the matrix is not positive definite.
    pub fn factorize(diagonal: &[Matrix6<f64>], below: Vec<Matrix6<f64>>) -> Option<Self> {
        let mut pivots: Vec<Cholesky<f64, Const<6>>> = Vec::with_capacity(diagonal.len());
        for (i, block) in diagonal.iter().enumerate() {
            let reduced = match pivots.last() {
                Some(previous) => {
                    let b = &below[i - 1];
                    block - b * previous.solve(&b.transpose())
                }
                None => *block,
            };
            pivots.push(Cholesky::new(reduced)?);
        }
        Some(Self { pivots, below })
    }

    /// Solves in place.
    pub fn solve(&self, x: &mut [f64]) {
        let count = self.pivots.len();
        let at = |x: &[f64], i: usize| Vector6::from_column_slice(&x[6 * i..6 * i + 6]);
        for i in 1..count {
            let reduced = at(x, i) - self.below[i - 1] * self.pivots[i - 1].solve(&at(x, i - 1));
            x[6 * i..6 * i + 6].copy_from_slice(reduced.as_slice());
        }
        for i in (0..count).rev() {
            let mut right = at(x, i);
            if i + 1 < count {
                right -= self.below[i].transpose() * at(x, i + 1);
            }
            let solution = self.pivots[i].solve(&right);
            x[6 * i..6 * i + 6].copy_from_slice(solution.as_slice());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_satisfy_the_equations() {
        let block =
            |seed: usize| Matrix6::from_fn(|r, c| ((r * 7 + c * 3 + seed * 5) % 11) as f64 / 11.0 - 0.5);
        let diagonal: Vec<Matrix6<f64>> =
            (0..5).map(|i| block(i) * block(i).transpose() + Matrix6::identity() * 6.0).collect();
        let below: Vec<Matrix6<f64>> = (0..4).map(|i| block(i + 9)).collect();
        let right: Vec<f64> = (0..30).map(|i| (i as f64).sin()).collect();
        let mut x = right.clone();
        BlockTridiagonal::factorize(&diagonal, below.clone()).unwrap().solve(&mut x);
        let at = |i: usize| Vector6::from_column_slice(&x[6 * i..6 * i + 6]);
        for i in 0..5 {
            let mut sum = diagonal[i] * at(i);
            if i > 0 {
                sum += below[i - 1] * at(i - 1);
            }
            if i < 4 {
                sum += below[i].transpose() * at(i + 1);
            }
            assert!((sum - Vector6::from_column_slice(&right[6 * i..6 * i + 6])).norm() < 1e-9);
        }
        assert!(BlockTridiagonal::factorize(&[-Matrix6::identity()], Vec::new()).is_none());
    }
}
