//! Symmetric sparse linear equations with blocks: storage, damping, Cholesky factorisation.

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SymbolicSupernodalParams;
use faer::sparse::linalg::cholesky::{simplicial, supernodal};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par};

use super::ProblemError;
use super::block_pattern::BlockPattern;

/// Pivots below this fraction of the diagonal are rounding, see [`BlockSystem::smallest_pivot_ratio`].
pub(crate) const SINGULAR_PIVOT: f64 = 1e-14;

/// Neighbouring columns of the factor up to so many are kept as one panel if this part of it would be zeros
/// at most. Blocks are panels already; the library's own rule would merge them over 80 % of zeros.
const RELAX: &[(usize, f64)] = &[(24, 0.1), (usize::MAX, 0.02)];

/// `A x = b` with a symmetric positive definite `A` of blocks, in the order of elimination. The pattern is
/// analysed once; the values are refilled as often as wanted without allocation.
pub(crate) struct BlockSystem {
    pub pattern: BlockPattern,
    /// Values in the layout of [`BlockPattern`].
    pub values: Vec<f64>,
    column_starts: Vec<u32>,
    row_indices: Vec<u32>,
    symbolic: supernodal::SymbolicSupernodalCholesky<u32>,
    factor: Vec<f64>,
    memory: MemBuffer,
    diagonal: Vec<f64>,
}

impl BlockSystem {
    /// Analyses the pattern of blocks of the given dimensions; `pairs` as for [`BlockPattern::new`].
    pub fn new(dimensions: &[u32], pairs: &[(u32, u32)]) -> Result<Self, ProblemError> {
        let pattern = BlockPattern::new(dimensions, pairs)?;
        let symbolic = analyse(&pattern)?;
        let (column_starts, row_indices) = pattern.scalar_lower();
        let request = StackReq::or(
            supernodal::factorize_supernodal_numeric_llt_scratch::<u32, f64>(
                &symbolic,
                Par::Seq,
                Default::default(),
            ),
            symbolic.solve_in_place_scratch::<f64>(1, Par::Seq),
        );
        let memory = MemBuffer::try_new(request).map_err(|_| ProblemError::OutOfMemory)?;
        Ok(Self {
            values: zeros(pattern.value_count())?,
            factor: zeros(symbolic.len_val())?,
            diagonal: vec![0.0; pattern.size()],
            pattern,
            column_starts,
            row_indices,
            symbolic,
            memory,
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

    /// Factorises the matrix with `damping` added to its diagonal; the values stay as they are. False when
    /// it is not positive definite.
    pub fn factorize(&mut self, damping: &[f64]) -> bool {
        let (values, diagonal) = (&mut self.values, &mut self.diagonal);
        Self::for_each_diagonal(&self.pattern, |i, at| {
            diagonal[i] = values[at];
            values[at] += damping[i];
        });
        let n = self.pattern.size();
        let pattern =
            SymbolicSparseColMatRef::new_checked(n, n, &self.column_starts, None, &self.row_indices);
        let result = supernodal::factorize_supernodal_numeric_llt(
            &mut self.factor,
            SparseColMatRef::new(pattern, &self.values),
            LltRegularization::default(),
            &self.symbolic,
            Par::Seq,
            MemStack::new(&mut self.memory),
            Default::default(),
        );
        let (values, diagonal) = (&mut self.values, &self.diagonal);
        Self::for_each_diagonal(&self.pattern, |i, at| values[at] = diagonal[i]);
        result.is_ok()
    }

    /// How well the worst determined unknown is determined, from 0 to 1: the smallest ratio of a squared pivot of the last
    /// factor to the diagonal entry without damping. It is the share of the information about an unknown that remains
    /// while those that come earlier in the elimination may move as well. Of a singular matrix rounding leaves about 1e-16.
    pub fn smallest_pivot_ratio(&self) -> f64 {
        let factor = supernodal::SupernodalLltRef::new(&self.symbolic, &self.factor);
        let mut smallest = f64::INFINITY;
        for index in 0..self.symbolic.n_supernodes() {
            let supernode = factor.supernode(index);
            let values = supernode.val();
            for k in 0..values.ncols() {
                let pivot = values[(k, k)];
                smallest = smallest.min(pivot * pivot / self.diagonal[supernode.start() + k]);
            }
        }
        smallest
    }

    /// Solves with the last factor, in place.
    pub fn solve(&mut self, x: &mut [f64]) {
        let n = self.pattern.size();
        let factor = supernodal::SupernodalLltRef::new(&self.symbolic, &self.factor);
        let rhs = MatMut::from_column_major_slice_mut(x, n, 1);
        factor.solve_in_place_with_conj(Conj::No, rhs, Par::Seq, MemStack::new(&mut self.memory));
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

fn zeros(count: usize) -> Result<Vec<f64>, ProblemError> {
    let mut values = Vec::new();
    values.try_reserve_exact(count).map_err(|_| ProblemError::OutOfMemory)?;
    values.resize(count, 0.0);
    Ok(values)
}

/// Elimination tree, column counts and supernodes of the factor.
fn analyse(pattern: &BlockPattern) -> Result<supernodal::SymbolicSupernodalCholesky<u32>, ProblemError> {
    let n = pattern.size();
    let (column_starts, row_indices) = pattern.scalar_upper();
    let upper = SymbolicSparseColMatRef::new_checked(n, n, &column_starts, None, &row_indices);
    let request = StackReq::or(
        simplicial::prefactorize_symbolic_cholesky_scratch::<u32>(n, row_indices.len()),
        supernodal::factorize_supernodal_symbolic_cholesky_scratch::<u32>(n),
    );
    let mut memory = MemBuffer::try_new(request).map_err(|_| ProblemError::OutOfMemory)?;
    let stack = MemStack::new(&mut memory);
    let (mut tree, mut counts) = (vec![0i32; n], vec![0u32; n]);
    let tree = simplicial::prefactorize_symbolic_cholesky(&mut tree, &mut counts, upper, stack);
    let params = SymbolicSupernodalParams { relax: Some(RELAX) };
    supernodal::factorize_supernodal_symbolic_cholesky(upper, tree, &counts, stack, params)
        .map_err(|_| ProblemError::TooLarge("factor"))
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
        // The diagonal blocks must be symmetric; only their lower part is stored for real.
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
    fn an_indefinite_matrix_is_told_and_the_values_survive() {
        let mut system = system();
        let before = system.values.clone();
        assert!(!system.factorize(&vec![-20.0; system.size()]));
        assert!(system.values.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-12));
        assert!(system.factorize(&vec![20.0; system.size()]));
    }
}
