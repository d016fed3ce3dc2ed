//! Scores scans by the mean probability of the cells at their points.

use portolan_grids::ProbabilityGrid;
use portolan_grids::value::{MIN_PROBABILITY, UNKNOWN_CELL, UPDATE_MARKER, ValueCode};

use super::tile::Tile;
use super::*;

/// Number of codes of a cell per byte (a little more than 32767/255).
const CODES_PER_BYTE: f32 = 128.5;

/// Number of shifts scored in about the time of one look-up in the pyramid.
const SHIFTS_A_LOOKUP: u32 = 4;

/// The first placement with the largest score.
pub(super) fn best(
    grid: &ProbabilityGrid,
    part: CellBox,
    scans: RotatedScans,
    window: SearchWindow,
    penalty: Penalty,
) -> Option<(f32, Placement)> {
    let num_points = scans.num_points() as f32;
    let tile = tile(grid, part);
    if window.num_linear <= SMALL_WINDOW {
        return best_on(&tile, scans, window, penalty);
    }
    let bytes = upper_bounds(grid, part);
    let (num_x, num_y) = (part.num_x_cells() as usize, part.num_y_cells() as usize);
    let exponent = max_exponent(&window);
    let pyramid = MaxPyramid::new(&bytes, num_x, num_y, exponent + 1, 0);
    let objective = MeanProbability { tile, penalty, num_points, code: *grid.code() };
    let options = SearchOptions { max_exponent: exponent, leaf_exponent: LEAF_EXPONENT };
    let mut search = JointSearch::new(&pyramid, scans, window, ShiftBounds::Window, objective, options);
    let (score, placements) = search.run(f32::NEG_INFINITY);
    placements.first().map(|p| (score, *p))
}

/// The same in a small window, on the part of a grid whose cells the scans count from.
pub(super) fn best_on(
    tile: &Tile,
    mut scans: RotatedScans,
    window: SearchWindow,
    penalty: Penalty,
) -> Option<(f32, Placement)> {
    let num_points = scans.num_points() as f32;
    let mean = |cells: &[[i32; 2]], x: i32, y: i32| {
        tile.sums(cells, x, y).map(|row| row.map(|sum| sum / num_points))
    };
    exhaustive::best(&mut scans, &window, &penalty, mean)
}

fn row_of_codes(grid: &ProbabilityGrid, first: CellIndex, width: usize) -> &[u16] {
    let start = grid.limits().flat_index(first).unwrap_or(0);
    grid.cells().get(start..start + width).unwrap_or(&[])
}

/// The probability of every cell of a part of the grid.
pub(super) fn tile(grid: &ProbabilityGrid, part: CellBox) -> Tile {
    let code = *grid.code();
    Tile::new(part, MIN_PROBABILITY, |first, row| {
        let codes = row_of_codes(grid, first, row.len());
        for (value, cell) in row.iter_mut().zip(codes) {
            *value = 1.0 - code.decode(*cell, code.upper());
        }
    })
}

/// Upper bound for every cell of its probability above the smallest one, in steps of 128.5 codes.
fn upper_bounds(grid: &ProbabilityGrid, part: CellBox) -> Vec<u8> {
    let width = part.num_x_cells() as usize;
    let mut bytes = vec![0; width * part.num_y_cells() as usize];
    for (y, row) in (part.min.y..).zip(bytes.chunks_exact_mut(width)) {
        for (byte, code) in row.iter_mut().zip(row_of_codes(grid, CellIndex::new(part.min.x, y), width)) {
            let code = code & !UPDATE_MARKER;
            // Rounded up; unknown cells have the smallest probability of all.
            let steps = ((32767 - code) + 127) >> 7;
            *byte = if code == UNKNOWN_CELL { 0 } else { steps.min(255) as u8 };
        }
    }
    bytes
}

struct MeanProbability {
    tile: Tile,
    penalty: Penalty,
    num_points: f32,
    code: ValueCode,
}

impl Objective for MeanProbability {
    fn bound(&self, byte_sum: u32, region: &Region) -> f32 {
        let step = CODES_PER_BYTE * (self.code.upper() - self.code.lower()) / 32766.0;
        let lowest = (1.0 - self.code.upper()).max(MIN_PROBABILITY);
        let mean = lowest + step * (byte_sum as f32 / self.num_points);
        // Rounding error of a sum of single precision numbers.
        let rounding = 1e-7 * self.num_points + 1e-5;
        ((f64::from(mean) + f64::from(rounding)) * self.penalty.largest_factor(region)) as f32
    }

    fn score(&self, region: &Region, _byte_sum: u32, scans: &mut RotatedScans, best: &mut Best) {
        let (first, last) = (region.first, region.last);
        let shifts = (last.x - first.x + 1).unsigned_abs() * (last.y - first.y + 1).unsigned_abs();
        // Sums of neighbouring shifts are added up together.
        if !best.charge(scans.num_points() * shifts.div_ceil(SHIFTS_A_LOOKUP) as usize) {
            return;
        }
        let cells = scans.cells_in_given_order(region.first.scan);
        let mean = |cells: &[[i32; 2]], x: i32, y: i32| {
            self.tile.sums(cells, x, y).map(|row| row.map(|sum| sum / self.num_points))
        };
        exhaustive::score_region(cells, region, &self.penalty, mean, best);
    }
}
