//! Hybrid grids in the form of map files: four lists of equal length.

use super::value::{UNKNOWN_CELL, UPDATE_MARKER};
use super::{GridError, HybridGrid};

/// The known cells of a hybrid grid, one entry per cell in each list (`formats.md` §4.6).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HybridGridParts {
    /// Edge of a cell, metres.
    pub resolution: f32,
    /// First indices.
    pub x_indices: Vec<i32>,
    /// Second indices.
    pub y_indices: Vec<i32>,
    /// Third indices.
    pub z_indices: Vec<i32>,
    /// 16-bit codes of probabilities.
    pub values: Vec<i32>,
}

/// Repairs of the parts of a hybrid grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct HybridGridRepairs {
    /// Cells left out because their indices are outside −8192…8191.
    pub outside: usize,
    /// Cells left out because their value is no 16-bit code.
    pub invalid_values: usize,
    /// Cells that carried an update marker.
    pub markers_removed: usize,
    /// Cells given more than once; the last value counts.
    pub repeated: usize,
}

impl HybridGrid {
    /// The known cells in the order of map files.
    pub fn to_parts(&self) -> HybridGridParts {
        let list = || Vec::with_capacity(self.num_cells());
        let (mut x_indices, mut y_indices, mut z_indices, mut values) = (list(), list(), list(), list());
        self.for_each_cell(|[x, y, z], code| {
            x_indices.push(x);
            y_indices.push(y);
            z_indices.push(z);
            values.push(i32::from(code & !UPDATE_MARKER));
        });
        HybridGridParts { resolution: self.resolution(), x_indices, y_indices, z_indices, values }
    }

    /// The grid of these cells, given in any order, without spare memory. A value of 0 becomes 1, the
    /// least probable one, as in Cartographer.
    ///
    /// # Errors
    /// If the resolution is not positive and finite, or the lists have different lengths.
    pub fn from_parts(parts: &HybridGridParts) -> Result<(Self, HybridGridRepairs), GridError> {
        let mut grid = Self::new(parts.resolution)?;
        let count = parts.values.len();
        for (what, list) in [
            ("x indices", &parts.x_indices),
            ("y indices", &parts.y_indices),
            ("z indices", &parts.z_indices),
        ] {
            if list.len() != count {
                return Err(GridError::CellCount { what, expected: count as u64, found: list.len() });
            }
        }
        let mut repairs = HybridGridRepairs::default();
        let cells = parts.x_indices.iter().zip(&parts.y_indices).zip(&parts.z_indices);
        for (((x, y), z), value) in cells.zip(&parts.values) {
            let cell = [*x, *y, *z];
            let Ok(code) = u16::try_from(*value) else {
                repairs.invalid_values += 1;
                continue;
            };
            repairs.markers_removed += usize::from(code & UPDATE_MARKER != 0);
            repairs.repeated += usize::from(grid.is_known(cell));
            let known = (code & !UPDATE_MARKER).max(UNKNOWN_CELL + 1);
            repairs.outside += usize::from(!grid.set_code(cell, known));
        }
        Ok((grid.compacted(), repairs))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Lcg;

    #[test]
    fn parts_make_the_same_grid_again() {
        let (mut grid, mut lcg) = (HybridGrid::new(0.1).unwrap(), Lcg::new(17));
        for _ in 0..10_000 {
            let cell = [0; 3].map(|_| lcg.symmetric(3000.0) as i32);
            grid.set_probability(cell, 0.5 + lcg.symmetric(0.4));
        }
        let parts = grid.to_parts();
        assert_eq!(parts.values.len(), grid.num_cells());
        let (again, repairs) = HybridGrid::from_parts(&parts).unwrap();
        assert_eq!((&again, repairs), (&grid, HybridGridRepairs::default()));
        assert_eq!(again.to_parts(), parts);
    }

    #[test]
    fn invalid_cells_are_dropped_and_counted() {
        let mut parts = HybridGridParts {
            resolution: 0.1,
            x_indices: vec![0, 9000, 1, 2, 0, 3, 4],
            y_indices: vec![0; 7],
            z_indices: vec![0, 0, 0, 0, 0, i32::MIN, 0],
            values: vec![5, 6, -1, 32768 + 7, 9, 1, 0],
        };
        let (grid, repairs) = HybridGrid::from_parts(&parts).unwrap();
        let expected = HybridGridRepairs { outside: 2, invalid_values: 1, markers_removed: 1, repeated: 1 };
        assert_eq!(repairs, expected);
        assert_eq!([0, 1, 2, 4].map(|x| grid.code([x, 0, 0])), [9, 0, 7, 1]);
        parts.y_indices.pop();
        assert!(matches!(HybridGrid::from_parts(&parts), Err(GridError::CellCount { .. })));
        parts.resolution = -1.0;
        assert!(matches!(HybridGrid::from_parts(&parts), Err(GridError::InvalidResolution(_))));
    }
}
