//! Where a scan lies along the direction that planes leave open: along streets and corridors.
//!
//! A registration to planes moves little along walls: what tells of the place there is small, and errors of normals hold it
//! where it begins. So the likelihood of places along that direction is looked at as a whole, in the grids of the submaps,
//! where all that was ever hit is kept (a histogram filter of one dimension: Thrun, Burgard and Fox, "Probabilistic
//! Robotics", §4.1).

use portolan_geometry::{Point3f, Vector3};
use portolan_grids::{GridError, HybridGrid, VoxelIndex};

use crate::submap_cells::SubmapCells;

/// Edge of a cell, metres, and what is no more solid than this is left out.
const CELL: f32 = 0.2;
const LEAST: f32 = 0.5;
/// Places that are compared lie so far apart, metres.
const STEP: f64 = 0.05;
/// Neighbouring points share the errors of the map, so that so many count as one: on two drives, sweeps then scatter as far as
/// they say (docs/experiments/2026-11-along-streets.md).
const POINTS_PER_INDEPENDENT_ONE: f64 = 50.0;
/// So many points are asked, evenly from all of them: more say the same.
const MOST_POINTS: usize = 1000;

/// How solid the submaps say that places are.
pub(crate) struct SolidField {
    cells: HybridGrid,
}

/// A place along a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Along {
    /// From where it was believed to be, metres.
    pub shift: f64,
    /// 1/m²: none where all places are alike.
    pub information: f64,
}

impl SolidField {
    /// Of no submap.
    ///
    /// # Errors
    /// If there is no such grid.
    pub fn new() -> Result<Self, GridError> {
        Ok(Self { cells: HybridGrid::new(CELL)? })
    }

    /// Takes a submap.
    pub fn add(&mut self, submap: &SubmapCells) {
        for (place, probability) in submap.cells.iter().filter(|(_, probability)| *probability >= LEAST) {
            if let Some(cell) = self.cells.cell_index(place)
                && *probability > self.cells.probability(cell)
            {
                self.cells.set_probability(cell, *probability);
            }
        }
    }

    /// How likely a place is solid, between the centres of cells.
    fn at(&self, place: &Point3f) -> f64 {
        let scaled = place.coords / self.cells.resolution();
        let low = scaled.map(f32::floor);
        let part = scaled - low;
        let corner = |bits: i32| {
            let side = [bits & 1, bits >> 1 & 1, bits >> 2 & 1];
            let weight = |axis: usize| if side[axis] == 1 { part[axis] } else { 1.0 - part[axis] };
            let cell: VoxelIndex = [0, 1, 2].map(|axis| low[axis] as i32 + side[axis]);
            weight(0) * weight(1) * weight(2) * self.cells.probability(cell)
        };
        f64::from((0..8).map(corner).sum::<f32>())
    }

    /// Where points (metres, in the map) lie along a direction of unit length, within `reach` metres to either side: mean
    /// and variance of the places by their likelihood. What follows from the reach alone is no information.
    pub fn along(&self, points: &[Point3f], direction: &Vector3, reach: f64) -> Along {
        let asked: Vec<&Point3f> = points.iter().step_by(points.len().div_ceil(MOST_POINTS).max(1)).collect();
        let points_of_one = points.len() as f64 / asked.len().max(1) as f64;
        let count = (reach / STEP).round().max(1.0) as i32;
        let shifts: Vec<f64> = (-count..=count).map(|i| f64::from(i) * STEP).collect();
        let log_likelihood = |shift: &f64| {
            let by = (*shift * direction).cast::<f32>();
            let sum: f64 = asked.iter().map(|point| self.at(&(*point + by)).ln()).sum();
            sum * points_of_one / POINTS_PER_INDEPENDENT_ONE
        };
        let logs: Vec<f64> = shifts.iter().map(log_likelihood).collect();
        let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = logs.iter().map(|log| (log - most).exp()).collect();
        let all: f64 = weights.iter().sum();
        let mean = shifts.iter().zip(&weights).map(|(s, w)| s * w).sum::<f64>() / all;
        let squares = shifts.iter().zip(&weights).map(|(s, w)| (s - mean).powi(2) * w);
        let variance = squares.sum::<f64>() / all + STEP * STEP / 12.0;
        let of_reach = shifts.iter().map(|s| s * s).sum::<f64>() / shifts.len() as f64 + STEP * STEP / 12.0;
        let information = (1.0 / variance - 1.0 / of_reach).max(0.0);
        if mean.is_finite() && information.is_finite() {
            Along { shift: mean, information }
        } else {
            Along { shift: 0.0, information: 0.0 }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Walls along x at y = ±4 m, and posts beside them.
    fn street(posts: &[f32]) -> SolidField {
        let mut cells = HybridGrid::new(CELL).unwrap();
        for point in points(posts) {
            let cell = cells.cell_index(&point).unwrap();
            cells.set_probability(cell, 0.8);
        }
        SolidField { cells }
    }

    fn points(posts: &[f32]) -> Vec<Point3f> {
        let height = |j: i32| 0.2 * j as f32;
        let walls = (-100..100).flat_map(|i| [-4.0, 4.0].map(move |y| (0.1 * i as f32, y)));
        let walls = walls.flat_map(|(x, y)| (0..10).map(move |j| Point3f::new(x, y, height(j))));
        let posts = posts.iter().flat_map(|x| (0..10).map(move |j| Point3f::new(*x, 3.0, height(j))));
        walls.chain(posts).collect()
    }

    fn seen_from(points: &[Point3f], x: f32) -> Vec<Point3f> {
        points.iter().map(|p| Point3f::new(p.x - x, p.y, p.z)).collect()
    }

    #[test]
    fn posts_tell_the_place_along_a_street() {
        let posts = [-7.1, -4.3, -1.8, 0.4, 2.2, 3.7, 6.3, 8.8];
        let (field, seen) = (street(&posts), points(&posts)[4000..].repeat(20));
        let found = field.along(&seen_from(&seen, 0.31), &Vector3::x(), 0.8);
        assert!((found.shift - 0.31).abs() < 0.03 && found.information > 400.0, "{found:?}");
    }

    #[test]
    fn bare_walls_tell_nothing_of_it() {
        let found = street(&[]).along(&points(&[])[1000..3000], &Vector3::x(), 0.8);
        assert!(found.shift.abs() < 0.02 && found.information < 1.0, "{found:?}");
    }
}
