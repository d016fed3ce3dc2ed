//! Finds where the thickness of walls changed most between two clouds of the same points.

use portolan_geometry::Vector3;
use portolan_spatial::{Moments, PlaneFit, VoxelHash};
use serde::Serialize;

/// Minimum number of points in a cell.
const LEAST_POINTS: f64 = 40.0;

/// The points in one cell of the second cloud, at their positions in both clouds.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    before: Moments,
    after: Moments,
}

/// Collects the points of two clouds cell by cell.
#[derive(Clone, Debug)]
pub struct WallChanges {
    edge: f64,
    cells: VoxelHash<Cell>,
}

/// A piece of wall whose thickness changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WallChange {
    /// Mean of its points in the second cloud, metres.
    pub place: [f64; 3],
    /// Unit normal of the wall in the cloud in which it is thinner.
    pub normal: [f64; 3],
    /// Standard deviation across the wall in the first cloud, metres.
    pub before: f64,
    /// The same in the second cloud.
    pub after: f64,
    /// Number of points.
    pub points: u64,
}

impl WallChanges {
    /// No points yet; `edge` is the edge of the cells in the second cloud, metres.
    pub fn new(edge: f64) -> Self {
        Self { edge: if edge > 0.0 { edge } else { 0.5 }, cells: VoxelHash::default() }
    }

    /// Adds a point by its positions in the first and in the second cloud (metres).
    pub fn add(&mut self, before: [f64; 3], after: [f64; 3]) {
        if !before.iter().chain(&after).all(|v| v.is_finite()) {
            return;
        }
        let key = super::place_of(after, self.edge);
        let within =
            |p: [f64; 3]| Vector3::from(std::array::from_fn(|k| p[k] - f64::from(key[k]) * self.edge));
        let cell = self.cells.or_default(key);
        cell.before.add(&within(before));
        cell.after.add(&within(after));
    }

    /// The walls that changed most, largest change first: at most `count`, at least `apart` metres from each
    /// other. A wall is wide in two directions and thin in the third, in the cloud in which it is thinner.
    pub fn largest(&self, count: usize, apart: f64) -> Vec<WallChange> {
        let mut changes: Vec<([i32; 3], WallChange)> = self
            .cells
            .sorted()
            .into_iter()
            .filter_map(|(key, cell)| Some((key, self.change(key, cell)?)))
            .collect();
        let size = |change: &WallChange| (change.after - change.before).abs();
        changes.sort_by(|(k, a), (l, b)| size(b).total_cmp(&size(a)).then(k.cmp(l)));
        let mut chosen: Vec<WallChange> = Vec::new();
        for (_, change) in changes {
            if chosen.len() == count {
                break;
            }
            let place = Vector3::from(change.place);
            if chosen.iter().all(|c| (Vector3::from(c.place) - place).norm() >= apart) {
                chosen.push(change);
            }
        }
        chosen
    }

    fn change(&self, key: [i32; 3], cell: &Cell) -> Option<WallChange> {
        if cell.after.count < LEAST_POINTS {
            return None;
        }
        let (before, after) = (cell.before.plane()?, cell.after.plane()?);
        let thinner = if after.variances[0] <= before.variances[0] { &after } else { &before };
        let is_wall = |plane: &PlaneFit| {
            plane.variances[1] > (0.1 * self.edge).powi(2) && plane.variances[0] < 0.1 * plane.variances[1]
        };
        is_wall(thinner).then(|| WallChange {
            place: std::array::from_fn(|k| f64::from(key[k]) * self.edge + after.mean[k]),
            normal: thinner.normal.into(),
            before: before.variances[0].sqrt(),
            after: after.variances[0].sqrt(),
            points: cell.after.count as u64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wall_that_was_double_comes_first() {
        let mut changes = WallChanges::new(0.5);
        for i in 0..40_000 {
            let random = |k: f64| (f64::from(i) * k).fract();
            let (u, v) = (20.0 * random(0.754_877_666), 2.0 * random(0.569_840_291));
            let noise = 0.01 * (random(0.381_966_011) - 0.5);
            // The first metres of the wall are doubled, 6 cm apart.
            let doubled = if u < 2.0 && i % 2 == 0 { 0.06 } else { 0.0 };
            changes.add([u, 0.25 + noise + doubled, v], [u, 0.25 + noise, v]);
        }
        let found = changes.largest(3, 3.0);
        assert!(found[0].place[0] < 2.0 && found[0].normal[1].abs() > 0.99, "{found:?}");
        assert!((found[0].before - 0.03).abs() < 2e-3 && found[0].after < 4e-3);
        assert!(
            found.len() == 3 && found[1].place[0] > 2.5 && (found[1].before - found[1].after).abs() < 1e-9
        );
        assert!(WallChanges::new(0.5).largest(3, 1.0).is_empty());
    }
}
