//! A localised scan, as the cells in which its beams end and through which they pass.

use std::collections::BTreeSet;

use portolan_geometry::{Point3f, Rigid3, Time, Vector2, Vector3, project_2d};
use portolan_grids::{CellIndex, MapLimits};

use crate::settings::changes::{CHANGE_RANGE_2D, CLEARANCE};

/// A scan with a known pose in the map.
pub struct PlacedScan<'a> {
    /// When it was taken.
    pub time: Time,
    /// Where its beams begin, in the map.
    pub origin: Vector3,
    /// Pose of the local map in the map.
    pub map_from_local: Rigid3,
    /// Returns in the local map, metres.
    pub returns: &'a [Point3f],
}

impl PlacedScan<'_> {
    /// The cells in which beams end; cells may repeat.
    pub(crate) fn ends<'b>(&'b self, limits: &'b MapLimits) -> impl Iterator<Item = usize> + use<'b> {
        let near = self.beams().filter(|(_, length)| *length <= CHANGE_RANGE_2D);
        near.filter_map(|(beam, _)| cell_at(limits, &(self.origin.xy() + beam)))
    }

    /// The cells in which beams end and the cells around each of them.
    pub(crate) fn around_ends<'b>(&'b self, limits: &'b MapLimits) -> impl Iterator<Item = usize> + use<'b> {
        self.ends(limits).flat_map(move |cell| around_cell(limits, cell))
    }

    /// The cells through which beams pass well before their ends; cells may repeat.
    pub(crate) fn passed<'b>(&'b self, limits: &'b MapLimits) -> impl Iterator<Item = usize> + use<'b> {
        let (step, edge, max) = (0.5 * limits.resolution(), limits.resolution(), limits.max());
        // Columns run against y, rows against x. Both are measured in cells from the corner of the first
        // cell.
        let [first_x, first_y] = [max.y - self.origin.y, max.x - self.origin.x].map(|v| v / edge);
        self.beams().flat_map(move |(beam, length)| {
            let steps = ((length - CLEARANCE).min(CHANGE_RANGE_2D) / step).max(0.0) as u32;
            let [x, y] = [-beam.y, -beam.x].map(|v| v * step / (edge * length));
            let at = move |i| (first_x + f64::from(i) * x, first_y + f64::from(i) * y);
            (1..steps).map(at).filter_map(move |(x, y)| {
                // Coordinates before the first cell must not be rounded into it.
                let is_inside = x >= 0.0 && y >= 0.0;
                is_inside.then(|| limits.flat_index(CellIndex::new(x as i32, y as i32))).flatten()
            })
        })
    }

    /// Vectors from the origin to the ends of beams, seen from above, and their lengths.
    fn beams(&self) -> impl Iterator<Item = (Vector2, f64)> + use<'_> {
        let (to_map, origin) = (project_2d(&self.map_from_local).point_transform(), self.origin.xy());
        let beams = self.returns.iter().map(move |point| {
            let end = Vector2::new(f64::from(point.x), f64::from(point.y));
            let beam = to_map(&end) - origin;
            (beam, beam.norm())
        });
        beams.filter(|(_, length)| length.is_finite() && *length > 0.0)
    }
}

/// Cells and those around them.
pub(crate) fn around(limits: &MapLimits, cells: &BTreeSet<usize>) -> BTreeSet<usize> {
    cells.iter().flat_map(|cell| around_cell(limits, *cell)).collect()
}

/// A cell and those around it.
fn around_cell(limits: &MapLimits, cell: usize) -> impl Iterator<Item = usize> + use<'_> {
    let columns = limits.num_x_cells() as usize;
    let (x, y) = ((cell % columns) as i32, (cell / columns) as i32);
    let around = (-1..=1).flat_map(move |j| (-1..=1).map(move |i| CellIndex::new(x + i, y + j)));
    around.filter_map(|cell| limits.flat_index(cell))
}

fn cell_at(limits: &MapLimits, point: &Vector2) -> Option<usize> {
    limits.flat_index(limits.cell_index(point.cast::<f32>()))
}
