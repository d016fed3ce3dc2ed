//! Scores scans by their distance to the surface of a distance field.

use portolan_grids::Tsdf2d;

use super::tile::{LANES, ROWS, Tile};
use super::*;

/// The first placement with the largest score Σ w·q / Σ w, where q falls from 1 on the surface to 0 at
/// the truncation distance.
pub(super) fn best(
    tsdf: &Tsdf2d,
    part: CellBox,
    mut scans: RotatedScans,
    window: SearchWindow,
    penalty: Penalty,
) -> Option<(f32, Placement)> {
    let truncation = tsdf.truncation_distance();
    let tile = |value: &dyn Fn(CellIndex) -> f32| {
        Tile::new(part, 0.0, |first, row| {
            row.iter_mut().zip(first.x..).for_each(|(v, x)| *v = value(CellIndex::new(x, first.y)));
        })
    };
    let weights = tile(&|cell| tsdf.weight(cell));
    let nearness =
        tile(&|cell| (truncation - tsdf.signed_distance(cell).abs()) / truncation * tsdf.weight(cell));
    let mean = |cells: &[[i32; 2]], x: i32, y: i32| {
        let (mut sums, weights) = (nearness.sums(cells, x, y), weights.sums(cells, x, y));
        for (i, j) in (0..ROWS).flat_map(|i| (0..LANES).map(move |j| (i, j))) {
            sums[i][j] = if weights[i][j] == 0.0 { 0.0 } else { sums[i][j] / weights[i][j] };
        }
        sums
    };
    exhaustive::best(&mut scans, &window, &penalty, mean)
}
