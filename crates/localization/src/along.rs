//! Finds the position of a scan along the direction that planes do not constrain: along streets and
//! corridors.
//!
//! A registration to planes moves little along walls: the information there is small, and errors of normals
//! hold the pose where it starts. So the likelihood along that direction is evaluated over a whole interval,
//! in the grids of the submaps, which keep all hits (a histogram filter of one dimension: Thrun, Burgard and
//! Fox, "Probabilistic Robotics", §4.1).

use nalgebra as na;
use portolan_geometry::{Point3f, Vector3};
use portolan_grids::{GridError, HybridGrid, VoxelIndex};
use portolan_numeric::probabilities;

use crate::settings::maps::{OCCUPANCY_CELL, SOLID_ALONG_PROBABILITY};
use crate::settings::matching::{MOST_SLIDE_POINTS, POINTS_PER_INDEPENDENT_ONE, SLIDE_STEP};
use crate::submap_cells::SubmapCells;

/// Probability of the submaps that places are solid.
pub(crate) struct SolidField {
    cells: HybridGrid,
}

/// The eight cells around a place, and their probabilities.
#[derive(Clone, Copy, Default)]
struct Cube {
    first: Option<VoxelIndex>,
    probabilities: [f32; 8],
}

/// Estimated position along a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Along {
    /// Shift from the assumed position, metres.
    pub shift: f64,
    /// Information, 1/m²: 0 where all positions are equally likely.
    pub information: f64,
}

impl SolidField {
    /// A field without submaps.
    ///
    /// # Errors
    /// If the grid cannot be made.
    pub fn new() -> Result<Self, GridError> {
        Ok(Self { cells: HybridGrid::new(OCCUPANCY_CELL)? })
    }

    /// Adds a submap.
    pub fn add(&mut self, submap: &SubmapCells) {
        for (place, probability) in
            submap.cells.iter().filter(|(_, probability)| *probability >= SOLID_ALONG_PROBABILITY)
        {
            if let Some(cell) = self.cells.cell_index(place)
                && *probability > self.cells.probability(cell)
            {
                self.cells.set_probability(cell, *probability);
            }
        }
    }

    /// Probability that a place is solid, interpolated between the centres of cells. `around` caches the
    /// cells around the previous place: neighbouring places are mostly between the same ones.
    #[inline]
    fn at(&self, place: &Point3f, around: &mut Cube) -> f64 {
        let scaled = place.coords / self.cells.resolution();
        let low = scaled.map(f32::floor);
        let part = scaled - low;
        let first = [low.x as i32, low.y as i32, low.z as i32];
        if around.first != Some(first) {
            *around = Cube { first: Some(first), probabilities: self.cells.corner_probabilities(first) };
        }
        let [[x, u], [y, v], [z, w]] = [part.x, part.y, part.z].map(|part| [1.0 - part, part]);
        // Weights along x first, then along y, in the order of the cells.
        let low = [x * y * z, u * y * z, x * v * z, u * v * z];
        let high = [x * y * w, u * y * w, x * v * w, u * v * w];
        let corners = low.into_iter().chain(high).zip(around.probabilities);
        f64::from(corners.map(|(weight, probability)| weight * probability).sum::<f32>())
    }

    /// Log likelihoods of points, summed for each shift along a direction.
    fn log_likelihoods(&self, points: &[&Point3f], direction: &Vector3, shifts: &[f64]) -> Vec<f64> {
        let moves: Vec<na::Vector3<f32>> = shifts.iter().map(|shift| (*shift * direction).cast()).collect();
        let mut sums = vec![0.0; shifts.len()];
        for point in points {
            let mut around = Cube::default();
            for (sum, by) in sums.iter_mut().zip(&moves) {
                *sum += self.at(&(*point + by), &mut around).ln();
            }
        }
        sums
    }

    /// Position of points (metres, in the map) along a direction of unit length, within `reach` metres to
    /// either side: mean and variance of the positions weighted by their likelihood. The information does
    /// not include what follows from the limited reach alone.
    pub fn along(&self, points: &[Point3f], direction: &Vector3, reach: f64) -> Along {
        let asked: Vec<&Point3f> =
            points.iter().step_by(points.len().div_ceil(MOST_SLIDE_POINTS).max(1)).collect();
        let points_of_one = points.len() as f64 / asked.len().max(1) as f64;
        let count = (reach / SLIDE_STEP).round().max(1.0) as i32;
        let shifts: Vec<f64> = (-count..=count).map(|i| f64::from(i) * SLIDE_STEP).collect();
        let sums = self.log_likelihoods(&asked, direction, &shifts).into_iter();
        let logs: Vec<f64> = sums.map(|sum| sum * points_of_one / POINTS_PER_INDEPENDENT_ONE).collect();
        let probabilities = probabilities(&logs);
        let mean = shifts.iter().zip(&probabilities).map(|(s, p)| s * p).sum::<f64>();
        let squares = shifts.iter().zip(&probabilities).map(|(s, p)| (s - mean).powi(2) * p);
        let variance = squares.sum::<f64>() + SLIDE_STEP * SLIDE_STEP / 12.0;
        let of_reach =
            shifts.iter().map(|s| s * s).sum::<f64>() / shifts.len() as f64 + SLIDE_STEP * SLIDE_STEP / 12.0;
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
        let mut cells = HybridGrid::new(OCCUPANCY_CELL).unwrap();
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
    fn posts_constrain_the_position_along_a_street() {
        let posts = [-7.1, -4.3, -1.8, 0.4, 2.2, 3.7, 6.3, 8.8];
        let (field, seen) = (street(&posts), points(&posts)[4000..].repeat(20));
        let found = field.along(&seen_from(&seen, 0.31), &Vector3::x(), 0.8);
        assert!((found.shift - 0.31).abs() < 0.03 && found.information > 400.0, "{found:?}");
    }

    #[test]
    fn bare_walls_do_not_constrain_the_position_along_them() {
        let found = street(&[]).along(&points(&[])[1000..3000], &Vector3::x(), 0.8);
        assert!(found.shift.abs() < 0.02 && found.information < 1.0, "{found:?}");
    }
}
