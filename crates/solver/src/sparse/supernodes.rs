//! Supernodes: adjacent columns of a factor with nearly the same rows, stored as dense panels.

use super::ProblemError;
use super::block_pattern::BlockPattern;
use super::fill::factor_rows;

/// Maximum width of a panel in columns, with the maximum fraction of zeros at which columns are still merged.
const RELAXED: [(usize, f64); 2] = [(24, 0.1), (usize::MAX, 0.02)];

/// Columns `first..end` of the factor as one panel, column by column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Supernode {
    pub first: usize,
    pub end: usize,
    /// Index of its first row in [`Supernodes::rows`]; its own columns come first.
    pub rows: usize,
    /// Number of rows.
    pub height: usize,
    /// Index of the first value of the panel.
    pub values: usize,
}

impl Supernode {
    pub fn width(&self) -> usize {
        self.end - self.first
    }

    pub fn panel(&self) -> std::ops::Range<usize> {
        self.values..self.values + self.height * self.width()
    }
}

/// The structure of the factor of a matrix of blocks.
pub(super) struct Supernodes {
    /// In the order of elimination.
    pub all: Vec<Supernode>,
    rows: Vec<u32>,
    /// The supernode of each column.
    pub of_column: Vec<u32>,
    /// Number of values of all panels.
    pub value_count: usize,
}

impl Supernodes {
    /// # Errors
    /// If there are more values than can be counted.
    pub fn new(pattern: &BlockPattern) -> Result<Self, ProblemError> {
        let n = pattern.block_count();
        let lower: Vec<Vec<u32>> =
            (0..n).map(|column| pattern.rows(column).iter().map(|(row, _)| *row).collect()).collect();
        let rows = factor_rows(n, |column| &lower[column]);
        let mut ranges: Vec<Range> = Vec::new();
        for column in 0..n {
            let mut own = Range::of(pattern, &rows, column);
            while let Some(before) = ranges.last()
                && let Some(together) = before.with(&own, pattern, &rows)
            {
                own = together;
                ranges.pop();
            }
            ranges.push(own);
        }
        let mut supernodes =
            Self { all: Vec::new(), rows: Vec::new(), of_column: vec![0; pattern.size()], value_count: 0 };
        // Blocks without unknowns have no columns.
        for range in ranges.into_iter().filter(|range| range.width > 0) {
            supernodes.add(pattern, &range, &rows[range.end - 1])?;
        }
        Ok(supernodes)
    }

    fn add(&mut self, pattern: &BlockPattern, range: &Range, below: &[u32]) -> Result<(), ProblemError> {
        let start = |block: usize| pattern.starts[block];
        let (first, end) = (start(range.first) as usize, start(range.end) as usize);
        let first_row = self.rows.len();
        self.rows.extend(start(range.first)..start(range.end));
        below.iter().for_each(|block| self.rows.extend(start(*block as usize)..start(*block as usize + 1)));
        let height = self.rows.len() - first_row;
        self.of_column[first..end].fill(self.all.len() as u32);
        self.all.push(Supernode { first, end, rows: first_row, height, values: self.value_count });
        let values = height.checked_mul(end - first).and_then(|size| self.value_count.checked_add(size));
        self.value_count = values.ok_or(ProblemError::TooLarge("factor"))?;
        Ok(())
    }

    /// The rows of a supernode, ascending; its own columns come first.
    pub fn rows(&self, supernode: &Supernode) -> &[u32] {
        &self.rows[supernode.rows..supernode.rows + supernode.height]
    }
}

/// Block columns `first..end` that may become one panel.
struct Range {
    first: usize,
    end: usize,
    width: usize,
    /// Number of structurally non-zero values of these columns on and below the diagonal.
    nonzeros: usize,
}

impl Range {
    fn of(pattern: &BlockPattern, rows: &[Vec<u32>], column: usize) -> Self {
        let width = pattern.dimensions[column] as usize;
        Self { first: column, end: column + 1, width, nonzeros: panel(width, height(pattern, &rows[column])) }
    }

    /// The merged range, if the first row of this range belongs to the later one and the merging adds few
    /// zeros.
    fn with(&self, later: &Self, pattern: &BlockPattern, rows: &[Vec<u32>]) -> Option<Self> {
        let parent = *rows[self.end - 1].first()? as usize;
        if !(later.first..later.end).contains(&parent) {
            return None;
        }
        let (width, nonzeros) = (self.width + later.width, self.nonzeros + later.nonzeros);
        let size = panel(width, height(pattern, &rows[later.end - 1]));
        let zeros = (size - nonzeros) as f64;
        let is_dense = RELAXED.iter().any(|(widest, share)| width <= *widest && zeros <= share * size as f64);
        is_dense.then_some(Self { first: self.first, end: later.end, width, nonzeros })
    }
}

/// Number of scalar rows of these blocks.
fn height(pattern: &BlockPattern, rows: &[u32]) -> usize {
    rows.iter().map(|row| pattern.dimensions[*row as usize] as usize).sum()
}

/// Number of values on and below the diagonal of a panel with `below` rows below its columns.
fn panel(width: usize, below: usize) -> usize {
    width * (width + 1) / 2 + width * below
}
