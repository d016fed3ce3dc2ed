//! Map of points of vertical structures, for nearest-neighbour search.

use nalgebra as na;
use portolan_geometry::Point3f;

use super::cells::{Cells, key_of};
use crate::settings::PoleSettings;

/// Points of vertical structures around the scanner.
#[derive(Clone, Debug)]
pub struct PoleMap {
    cells: Cells<Vec<na::Vector3<f32>>>,
    settings: PoleSettings,
}

impl PoleMap {
    /// A map of points in metres, in a frame whose z axis points up.
    pub fn new(points: impl Iterator<Item = Point3f>, settings: &PoleSettings) -> Self {
        let mut cells = Cells::new(2.0 * settings.reach(), Vec::new());
        for point in points {
            let cell = cells.around(&point);
            cells.at_mut(key_of(cell)).push(point.coords);
        }
        Self { cells, settings: settings.clone() }
    }

    pub(super) fn settings(&self) -> &PoleSettings {
        &self.settings
    }

    /// The nearest point within the maximum distance.
    pub(super) fn nearest(&self, place: &na::Vector3<f32>) -> Option<na::Vector3<f32>> {
        let cell = self.cells.around(&Point3f::from(*place));
        // All points within it are in this cell or in the neighbours across its nearest sides.
        let side = |axis: usize| {
            let fraction = place[axis] / self.cells.edge - cell[axis] as f32;
            cell[axis].saturating_add(if fraction > 0.5 { 1 } else { -1 })
        };
        let [x, y, z] = [0, 1, 2].map(|axis| [cell[axis], side(axis)]);
        let (mut nearest, mut least) = (None, self.settings.reach().powi(2));
        for i in 0..8 {
            let key = key_of([x[i & 1], y[i >> 1 & 1], z[i >> 2]]);
            for point in self.cells.at(key).into_iter().flatten() {
                let off = point - place;
                let squared = off.norm_squared();
                if squared < least {
                    (nearest, least) = (Some(*point), squared);
                }
            }
        }
        nearest
    }
}
