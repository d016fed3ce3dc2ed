//! Symmetric sparse linear equations with blocks: storage, damping, Cholesky factorisation.

use super::ProblemError;
use super::block_pattern::BlockPattern;
use super::cholesky::{Cholesky, zeros};

/// Fraction of the diagonal below which a pivot is rounding; see [`BlockSystem::smallest_pivot_ratio`].
pub(crate) const SINGULAR_PIVOT: f64 = 1e-14;

/// `A x = b` with a symmetric positive definite matrix `A` of blocks, in the order of elimination. The
/// pattern is analysed once. The values can be refilled any number of times without allocation.
pub(crate) struct BlockSystem {
    pub pattern: BlockPattern,
    /// Values in the layout of [`BlockPattern`].
    pub values: Vec<f64>,
    factor: Cholesky,
    diagonal: Vec<f64>,
}

impl BlockSystem {
    /// Analyses the pattern of blocks of the given dimensions; `pairs` as for [`BlockPattern::new`].
    ///
    /// # Errors
    /// If the normal equations or their factor are too large for their indices, or for memory.
    pub fn new(dimensions: &[u32], pairs: &[(u32, u32)]) -> Result<Self, ProblemError> {
        let pattern = BlockPattern::new(dimensions, pairs)?;
        Ok(Self {
            values: zeros(pattern.value_count())?,
            factor: Cholesky::new(&pattern)?,
            diagonal: vec![0.0; pattern.size()],
            pattern,
        })
    }

    /// Number of unknowns.
    pub fn size(&self) -> usize {
        self.pattern.size()
    }

    /// Sets all values to zero.
    pub fn clear(&mut self) {
        self.values.fill(0.0);
    }

    /// Calls `f` with the number of each unknown and the index of its diagonal value.
    pub fn for_each_diagonal(pattern: &BlockPattern, mut f: impl FnMut(usize, usize)) {
        for column in 0..pattern.block_count() {
            let (start, height) = (pattern.starts[column] as usize, pattern.heights[column] as usize);
            for k in 0..pattern.dimensions[column] as usize {
                f(start + k, pattern.base(column) + k * (height + 1));
            }
        }
    }

    /// The diagonal of the matrix.
    pub fn diagonal(&self) -> Vec<f64> {
        let mut diagonal = vec![0.0; self.size()];
        Self::for_each_diagonal(&self.pattern, |i, at| diagonal[i] = self.values[at]);
        diagonal
    }

    /// Factorises the matrix with `damping` added to its diagonal; the values do not change. Returns false if
    /// the result is not positive definite.
    pub fn factorize(&mut self, damping: &[f64]) -> bool {
        let (values, diagonal) = (&mut self.values, &mut self.diagonal);
        Self::for_each_diagonal(&self.pattern, |i, at| {
            diagonal[i] = values[at];
            values[at] += damping[i];
        });
        let is_definite = self.factor.factorize(&self.pattern, &self.values);
        let (values, diagonal) = (&mut self.values, &self.diagonal);
        Self::for_each_diagonal(&self.pattern, |i, at| values[at] = diagonal[i]);
        is_definite
    }

    /// How well the least constrained unknown is constrained, from 0 to 1: the smallest ratio of a squared
    /// pivot of the last factor to the diagonal entry without damping. It is the fraction of the information
    /// about an unknown that remains if the unknowns eliminated before it are free. For a singular matrix
    /// rounding leaves about 1e-16.
    pub fn smallest_pivot_ratio(&self) -> f64 {
        let ratio = |(pivot, diagonal): (f64, &f64)| pivot * pivot / diagonal;
        self.factor.pivots().zip(&self.diagonal).map(ratio).fold(f64::INFINITY, f64::min)
    }

    /// Solves in place with the last factor.
    pub fn solve(&mut self, x: &mut [f64]) {
        self.factor.solve(x);
    }

    /// `y = A x`, without damping.
    pub fn multiply(&self, x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        let pattern = &self.pattern;
        for column in 0..pattern.block_count() {
            let (start, height) = (pattern.starts[column] as usize, pattern.heights[column] as usize);
            let dimension = pattern.dimensions[column] as usize;
            for c in 0..dimension {
                let panel = &self.values[pattern.base(column) + c * height..][..height];
                let (diagonal, below) = panel.split_at(dimension);
                let own = x[start + c];
                let mut sum = dot(diagonal, &x[start..start + dimension]);
                for (row, offset) in pattern.rows(column) {
                    let row_start = pattern.starts[*row as usize] as usize;
                    let d = pattern.dimensions[*row as usize] as usize;
                    let block = &below[*offset as usize - dimension..][..d];
                    sum += dot(block, &x[row_start..row_start + d]);
                    for (y, v) in y[row_start..row_start + d].iter_mut().zip(block) {
                        *y += v * own;
                    }
                }
                y[start + c] += sum;
            }
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of size 1 to 3 on a ring with chords, diagonally dominant.
    fn system() -> BlockSystem {
        let dimensions: Vec<u32> = (0..12).map(|i| 1 + i % 3).collect();
        let mut pairs: Vec<(u32, u32)> =
            (0..11).map(|i| (i, i + 1)).chain([(0, 11), (2, 7), (3, 9)]).collect();
        pairs.sort_unstable();
        let mut system = BlockSystem::new(&dimensions, &pairs).unwrap();
        let count = system.values.len();
        for (i, value) in system.values.iter_mut().enumerate() {
            *value = ((i * 7919 % count) as f64 / count as f64) - 0.5;
        }
        // The diagonal blocks must be symmetric; only their lower part is actually stored.
        let pattern = &system.pattern;
        for column in 0..pattern.block_count() {
            let (d, h) = (pattern.dimensions[column] as usize, pattern.heights[column] as usize);
            for c in 0..d {
                for r in 0..c {
                    system.values[pattern.base(column) + c * h + r] =
                        system.values[pattern.base(column) + r * h + c];
                }
            }
        }
        system
    }

    #[test]
    fn solutions_satisfy_the_damped_equations() {
        let mut system = system();
        let n = system.size();
        let damping = vec![8.0; n];
        assert!(system.factorize(&damping));
        let b: Vec<f64> = (0..n).map(|i| (i as f64).sin()).collect();
        let mut x = b.clone();
        system.solve(&mut x);
        let mut product = vec![0.0; n];
        system.multiply(&x, &mut product);
        for i in 0..n {
            assert!((product[i] + damping[i] * x[i] - b[i]).abs() < 1e-12);
        }
    }

    #[test]
    fn an_indefinite_matrix_is_reported_and_the_values_are_kept() {
        let mut system = system();
        let before = system.values.clone();
        assert!(!system.factorize(&vec![-20.0; system.size()]));
        assert!(system.values.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!(system.factorize(&vec![20.0; system.size()]));
    }
}
