//! A scan whose place in the map is known, as cells in which its beams end and through which they pass.

use std::collections::BTreeSet;

use portolan_geometry::{Point3f, Rigid3, Time, Vector2, Vector3, project_2d};
use portolan_grids::{CellIndex, MapLimits};

use crate::known_cells::CLEARANCE;

/// Beams count to this range, metres: headings of maps and matches err by 0.008 rad, a third of the clearance there.
const RANGE: f64 = 10.0;

/// A scan whose place is known.
pub struct PlacedScan<'a> {
    /// When it was taken.
    pub time: Time,
    /// Where its beams begin, in the map.
    pub origin: Vector3,
    /// Where the local map lies.
    pub map_from_local: Rigid3,
    /// Returns in the local map, metres.
    pub returns: &'a [Point3f],
}

impl PlacedScan<'_> {
    /// The cells in which beams end, some of them often.
    pub(crate) fn ends<'b>(&'b self, limits: &'b MapLimits) -> impl Iterator<Item = usize> + use<'b> {
        let near = self.beams().filter(|(_, length)| *length <= RANGE);
        near.filter_map(|(beam, _)| cell_at(limits, &(self.origin.xy() + beam)))
    }

    /// The same and the cells around each of them.
    pub(crate) fn around_ends<'b>(&'b self, limits: &'b MapLimits) -> impl Iterator<Item = usize> + use<'b> {
        self.ends(limits).flat_map(move |cell| around_cell(limits, cell))
    }

    /// The cells through which beams pass well before their ends, some of them often.
    pub(crate) fn passed<'b>(&'b self, limits: &'b MapLimits) -> impl Iterator<Item = usize> + use<'b> {
        let step = 0.5 * limits.resolution();
        self.beams().flat_map(move |(beam, length)| {
            let steps = ((length - CLEARANCE).min(RANGE) / step).max(0.0) as u32;
            let at = move |i| self.origin.xy() + beam * (f64::from(i) * step / length);
            (1..steps).filter_map(move |i| cell_at(limits, &at(i)))
        })
    }

    /// From the origin to the ends seen from above, and the lengths.
    fn beams(&self) -> impl Iterator<Item = (Vector2, f64)> + use<'_> {
        let (map_from_local, origin) = (project_2d(&self.map_from_local), self.origin.xy());
        let beams = self.returns.iter().map(move |point| {
            let end = Vector2::new(f64::from(point.x), f64::from(point.y));
            let beam = map_from_local.transform_point(&end) - origin;
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
