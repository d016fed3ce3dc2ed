//! Mean probability of the cells that a scan meets.

use super::*;
use crate::grid::ProbabilityGrid;
use crate::grid::value::{UNKNOWN_CELL, UPDATE_MARKER};

/// A byte stands for this many codes of a cell (a little more than 32767/255).
const CODES_PER_BYTE: f32 = 128.5;

/// The first placement with the largest score.
pub(super) fn best(
    grid: &ProbabilityGrid,
    tile: CellBox,
    scans: RotatedScans,
    window: SearchWindow,
    penalty: Penalty,
) -> Option<(f32, Placement)> {
    let exponent = max_exponent(&window);
    let bytes = upper_bounds(grid, tile);
    let pyramid =
        MaxPyramid::new(&bytes, tile.num_x_cells() as usize, tile.num_y_cells() as usize, exponent + 2, 0);
    let objective = MeanProbability { grid, tile, penalty, num_points: scans.num_points() as f32 };
    let mut search = JointSearch::new(&pyramid, scans, window, ShiftBounds::Window, objective, exponent);
    let (score, placements) = search.run(f32::NEG_INFINITY);
    placements.first().map(|p| (score, *p))
}

/// For every cell how far above the smallest probability it is at most, in steps of 128.5 codes.
fn upper_bounds(grid: &ProbabilityGrid, tile: CellBox) -> Vec<u8> {
    let width = tile.num_x_cells() as usize;
    let mut bytes = Vec::with_capacity(width * tile.num_y_cells() as usize);
    for y in tile.min.y..=tile.max.y {
        let start = grid.limits().flat_index(CellIndex::new(tile.min.x, y)).unwrap_or(0);
        let row = grid.cells().get(start..start + width).unwrap_or(&[]);
        bytes.extend(row.iter().map(|code| {
            let code = code & !UPDATE_MARKER;
            // Rounded up; unknown cells have the smallest probability of all.
            let steps = ((32767 - code) + 127) >> 7;
            if code == UNKNOWN_CELL { 0 } else { steps.min(255) as u8 }
        }));
    }
    bytes.resize(width * tile.num_y_cells() as usize, 0);
    bytes
}

struct MeanProbability<'a> {
    grid: &'a ProbabilityGrid,
    tile: CellBox,
    penalty: Penalty,
    num_points: f32,
}

impl Objective for MeanProbability<'_> {
    fn bound(&self, byte_sum: u32, region: &Region) -> f32 {
        let code = self.grid.code();
        let step = CODES_PER_BYTE * (code.upper() - code.lower()) / 32766.0;
        let lowest = (1.0 - code.upper()).max(crate::grid::value::MIN_PROBABILITY);
        let mean = lowest + step * (byte_sum as f32 / self.num_points);
        // Sums of single precision numbers drift; this is ample for any number of points.
        let rounding = 1e-6 * self.num_points.sqrt() + 1e-5;
        ((f64::from(mean) + f64::from(rounding)) * self.penalty.largest_factor(region)) as f32
    }

    fn score(&self, placement: Placement, _byte_sum: u32, scans: &mut RotatedScans) -> f32 {
        let (x, y) = (placement.x + self.tile.min.x, placement.y + self.tile.min.y);
        let mut sum = 0f32;
        for cell in scans.cells_in_given_order(placement.scan) {
            sum += self.grid.probability(CellIndex::new(cell[0] + x, cell[1] + y));
        }
        (f64::from(sum / self.num_points) * self.penalty.factor(&placement)) as f32
    }
}
