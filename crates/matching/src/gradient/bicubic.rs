//! Bicubic interpolation of correspondence costs: cubic Hermite splines with central differences as
//! slopes (Catmull–Rom), first along the columns, then along the rows.

use portolan_grids::ProbabilityGrid;
use portolan_grids::value::{MAX_CORRESPONDENCE_COST, ValueCode};

/// A value with its derivatives along rows and columns, per cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Interpolated {
    pub value: f64,
    pub by_row: f64,
    pub by_column: f64,
}

/// The costs of a probability grid as a smooth function of place. Rows are the second cell index,
/// columns the first; coordinates are in cells, integers at cell centres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BicubicGrid<'a> {
    cells: &'a [u16],
    code: ValueCode,
    num_x_cells: i64,
    num_y_cells: i64,
}

/// Weights of four neighbouring samples at `t` ∈ [0, 1) between the middle two, and their derivatives.
#[inline]
fn weights(t: f64) -> ([f64; 4], [f64; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    let values = [
        0.5 * (-t + 2.0 * t2 - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (-t2 + t3),
    ];
    let slopes = [
        0.5 * (-1.0 + 4.0 * t - 3.0 * t2),
        0.5 * (-10.0 * t + 9.0 * t2),
        0.5 * (1.0 + 8.0 * t - 9.0 * t2),
        0.5 * (-2.0 * t + 3.0 * t2),
    ];
    (values, slopes)
}

#[inline]
fn dot(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])
}

impl<'a> BicubicGrid<'a> {
    pub fn new(grid: &'a ProbabilityGrid) -> Self {
        let limits = grid.limits();
        Self {
            cells: grid.cells(),
            code: *grid.code(),
            num_x_cells: i64::from(limits.num_x_cells()),
            num_y_cells: i64::from(limits.num_y_cells()),
        }
    }

    /// The cost at a place in cells.
    #[inline]
    pub fn evaluate(&self, row: f64, column: f64) -> Interpolated {
        let (row_floor, column_floor) = (row.floor(), column.floor());
        let (row_weights, row_slopes) = weights(row - row_floor);
        let (column_weights, column_slopes) = weights(column - column_floor);
        let first_row = (row_floor as i64).saturating_sub(1);
        let first_column = (column_floor as i64).saturating_sub(1);
        let (mut values, mut by_column) = ([0.0; 4], [0.0; 4]);
        for i in 0..4 {
            let samples = self.four_in_row(first_row.saturating_add(i as i64), first_column);
            values[i] = dot(&column_weights, &samples);
            by_column[i] = dot(&column_slopes, &samples);
        }
        Interpolated {
            value: dot(&row_weights, &values),
            by_row: dot(&row_slopes, &values),
            by_column: dot(&row_weights, &by_column),
        }
    }

    /// Costs of four cells of a row; the largest cost outside.
    #[inline]
    fn four_in_row(&self, row: i64, first: i64) -> [f64; 4] {
        if (0..self.num_y_cells).contains(&row) && first >= 0 && first + 4 <= self.num_x_cells {
            let start = (row * self.num_x_cells + first) as usize;
            if let Some(cells) = self.cells.get(start..start + 4) {
                return [cells[0], cells[1], cells[2], cells[3]].map(|c| self.decode(c));
            }
        }
        self.four_at_border(row, first)
    }

    #[cold]
    fn four_at_border(&self, row: i64, first: i64) -> [f64; 4] {
        [0, 1, 2, 3].map(|i| {
            let column = first.saturating_add(i);
            let inside = (0..self.num_y_cells).contains(&row) && (0..self.num_x_cells).contains(&column);
            match self.cells.get((row.saturating_mul(self.num_x_cells).saturating_add(column)) as usize) {
                Some(code) if inside => self.decode(*code),
                _ => f64::from(MAX_CORRESPONDENCE_COST),
            }
        })
    }

    #[inline]
    fn decode(&self, code: u16) -> f64 {
        f64::from(self.code.decode(code, self.code.upper()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::grid_g;

    #[test]
    fn cell_centres_keep_their_cost_and_slopes_are_derivatives() {
        let grid = grid_g();
        let smooth = BicubicGrid::new(&grid);
        for (row, column) in [(30.0, 40.0), (0.0, 0.0), (199.0, 159.0)] {
            let cell = portolan_grids::CellIndex::new(column as i32, row as i32);
            let value = smooth.evaluate(row, column).value;
            assert!((value - f64::from(grid.correspondence_cost(cell))).abs() < 1e-15);
        }
        for (row, column) in [(30.3, 40.9), (-0.7, 2.2), (100.5, 158.9), (1e18, -1e18), (-40.1, 10.0)] {
            let h = 1e-6;
            let at = smooth.evaluate(row, column);
            let f = |dr: f64, dc: f64| smooth.evaluate(row + dr, column + dc).value;
            assert!((at.by_row - (f(h, 0.0) - f(-h, 0.0)) / (2.0 * h)).abs() < 1e-8, "{row} {column}");
            assert!((at.by_column - (f(0.0, h) - f(0.0, -h)) / (2.0 * h)).abs() < 1e-8, "{row} {column}");
        }
        assert!((smooth.evaluate(-50.0, -50.0).value - f64::from(0.9f32)).abs() < 1e-7);
    }
}
