//! What stands upright in a map of space, seen from above, and what it tells to meet it there.

use nalgebra as na;
use portolan_geometry::{Point3f, Vector2, Vector3};
use portolan_grids::{CellIndex, Grid2d, MapLimits, ProbabilityGrid};
use portolan_matching::PlaceIndex2d;

use crate::known_map::KnownMapError;
use crate::spatial_map::NODES_AROUND;
use crate::spatial_scan::{COLUMN, upright_columns};

/// A column of the map stands if so many of its slices are solid.
const UPRIGHT: usize = 3;
/// Cells of the picture from above, at most: 1.2 km by 1.2 km; maps farther across get larger cells.
const MAX_CELLS: f64 = (1 << 24) as f64;
/// Probability of a cell in which something stands upright.
const STANDS: f32 = 0.9;
/// What a hit tells follows from how much stands within so many metres to each side, and is no more than this, nats.
const SURROUNDINGS: f64 = 6.0;
const MOST_TOLD: f64 = 3.0;

/// What stands upright, seen from above, as a picture in which all columns are alike, and as an index in which each counts as
/// much as it tells.
pub(crate) fn from_above(
    solid: &[Point3f],
    nodes: &[Vector3],
) -> Result<(Grid2d, PlaceIndex2d), KnownMapError> {
    let columns = upright_columns(solid.iter().copied(), UPRIGHT);
    let limits = limits_of(&columns)?;
    let cells: Vec<CellIndex> = columns.iter().map(|column| limits.cell_index(column.xy().coords)).collect();
    let mut picture = ProbabilityGrid::new(limits);
    cells.iter().for_each(|cell| {
        picture.set_probability(*cell, STANDS);
    });
    let crowd = Crowd::new(&limits, &cells);
    let told: Vec<(CellIndex, f32)> =
        cells.iter().map(|cell| (*cell, crowd.self_information(*cell))).collect();
    let index = PlaceIndex2d::of_cells(limits, &told, &around(nodes, &limits));
    Ok((Grid2d::Probability(picture), index))
}

/// Whether a node is near each cell.
fn around(nodes: &[Vector3], limits: &MapLimits) -> Vec<bool> {
    let mut is_near = vec![false; limits.num_cells()];
    let reach = (NODES_AROUND / limits.resolution()).ceil() as i32;
    for node in nodes {
        let middle = limits.cell_index(node.xy().cast::<f32>());
        for (x, y) in (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| (x, y))) {
            let cell = CellIndex::new(middle.x.saturating_add(x), middle.y.saturating_add(y));
            if let Some(near) = limits.flat_index(cell).and_then(|index| is_near.get_mut(index)) {
                *near = true;
            }
        }
    }
    is_near
}

fn limits_of(columns: &[Point3f]) -> Result<MapLimits, KnownMapError> {
    let first = columns.first().ok_or(KnownMapError::NoWalls)?;
    let (low, high) =
        columns.iter().fold((first.coords, first.coords), |(l, h), p| (l.inf(&p.coords), h.sup(&p.coords)));
    let size: na::Vector3<f64> = (high - low).cast();
    let mut resolution = f64::from(COLUMN);
    let cells = |length: f64, resolution: f64| (length / resolution).ceil() + 3.0;
    while cells(size.x, resolution) * cells(size.y, resolution) > MAX_CELLS {
        resolution *= 2.0;
    }
    let max = Vector2::new(f64::from(high.x) + 1.5 * resolution, f64::from(high.y) + 1.5 * resolution);
    let count = |length: f64| cells(length, resolution) as u32;
    Ok(MapLimits::new(resolution, max, count(size.y), count(size.x))?)
}

/// How many cells stand in squares around cells: sums over all that come before.
struct Crowd {
    width: usize,
    height: usize,
    reach: usize,
    sums: Vec<u32>,
}

impl Crowd {
    fn new(limits: &MapLimits, cells: &[CellIndex]) -> Self {
        let (width, height) = (limits.num_x_cells() as usize, limits.num_y_cells() as usize);
        let mut sums = vec![0_u32; (width + 1) * (height + 1)];
        for cell in cells {
            let (x, y) = (cell.x.max(0) as usize, cell.y.max(0) as usize);
            if let Some(sum) = sums.get_mut((y + 1) * (width + 1) + x + 1).filter(|_| x < width) {
                *sum = 1;
            }
        }
        let mut above = vec![0; width + 1];
        for row in sums.chunks_exact_mut(width + 1) {
            let mut of_row = 0;
            for (sum, above) in row.iter_mut().zip(&mut above) {
                of_row += *sum;
                *sum = of_row + *above;
                *above = *sum;
            }
        }
        Self { width, height, reach: (SURROUNDINGS / limits.resolution()).round() as usize, sums }
    }

    /// −ln of the share of the cells around one that stand, as a share of the most.
    fn self_information(&self, cell: CellIndex) -> f32 {
        let span = |middle: i32, size: usize| {
            let middle = middle.max(0) as usize;
            (middle.saturating_sub(self.reach), (middle + self.reach + 1).min(size))
        };
        let ((left, right), (low, high)) = (span(cell.x, self.width), span(cell.y, self.height));
        let before = |x: usize, y: usize| self.sums.get(y * (self.width + 1) + x).copied().unwrap_or(0);
        let standing = (before(right, high) + before(left, low)) - (before(left, high) + before(right, low));
        let side = 2.0 * self.reach as f64 + 1.0;
        let told = -(f64::from(standing.max(1)) / (side * side)).ln();
        (told.clamp(0.0, MOST_TOLD) / MOST_TOLD) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_post_by_itself_tells_more_than_one_of_a_wood() {
        let limits = MapLimits::new(0.3, Vector2::new(30.0, 30.0), 200, 200).unwrap();
        let wood = (30..90).flat_map(|x| (30..90).map(move |y| CellIndex::new(x, y)));
        let post = CellIndex::new(150, 150);
        let cells: Vec<CellIndex> = wood.filter(|cell| (cell.x + cell.y) % 3 == 0).chain([post]).collect();
        let crowd = Crowd::new(&limits, &cells);
        let [alone, among_others] = [post, CellIndex::new(60, 60)].map(|cell| crowd.self_information(cell));
        assert!((alone - 1.0).abs() < 1e-6, "{alone}");
        // A third of all cells: ln 3 of 3 nats.
        assert!((among_others - 3f32.ln() / 3.0).abs() < 0.01, "{among_others}");
    }
}
