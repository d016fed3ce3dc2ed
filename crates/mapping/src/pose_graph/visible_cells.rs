//! Computes which cells of submaps remain visible where others overlap them.

use std::collections::{BTreeSet, HashMap};
use std::hash::Hash;

/// Visible cells of submaps that are stacked one after another, uppermost first: each cell is visible in the
/// first submaps that cover it, up to a given number.
pub(super) struct VisibleCells<C> {
    covering: HashMap<C, usize>,
    most: usize,
}

impl<C: Copy + Eq + Hash> VisibleCells<C> {
    /// With cells that are visible in at most this number of submaps.
    pub fn in_first(most: usize) -> Self {
        Self { covering: HashMap::new(), most }
    }

    /// The cells of the next submap that are visible in it, in order. It covers `covered` for those that come after it.
    pub fn next(&mut self, own: &BTreeSet<C>, covered: &BTreeSet<C>) -> Vec<C> {
        let is_visible = |cell: &&C| self.covering.get(*cell).copied().unwrap_or(0) < self.most;
        let visible = own.iter().filter(is_visible).copied().collect();
        covered.iter().for_each(|cell| *self.covering.entry(*cell).or_default() += 1);
        visible
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_is_visible_in_the_first_submaps_that_cover_it() {
        let mut visible = VisibleCells::in_first(2);
        let cells = |from: i32, to: i32| (from..to).collect::<BTreeSet<i32>>();
        assert_eq!(visible.next(&cells(0, 3), &cells(0, 3)), [0, 1, 2]);
        assert_eq!(visible.next(&cells(2, 4), &cells(1, 5)), [2, 3]);
        assert_eq!(visible.next(&cells(0, 6), &cells(0, 6)), [0, 3, 4, 5]);
        assert_eq!(visible.next(&cells(0, 6), &cells(0, 6)), [5]);
    }
}
