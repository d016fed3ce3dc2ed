//! Storage layout of the blocks of a symmetric sparse matrix.

use super::ProblemError;
use super::elimination_order::elimination_order;

/// The lower triangle of a symmetric matrix of blocks, in the order of elimination. The diagonal block of a
/// column (as a full square) and the blocks below it form one dense panel per block column:
/// `values[base + c·height + row]` for column `c` of the panel. This is also the ordinary compressed-column layout of the
/// scalar matrix, so the factorisation needs no copy.
pub(crate) struct BlockPattern {
    /// Position in the order of elimination of each block, by the caller's numbering.
    pub position: Vec<u32>,
    /// Size of each block, by position. All lists below are by position, too.
    pub dimensions: Vec<u32>,
    /// First scalar row of each block; at the end the number of rows.
    pub starts: Vec<u32>,
    /// Number of scalar rows in each block column.
    pub heights: Vec<u32>,
    /// Index of the first value of each block column; at the end the number of values.
    bases: Vec<u32>,
    /// Index of the first entry of each block column in `rows`.
    row_starts: Vec<u32>,
    /// Block rows below the diagonal, ascending, with the scalar row within the panel.
    rows: Vec<(u32, u32)>,
}

impl BlockPattern {
    /// Orders blocks of the given dimensions. `pairs` are the coupled blocks (smaller number first, sorted,
    /// unique).
    ///
    /// # Errors
    /// If there are more unknowns or values than 32 bits can count.
    pub fn new(dimensions: &[u32], pairs: &[(u32, u32)]) -> Result<Self, ProblemError> {
        let order = elimination_order(dimensions.len(), pairs);
        let n = order.len();
        let mut position = vec![0; n];
        for (new, old) in order.iter().enumerate() {
            position[*old as usize] = new as u32;
        }
        let permuted: Vec<u32> = order.iter().map(|old| dimensions[*old as usize]).collect();
        let mut starts = Vec::with_capacity(n + 1);
        let mut start = 0u32;
        for d in &permuted {
            starts.push(start);
            start = start.checked_add(*d).ok_or(ProblemError::TooLarge("unknowns"))?;
        }
        starts.push(start);
        let (row_starts, mut rows) = sort_into_columns(n, pairs, &position);
        let (mut heights, mut bases) = (Vec::with_capacity(n), Vec::with_capacity(n + 1));
        let mut base = 0u32;
        for column in 0..n {
            let mut height = permuted[column];
            for (row, offset) in &mut rows[row_starts[column] as usize..row_starts[column + 1] as usize] {
                *offset = height;
                height += permuted[*row as usize];
            }
            heights.push(height);
            bases.push(base);
            let size = u64::from(height) * u64::from(permuted[column]);
            base = u32::try_from(u64::from(base) + size)
                .map_err(|_| ProblemError::TooLarge("normal equations"))?;
        }
        bases.push(base);
        Ok(Self { position, dimensions: permuted, starts, heights, bases, row_starts, rows })
    }

    /// Number of blocks on the diagonal.
    pub fn block_count(&self) -> usize {
        self.dimensions.len()
    }

    /// Number of unknowns.
    pub fn size(&self) -> usize {
        self.starts.last().copied().unwrap_or_default() as usize
    }

    /// Number of stored values.
    pub fn value_count(&self) -> usize {
        self.bases.last().copied().unwrap_or_default() as usize
    }

    /// Index of the first value of the block column at a position.
    pub fn base(&self, column: usize) -> usize {
        self.bases[column] as usize
    }

    /// Blocks below the diagonal of a column: position and scalar row within the panel.
    pub fn rows(&self, column: usize) -> &[(u32, u32)] {
        &self.rows[self.row_starts[column] as usize..self.row_starts[column + 1] as usize]
    }

    /// Index of the first value of a block, `row ≥ column` by position.
    pub fn block_offset(&self, row: u32, column: u32) -> Option<u32> {
        let base = self.bases[column as usize];
        if row == column {
            return Some(base);
        }
        let rows = self.rows(column as usize);
        rows.binary_search_by_key(&row, |r| r.0).ok().map(|i| base + rows[i].1)
    }
}

/// Sorts pairs into block columns of the lower triangle in the new order, rows ascending; offsets are still
/// zero.
fn sort_into_columns(n: usize, pairs: &[(u32, u32)], position: &[u32]) -> (Vec<u32>, Vec<(u32, u32)>) {
    let place = |(a, b): &(u32, u32)| {
        let (a, b) = (position[*a as usize], position[*b as usize]);
        (a.min(b), a.max(b))
    };
    let mut starts = vec![0u32; n + 1];
    for pair in pairs {
        starts[place(pair).0 as usize + 1] += 1;
    }
    for i in 0..n {
        starts[i + 1] += starts[i];
    }
    let mut next = starts.clone();
    let mut rows = vec![(0, 0); pairs.len()];
    for pair in pairs {
        let (column, row) = place(pair);
        rows[next[column as usize] as usize] = (row, 0);
        next[column as usize] += 1;
    }
    for column in 0..n {
        rows[starts[column] as usize..starts[column + 1] as usize].sort_unstable();
    }
    (starts, rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coupled_blocks_have_a_place_below_the_diagonal() {
        let dimensions = [3, 1, 2, 3, 0];
        let pairs = [(0, 1), (0, 3), (1, 2), (2, 3)];
        let pattern = BlockPattern::new(&dimensions, &pairs).unwrap();
        assert_eq!(pattern.size(), 9);
        let squares: u32 = dimensions.iter().map(|d| d * d).sum();
        let products: u32 =
            pairs.iter().map(|(a, b)| dimensions[*a as usize] * dimensions[*b as usize]).sum();
        assert_eq!(pattern.value_count() as u32, squares + products);
        for (a, b) in pairs {
            let (a, b) = (pattern.position[a as usize], pattern.position[b as usize]);
            let (row, column) = (a.max(b), a.min(b));
            let offset = pattern.block_offset(row, column).unwrap() as usize - pattern.base(column as usize);
            assert!(offset >= pattern.dimensions[column as usize] as usize);
            assert!(offset < pattern.heights[column as usize] as usize);
        }
        assert_eq!(pattern.block_offset(0, 0), Some(0));
    }

    #[test]
    fn an_empty_pattern_is_valid() {
        let pattern = BlockPattern::new(&[], &[]).unwrap();
        assert_eq!((pattern.size(), pattern.value_count()), (0, 0));
    }
}
