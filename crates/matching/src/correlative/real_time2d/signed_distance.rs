//! How near a scan lies to the surface of a distance field.

use super::*;
use crate::grid::Tsdf2d;

/// The first placement with the largest score.
///
/// A score is a ratio, Σ w·q / Σ w, which does not add up over points. But whether it can exceed some
/// known score s does: Σ w·(q − s) must be positive (Dinkelbach, "On nonlinear fractional programming",
/// 1967). So the bytes hold w·(q − s), where s is the best of a few placements tried first.
pub(super) fn best(
    tsdf: &Tsdf2d,
    tile: CellBox,
    mut scans: RotatedScans,
    window: SearchWindow,
    penalty: Penalty,
) -> Option<(f32, Placement)> {
    let exponent = max_exponent(&window);
    let nearness = Nearness { tsdf, tile, penalty };
    let known_score = (0..window.num_scans())
        .step_by(4)
        .chain([window.num_angular])
        .map(|scan| nearness.score(Placement { scan, x: 0, y: 0 }, &mut scans))
        .fold(0.0, f32::max);
    // A little less, so that rounding does not hide equal scores.
    let code = ExcessCode::new(tsdf, (f64::from(known_score) - 1e-4).max(0.0));
    let bytes: Vec<u8> = tile.cells().map(|c| code.encode(code.excess(tsdf, c))).collect();
    let (num_x, num_y) = (tile.num_x_cells() as usize, tile.num_y_cells() as usize);
    let pyramid = MaxPyramid::new(&bytes, num_x, num_y, exponent + 2, code.encode(0.0));
    let objective = CanExceed { nearness, code, num_points: scans.num_points() as f64 };
    let mut search = JointSearch::new(&pyramid, scans, window, ShiftBounds::Window, objective, exponent);
    let (score, placements) = search.run(f32::NEG_INFINITY);
    placements.first().map(|p| (score, *p))
}

/// The score itself.
struct Nearness<'a> {
    tsdf: &'a Tsdf2d,
    tile: CellBox,
    penalty: Penalty,
}

/// How near the surface a cell is, 1 on it and 0 at the truncation distance, and its weight.
fn nearness_and_weight(tsdf: &Tsdf2d, cell: CellIndex) -> (f32, f32) {
    let truncation = tsdf.truncation_distance();
    ((truncation - tsdf.signed_distance(cell).abs()) / truncation, tsdf.weight(cell))
}

impl Nearness<'_> {
    fn score(&self, placement: Placement, scans: &mut RotatedScans) -> f32 {
        let (x, y) = (placement.x + self.tile.min.x, placement.y + self.tile.min.y);
        let (mut sum, mut weights) = (0f32, 0f32);
        for cell in scans.cells_in_given_order(placement.scan) {
            let cell = CellIndex::new(cell[0] + x, cell[1] + y);
            let (nearness, weight) = nearness_and_weight(self.tsdf, cell);
            sum += nearness * weight;
            weights += weight;
        }
        let mean = if weights == 0.0 { 0.0 } else { sum / weights };
        (f64::from(mean) * self.penalty.factor(&placement)) as f32
    }
}

/// Codes w·(q − s) as bytes, rounded up.
struct ExcessCode {
    known_score: f64,
    lowest: f64,
    step: f64,
}

impl ExcessCode {
    fn new(tsdf: &Tsdf2d, known_score: f64) -> Self {
        let max_weight = f64::from(tsdf.max_weight());
        Self { known_score, lowest: -max_weight * known_score, step: max_weight / 255.0 }
    }

    fn excess(&self, tsdf: &Tsdf2d, cell: CellIndex) -> f64 {
        let (nearness, weight) = nearness_and_weight(tsdf, cell);
        f64::from(weight) * (f64::from(nearness) - self.known_score)
    }

    fn encode(&self, excess: f64) -> u8 {
        ((excess - self.lowest) / self.step).ceil() as u8
    }
}

/// Bounds the score by the known one wherever the sum says that it cannot be exceeded.
struct CanExceed<'a> {
    nearness: Nearness<'a>,
    code: ExcessCode,
    num_points: f64,
}

impl Objective for CanExceed<'_> {
    fn bound(&self, byte_sum: u32, region: &Region) -> f32 {
        let excess = self.num_points * self.code.lowest + f64::from(byte_sum) * self.code.step;
        let factor = self.nearness.penalty.largest_factor(region);
        let bound = if excess > 0.0 { 1.0 } else { self.code.known_score };
        (bound * factor) as f32
    }

    fn score(&self, placement: Placement, _byte_sum: u32, scans: &mut RotatedScans) -> f32 {
        self.nearness.score(placement, scans)
    }
}
