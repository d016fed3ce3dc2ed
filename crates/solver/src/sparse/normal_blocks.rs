//! Normal equations of 6×6 blocks that the caller accumulates row by row.

use std::collections::BTreeMap;

use super::block_system::BlockSystem;
use super::problem::ProblemError;

/// Size of a block.
const D: usize = 6;

/// Symmetric normal equations `H x = b` over unknowns of six numbers each (increments of poses). They are
/// accumulated from weighted rows and solved by sparse Cholesky factorisation. Meant for sums over very many
/// residuals, each of which a [`crate::Problem`] would store.
#[derive(Clone, Debug)]
pub struct NormalBlocks {
    /// Blocks on and below the diagonal, (row, column), row-major.
    blocks: BTreeMap<(u32, u32), [f64; D * D]>,
    right: Vec<f64>,
}

impl NormalBlocks {
    /// Equations for `count` unknowns, all zero.
    pub fn new(count: usize) -> Self {
        let diagonal = (0..count as u32).map(|i| ((i, i), [0.0; D * D]));
        Self { blocks: diagonal.collect(), right: vec![0.0; D * count] }
    }

    /// Adds `weight · (Σ J_i x_i + residual)²`: `row` contains the unknowns and their blocks of the Jacobian.
    /// An unknown may occur several times; its blocks are summed.
    ///
    /// # Errors
    /// Fails if an unknown does not exist.
    pub fn add_row(
        &mut self,
        row: &[(usize, [f64; D])],
        residual: f64,
        weight: f64,
    ) -> Result<(), ProblemError> {
        for (i, a) in row {
            let right = self.right.get_mut(D * i..D * i + D).ok_or(ProblemError::TooLarge("unknowns"))?;
            for (right, a) in right.iter_mut().zip(a) {
                *right -= weight * a * residual;
            }
            for (k, b) in row.iter().filter(|(k, _)| k <= i) {
                let block = self.blocks.entry((*i as u32, *k as u32)).or_insert([0.0; D * D]);
                for r in 0..D {
                    for c in 0..D {
                        block[D * r + c] += weight * a[r] * b[c];
                    }
                }
            }
        }
        Ok(())
    }

    /// Adds a block of the matrix (row ≥ column; row-major) directly.
    pub fn add_block(&mut self, row: usize, column: usize, values: &[f64; D * D]) {
        let block = self.blocks.entry((row as u32, column as u32)).or_insert([0.0; D * D]);
        for (block, value) in block.iter_mut().zip(values) {
            *block += value;
        }
    }

    /// Adds to the right-hand side of an unknown directly.
    pub fn add_right(&mut self, unknown: usize, values: &[f64; D]) {
        if let Some(right) = self.right.get_mut(D * unknown..D * unknown + D) {
            for (right, value) in right.iter_mut().zip(values) {
                *right += value;
            }
        }
    }

    /// Adds `weight` to the diagonal of an unknown, to keep it at its value.
    pub fn hold(&mut self, unknown: usize, weight: f64) {
        if let Some(block) = self.blocks.get_mut(&(unknown as u32, unknown as u32)) {
            for k in 0..D {
                block[D * k + k] += weight;
            }
        }
    }

    /// Solves the equations: six numbers for each unknown. `None` if the matrix is not positive definite,
    /// because some direction is not constrained by any row.
    ///
    /// # Errors
    /// Fails if the problem is too large for memory.
    pub fn solve(&self) -> Result<Option<Vec<f64>>, ProblemError> {
        let count = self.right.len() / D;
        let mut pairs: Vec<(u32, u32)> =
            self.blocks.keys().filter(|(r, c)| r != c).map(|(r, c)| (*c, *r)).collect();
        pairs.sort_unstable();
        let mut system = BlockSystem::new(&vec![D as u32; count], &pairs)?;
        for ((row, column), block) in &self.blocks {
            let (a, b) = (system.pattern.position[*row as usize], system.pattern.position[*column as usize]);
            let (low, high) = (a.max(b), a.min(b));
            let Some(offset) = system.pattern.block_offset(low, high) else { continue };
            let height = system.pattern.heights[high as usize] as usize;
            for r in 0..D {
                for c in 0..D {
                    // In the order of elimination the row and the column may be swapped.
                    let value = if a >= b { block[D * r + c] } else { block[D * c + r] };
                    system.values[offset as usize + c * height + r] = value;
                }
            }
        }
        let size = self.right.len();
        if !system.factorize(&vec![0.0; size]) {
            return Ok(None);
        }
        let start =
            |unknown: usize| system.pattern.starts[system.pattern.position[unknown] as usize] as usize;
        let mut ordered = vec![0.0; size];
        for unknown in 0..count {
            ordered[start(unknown)..start(unknown) + D]
                .copy_from_slice(&self.right[D * unknown..D * unknown + D]);
        }
        let starts: Vec<usize> = (0..count).map(start).collect();
        system.solve(&mut ordered);
        let mut solution = vec![0.0; size];
        for (unknown, start) in starts.into_iter().enumerate() {
            solution[D * unknown..D * unknown + D].copy_from_slice(&ordered[start..start + D]);
        }
        Ok(solution.iter().all(|v| v.is_finite()).then_some(solution))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn agrees_with_a_dense_solution() {
        let count = 7;
        let mut blocks = NormalBlocks::new(count);
        let (mut matrix, mut right) = (DMatrix::zeros(42, 42), DVector::zeros(42));
        for i in 0..200usize {
            let part = |s: usize| -> [f64; 6] {
                std::array::from_fn(|k| ((i * 31 + s * 17 + k * 13 + 1).pow(3) % 1009) as f64 / 504.0 - 1.0)
            };
            let row = [(i % count, part(1)), ((i * 5 + 2) % count, part(2)), ((i * 3 + 1) % count, part(3))];
            let (residual, weight) = ((i as f64).cos(), 1.0 + (i % 3) as f64);
            blocks.add_row(&row, residual, weight).unwrap();
            let mut dense = DVector::zeros(42);
            for (unknown, part) in row {
                for k in 0..6 {
                    dense[6 * unknown + k] += part[k];
                }
            }
            right -= &dense * (weight * residual);
            matrix += &dense * dense.transpose() * weight;
        }
        let expected = matrix.cholesky().unwrap().solve(&right);
        let found = blocks.solve().unwrap().unwrap();
        assert!((DVector::from_vec(found) - expected).norm() < 1e-8);
        assert!(NormalBlocks::new(2).solve().unwrap().is_none());
        assert!(blocks.add_row(&[(7, [0.0; 6])], 0.0, 1.0).is_err());
    }
}
