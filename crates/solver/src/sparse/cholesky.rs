//! Supernodal Cholesky factorisation of a sparse symmetric matrix of blocks.
//!
//! Left-looking, after Ng and Peyton: Block sparse Cholesky algorithms on advanced uniprocessor computers,
//! SIAM J. Sci. Comput. 14 (1993). Each panel is updated by all earlier panels that have rows in it, then it
//! is factorised as a dense matrix.

use super::ProblemError;
use super::block_pattern::BlockPattern;
use super::panel::{Columns, factorize, subtract_product};
use super::supernodes::{Supernode, Supernodes};

/// The factor `L` of `A = L Lᵀ`, with the work memory of a factorisation.
pub(super) struct Cholesky {
    supernodes: Supernodes,
    values: Vec<f64>,
    /// Row in the panel being computed, for each row of the matrix.
    place: Vec<u32>,
    /// Update from an earlier panel.
    product: Vec<f64>,
    /// Linked lists of the panels that still have to update each supernode: the first panel, and the next one
    /// after each panel.
    first_giver: Vec<u32>,
    next_giver: Vec<u32>,
    /// For each supernode the first row whose update has not been applied yet.
    given: Vec<u32>,
}

const NONE: u32 = u32::MAX;

impl Cholesky {
    /// Analyses the pattern.
    ///
    /// # Errors
    /// If the factor is too large for its indices, or for memory.
    pub fn new(pattern: &BlockPattern) -> Result<Self, ProblemError> {
        let supernodes = Supernodes::new(pattern)?;
        let count = supernodes.all.len();
        Ok(Self {
            values: zeros(supernodes.value_count)?,
            place: vec![0; pattern.size()],
            product: Vec::new(),
            first_giver: vec![NONE; count],
            next_giver: vec![NONE; count],
            given: vec![0; count],
            supernodes,
        })
    }

    /// Factorises the matrix with these values. Returns false if it is not positive definite.
    pub fn factorize(&mut self, pattern: &BlockPattern, values: &[f64]) -> bool {
        self.values.fill(0.0);
        self.first_giver.fill(NONE);
        for block in 0..pattern.block_count() {
            self.add_column(pattern, block, values);
        }
        for index in 0..self.supernodes.all.len() {
            let own = self.supernodes.all[index];
            for (i, row) in self.supernodes.rows(&own).iter().enumerate() {
                self.place[*row as usize] = i as u32;
            }
            let mut giver = std::mem::replace(&mut self.first_giver[index], NONE);
            while giver != NONE {
                let next = self.next_giver[giver as usize];
                self.give(giver as usize, &own);
                giver = next;
            }
            if !factorize(&mut self.values[own.panel()], own.height, own.width()) {
                return false;
            }
            self.given[index] = own.width() as u32;
            self.wait_for_next(index);
        }
        true
    }

    /// Copies a block column of the matrix into its panel.
    fn add_column(&mut self, pattern: &BlockPattern, block: usize, values: &[f64]) {
        let first = pattern.starts[block] as usize;
        let dimension = pattern.dimensions[block] as usize;
        let Some(owner) = self.supernodes.of_column.get(first).filter(|_| dimension > 0) else { return };
        let own = self.supernodes.all[*owner as usize];
        let height = pattern.heights[block] as usize;
        let rows = self.supernodes.rows(&own);
        let mut put = |row_block: usize, offset: usize| {
            let start = pattern.starts[row_block];
            let Ok(at) = rows.binary_search(&start) else { return };
            let size = pattern.dimensions[row_block] as usize;
            for column in 0..dimension {
                let from = &values[pattern.base(block) + column * height + offset..][..size];
                let to = own.values + (first - own.first + column) * own.height + at;
                self.values[to..to + size].copy_from_slice(from);
            }
        };
        put(block, 0);
        for (row, offset) in pattern.rows(block) {
            put(*row as usize, *offset as usize);
        }
    }

    /// Subtracts the update of an earlier panel from a panel.
    fn give(&mut self, giver: usize, own: &Supernode) {
        let from = self.supernodes.all[giver];
        let begin = self.given[giver] as usize;
        let rows = &self.supernodes.rows(&from)[begin..];
        let columns = rows.iter().take_while(|row| (**row as usize) < own.end).count();
        let (earlier, later) = self.values.split_at_mut(own.values);
        let giving = Columns { values: &earlier[from.panel()][begin..], stride: from.height };
        self.product.clear();
        self.product.resize(rows.len() * columns, 0.0);
        let size = (rows.len(), columns, from.width());
        subtract_product(&mut self.product, rows.len(), (giving, giving), size);
        let panel = &mut later[..own.height * own.width()];
        for (c, column) in rows[..columns].iter().enumerate() {
            let target = &mut panel[(*column as usize - own.first) * own.height..][..own.height];
            let product = &self.product[c * rows.len()..][..rows.len()];
            for i in c..rows.len().min(product.len()) {
                target[self.place[rows[i] as usize] as usize] += product[i];
            }
        }
        self.given[giver] += columns as u32;
        self.wait_for_next(giver);
    }

    /// Adds a panel to the list of the next supernode that it has to update.
    fn wait_for_next(&mut self, giver: usize) {
        let from = self.supernodes.all[giver];
        if let Some(row) = self.supernodes.rows(&from).get(self.given[giver] as usize) {
            let next = self.supernodes.of_column[*row as usize] as usize;
            self.next_giver[giver] = std::mem::replace(&mut self.first_giver[next], giver as u32);
        }
    }

    /// The diagonal of the factor.
    pub fn pivots(&self) -> impl Iterator<Item = f64> {
        let of_supernode = |own: &Supernode| {
            let (first, step) = (own.values, own.height + 1);
            (0..own.width()).map(move |k| first + k * step)
        };
        self.supernodes.all.iter().flat_map(of_supernode).map(|at| self.values[at])
    }

    /// Solves `L Lᵀ x = b` in place.
    pub fn solve(&mut self, x: &mut [f64]) {
        for own in &self.supernodes.all {
            let below = &self.supernodes.rows(own)[own.width()..];
            for (c, column) in self.values[own.panel()].chunks_exact(own.height).enumerate() {
                let value = x[own.first + c] / column[c];
                x[own.first + c] = value;
                let (within, rest) = column[c + 1..].split_at(own.width() - c - 1);
                x[own.first + c + 1..own.end].iter_mut().zip(within).for_each(|(x, l)| *x -= l * value);
                below.iter().zip(rest).for_each(|(row, l)| x[*row as usize] -= l * value);
            }
        }
        for own in self.supernodes.all.iter().rev() {
            let below = &self.supernodes.rows(own)[own.width()..];
            for (c, column) in self.values[own.panel()].chunks_exact(own.height).enumerate().rev() {
                let (within, rest) = column[c + 1..].split_at(own.width() - c - 1);
                let near: f64 = x[own.first + c + 1..own.end].iter().zip(within).map(|(x, l)| x * l).sum();
                let far: f64 = below.iter().zip(rest).map(|(row, l)| x[*row as usize] * l).sum();
                x[own.first + c] = (x[own.first + c] - near - far) / column[c];
            }
        }
    }
}

pub(super) fn zeros(count: usize) -> Result<Vec<f64>, ProblemError> {
    let mut values = Vec::new();
    values.try_reserve_exact(count).map_err(|_| ProblemError::OutOfMemory)?;
    values.resize(count, 0.0);
    Ok(values)
}
