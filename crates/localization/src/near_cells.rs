//! A set of cells around a place, one bit each.

use portolan_grids::VoxelIndex;

/// Cells along each edge: a word holds those along x.
const EDGE: i32 = u128::BITS as i32;

/// Cells of a cube around a place. Those outside of it are never in the set.
#[derive(Clone, Debug)]
pub(crate) struct NearCells {
    first: VoxelIndex,
    /// One for each y and z, y by y.
    rows: Vec<u128>,
}

impl NearCells {
    /// Maximum difference between the indices of a cell in the set and those of the centre.
    pub const REACH: i32 = EDGE / 2 - 1;

    /// An empty set around a centre.
    pub fn around(place: VoxelIndex) -> Self {
        Self { first: place.map(|i| i.saturating_sub(EDGE / 2)), rows: vec![0; (EDGE * EDGE) as usize] }
    }

    /// Adds a cell.
    #[inline]
    pub fn insert(&mut self, cell: VoxelIndex) {
        if let Some((row, bit)) = self.place(cell)
            && let Some(row) = self.rows.get_mut(row)
        {
            *row |= bit;
        }
    }

    /// Whether a cell is in the set.
    #[inline]
    pub fn contains(&self, cell: VoxelIndex) -> bool {
        self.place(cell).is_some_and(|(row, bit)| self.rows.get(row).is_some_and(|row| row & bit != 0))
    }

    /// The set extended by two cells along each axis: axis by axis.
    #[must_use]
    pub fn dilated_by_two(&self) -> Self {
        let along_x = self.rows.iter().map(|row| row | row << 1 | row << 2 | row >> 1 | row >> 2);
        let rows = along_x.collect();
        let rows = joined(rows, 1);
        Self { first: self.first, rows: joined(rows, EDGE as usize) }
    }

    /// The cells in it.
    pub fn iter(&self) -> impl Iterator<Item = VoxelIndex> + '_ {
        let [x, y, z] = self.first;
        let filled = (0..).zip(&self.rows).filter(|(_, row)| **row != 0);
        filled.flat_map(move |(i, row)| {
            let in_row = (0..EDGE).filter(move |bit| row >> bit & 1 == 1);
            in_row.map(move |bit| [x + bit, y + i % EDGE, z + i / EDGE])
        })
    }

    /// The row of a cell, and its bit.
    #[inline]
    fn place(&self, cell: VoxelIndex) -> Option<(usize, u128)> {
        let ([x, y, z], [first_x, first_y, first_z]) = (cell, self.first);
        let from = |first: i32, index: i32| index.wrapping_sub(first) as u32;
        let (x, y, z) = (from(first_x, x), from(first_y, y), from(first_z, z));
        let edge = EDGE as u32;
        (x < edge && y < edge && z < edge).then(|| ((z * edge + y) as usize, 1 << x))
    }
}

/// Joins each row with those one and two steps before and after it, along y (a step of 1) or along z.
fn joined(rows: Vec<u128>, step: usize) -> Vec<u128> {
    let edge = EDGE as usize;
    let at = |i: usize, by: usize| {
        let along = i / step % edge;
        let row = |is_there: bool, i: usize| rows.get(i).filter(|_| is_there).copied().unwrap_or(0);
        let before = row(along >= by, i.wrapping_sub(by * step));
        before | row(along + by < edge, i + by * step)
    };
    rows.iter().enumerate().map(|(i, row)| row | at(i, 1) | at(i, 2)).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn near_cells_are_a_set_of_the_cells_within_reach() {
        let place = [40, -1000, 7];
        let (mut near, mut expected) = (NearCells::around(place), BTreeSet::new());
        let reach = NearCells::REACH;
        for i in 0..500 {
            let off = [i * 7919, i * 104_729, i * 31].map(|v: i32| v % (2 * reach + 1) - reach);
            let cell = [place[0] + off[0], place[1] + off[1], place[2] + off[2]];
            assert_eq!(near.contains(cell), expected.contains(&cell));
            near.insert(cell);
            expected.insert(cell);
        }
        near.insert([place[0] + 2 * reach, place[1], place[2]]);
        near.insert([i32::MIN, i32::MAX, 0]);
        assert_eq!(near.iter().collect::<BTreeSet<_>>(), expected);
    }

    #[test]
    fn neighbours_end_at_the_edges() {
        let reach = NearCells::REACH;
        for middle in [[0, 0, 0], [reach, 0, -reach], [reach - 1, reach, 1 - reach], [-reach - 1, -reach, 3]]
        {
            let mut near = NearCells::around([0; 3]);
            near.insert(middle);
            let mut expected = BTreeSet::new();
            let steps = || -2..=2;
            for off in steps().flat_map(|i| steps().flat_map(move |j| steps().map(move |k| [i, j, k]))) {
                let cell = [0, 1, 2].map(|axis| middle[axis] + off[axis]);
                if cell.iter().all(|i| (-reach - 1..=reach).contains(i)) {
                    expected.insert(cell);
                }
            }
            assert_eq!(near.dilated_by_two().iter().collect::<BTreeSet<_>>(), expected, "{middle:?}");
        }
    }
}
