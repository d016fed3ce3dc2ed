//! Scores every placement, 32 shifts at a time.

use super::tile::{LANES, ROWS, Sums};
use super::*;

/// The first placement with the largest score. `mean` gives the mean values for 4 by 8 shifts of some cells.
pub(super) fn best(
    scans: &mut RotatedScans,
    window: &SearchWindow,
    penalty: &Penalty,
    mean: impl Fn(&[[i32; 2]], i32, i32) -> Sums,
) -> Option<(f32, Placement)> {
    let mut best = Best::above(f32::NEG_INFINITY);
    let n = window.num_linear;
    // Around the initial angle first: once there is a good score, most others are rejected at once.
    let mut order: Vec<i32> = (0..window.num_scans()).collect();
    order.sort_by_key(|k| (k - window.num_angular).abs());
    for scan in order {
        let region = Region { first: Placement { scan, x: -n, y: -n }, last: Placement { scan, x: n, y: n } };
        score_region(scans.cells_in_given_order(scan), &region, penalty, &mean, &mut best);
    }
    let (score, placements) = best.finish();
    placements.first().map(|p| (score, *p))
}

/// Scores all shifts of a region of one scan.
pub(super) fn score_region(
    cells: &[[i32; 2]],
    region: &Region,
    penalty: &Penalty,
    mean: impl Fn(&[[i32; 2]], i32, i32) -> Sums,
    best: &mut Best,
) {
    let (first, last) = (region.first, region.last);
    for y0 in (first.y..=last.y).step_by(ROWS) {
        for x0 in (first.x..=last.x).step_by(LANES) {
            let means = mean(cells, x0, y0);
            for (y, row) in (y0..=last.y).zip(&means) {
                for (x, mean) in (x0..=last.x).zip(row) {
                    // The penalty only takes away.
                    if best.is_promising(*mean) {
                        let placement = Placement { scan: first.scan, x, y };
                        let score = (f64::from(*mean) * penalty.factor(&placement)) as f32;
                        best.offer(placement, score);
                    }
                }
            }
        }
    }
}
