//! A part of a grid as plain numbers, and sums over it for many shifts at once.

use wide::f32x8;

use portolan_grids::{CellBox, CellIndex};

/// Shifts that are summed side by side, along x.
pub(super) const LANES: usize = 8;
/// Shifts that are summed side by side, along y.
pub(super) const ROWS: usize = 4;
/// Sums for shifts of 0…3 cells along y by 0…7 along x.
pub(super) type Sums = [[f32; LANES]; ROWS];

/// One number per cell of a box of cells, with a border as wide as the sums, so that every block of shifts
/// finds its values at any position.
pub(super) struct Tile {
    width: i32,
    height: i32,
    stride: usize,
    values: Vec<f32>,
}

impl Tile {
    /// The values of the cells of `part`, row by row, and one `outside` it.
    pub fn new(part: CellBox, outside: f32, mut row: impl FnMut(CellIndex, &mut [f32])) -> Self {
        let (width, height) = (part.num_x_cells() as usize, part.num_y_cells() as usize);
        let stride = width + 2 * LANES;
        let mut values = vec![outside; stride * (height + 2 * ROWS)];
        for (y, target) in (part.min.y..=part.max.y).zip(values.chunks_exact_mut(stride).skip(ROWS)) {
            row(CellIndex::new(part.min.x, y), &mut target[LANES..LANES + width]);
        }
        Self { width: width as i32, height: height as i32, stride, values }
    }

    /// For each shift of a block that starts at (`x`, `y`) the sum over all cells (relative to the first
    /// of the tile) of the values they meet, added up in the order of the cells.
    pub fn sums(&self, cells: &[[i32; 2]], x: i32, y: i32) -> Sums {
        let mut sums = [f32x8::ZERO; ROWS];
        let last_row = (ROWS - 1) * self.stride;
        for cell in cells {
            let column = cell[0].saturating_add(x).clamp(-(LANES as i32), self.width) + LANES as i32;
            let row = cell[1].saturating_add(y).clamp(-(ROWS as i32), self.height) + ROWS as i32;
            let start = row as usize * self.stride + column as usize;
            // One check for all rows; the border makes it always true.
            if let Some(block) = self.values.get(start..start + last_row + LANES) {
                for (sum, values) in sums.iter_mut().zip(block.chunks(self.stride)) {
                    if let Some(values) = values.first_chunk() {
                        *sum += f32x8::new(*values);
                    }
                }
            }
        }
        sums.map(|sum| sum.to_array())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_the_sums_of_their_shifts() {
        let part = CellBox { min: CellIndex::new(2, 3), max: CellIndex::new(12, 9) };
        let value = |x: i32, y: i32| {
            if part.extended(CellIndex::new(x, y)) == part { (x * 31 + y * 17) as f32 } else { -5.0 }
        };
        let tile = Tile::new(part, -5.0, |first, row| {
            row.iter_mut().zip(first.x..).for_each(|(v, x)| *v = value(x, first.y));
        });
        let cells = [[0, 0], [10, 6], [-3, 2], [5, -6], [i32::MAX, i32::MIN], [4, 3]];
        for (x, y) in (-12..12).flat_map(|x| (-9..9).map(move |y| (x, y))) {
            let sums = tile.sums(&cells, x, y);
            for (i, j) in (0..ROWS).flat_map(|i| (0..LANES).map(move |j| (i, j))) {
                let at = |c: &[i32; 2]| {
                    let [x, y] = [c[0].saturating_add(x), c[1].saturating_add(y)];
                    value(x.saturating_add(2 + j as i32), y.saturating_add(3 + i as i32))
                };
                assert_eq!(sums[i][j], cells.iter().map(at).sum::<f32>(), "{x} {y} {i} {j}");
            }
        }
    }
}
