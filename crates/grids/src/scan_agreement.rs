//! Compares a scan at a pose with a grid: which beams it explains, and which it contradicts.

use nalgebra::Vector2;
use portolan_geometry::{Point3f, Rigid2};
use portolan_sensor::PointCloud;

use super::{CellIndex, FREE_CELL, Grid2d, ProbabilityGrid, SOLID_CELL};

/// Number of cells that a beam has to go on behind occupied cells to count as passing through them: walls are
/// thick and rough.
const BEHIND: f64 = 4.0;
/// Minimum number of occupied cells that it passes: a beam along a wall touches some.
const MIN_SOLID_CELLS: u32 = 2;

/// Agreement of the beams of a scan with a grid. Fractions of all beams; the rest to 1 is unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScanAgreement {
    /// Beams that end at an occupied cell.
    pub explained: f32,
    /// Beams that end in a cell known to be free.
    pub in_free_space: f32,
    /// Beams that pass through occupied cells.
    pub through_solid: f32,
}

impl ScanAgreement {
    /// Beams that the grid contradicts.
    pub fn contradicted(&self) -> f32 {
        self.in_free_space + self.through_solid
    }

    /// Contradicted beams as a fraction of all beams that the grid knows.
    pub fn contradiction(&self) -> f32 {
        let contradicted = self.contradicted();
        let known = self.explained + contradicted;
        if known > 0.0 { contradicted / known } else { 0.0 }
    }
}

impl FromIterator<BeamEnd> for ScanAgreement {
    fn from_iter<I: IntoIterator<Item = BeamEnd>>(ends: I) -> Self {
        let [mut explained, mut in_free, mut through, mut total] = [0u32; 4];
        for end in ends {
            total += 1;
            match end {
                BeamEnd::AtSolid => explained += 1,
                BeamEnd::InFree => in_free += 1,
                BeamEnd::BehindSolid => through += 1,
                BeamEnd::Unknown => {}
            }
        }
        let share = |count: u32| count as f32 / total.max(1) as f32;
        Self { explained: share(explained), in_free_space: share(in_free), through_solid: share(through) }
    }
}

/// Agreement of a map with one beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BeamEnd {
    /// It ends at an occupied cell.
    AtSolid,
    /// It ends in a cell known to be free.
    InFree,
    /// It passes through occupied cells.
    BehindSolid,
    /// The map does not know where it ends.
    Unknown,
}

/// Each point of a scan, in its own frame, with the agreement of its beam with a grid of probabilities.
/// `points` are metres in the frame of the scanner, whose pose in the frame of the grid is `grid_from_scan`.
/// None for distance fields; points at the scanner itself are left out.
pub fn beam_ends<'a>(
    grid: &'a Grid2d,
    grid_from_scan: &Rigid2,
    points: &'a PointCloud,
) -> impl Iterator<Item = (&'a Point3f, BeamEnd)> + use<'a> {
    let grid = if let Grid2d::Probability(grid) = grid { Some(grid) } else { None };
    let pose = *grid_from_scan;
    grid.into_iter().flat_map(move |grid| {
        points.points.iter().filter_map(move |point| Some((point, beam_end(grid, &pose, point)?)))
    })
}

#[inline]
fn beam_end(grid: &ProbabilityGrid, grid_from_scan: &Rigid2, point: &Point3f) -> Option<BeamEnd> {
    let resolution = grid.limits().resolution();
    let cell_at = |p: &Vector2<f64>| grid.limits().cell_index(p.cast::<f32>());
    let origin = grid_from_scan.translation;
    let end = grid_from_scan.transform_point(&Vector2::new(f64::from(point.x), f64::from(point.y)));
    let beam = end - origin;
    let length = beam.norm();
    if !length.is_finite() || length <= 0.0 {
        return None;
    }
    let cell = cell_at(&end);
    if is_cell_at_solid(grid, cell) {
        return Some(BeamEnd::AtSolid);
    }
    let steps = (length / resolution - BEHIND).max(0.0) as u32;
    let passed = (1..steps)
        .filter(|i| is_solid(grid, cell_at(&(origin + beam * (f64::from(*i) * resolution / length)))));
    Some(if passed.take(MIN_SOLID_CELLS as usize).count() >= MIN_SOLID_CELLS as usize {
        BeamEnd::BehindSolid
    } else if is_free(grid, cell) {
        BeamEnd::InFree
    } else {
        BeamEnd::Unknown
    })
}

/// Whether a beam ends in free space, and would go on for `metres` through cells known to be free. Arguments
/// as for [`beam_ends`].
pub fn ends_in_the_open(grid: &Grid2d, grid_from_scan: &Rigid2, point: &Point3f, metres: f64) -> bool {
    let Grid2d::Probability(grid) = grid else { return false };
    let resolution = grid.limits().resolution();
    let end = grid_from_scan.transform_point(&Vector2::new(f64::from(point.x), f64::from(point.y)));
    let beam = end - grid_from_scan.translation;
    let length = beam.norm();
    let on_beam = |i: u32| {
        let at = length + f64::from(i) * resolution;
        grid.limits().cell_index((grid_from_scan.translation + beam * (at / length)).cast::<f32>())
    };
    length > 0.0
        && length.is_finite()
        && beam_end(grid, grid_from_scan, point) == Some(BeamEnd::InFree)
        && (1..=(metres / resolution).ceil() as u32).all(|i| is_free(grid, on_beam(i)))
}

/// Whether a point, metres in the frame of the grid, is in an occupied cell or beside one.
pub fn is_at_solid(grid: &Grid2d, point: &Vector2<f64>) -> bool {
    let Grid2d::Probability(grid) = grid else { return false };
    is_cell_at_solid(grid, grid.limits().cell_index(point.cast::<f32>()))
}

fn is_cell_at_solid(grid: &ProbabilityGrid, cell: CellIndex) -> bool {
    let around = (-1..=1).flat_map(|x| (-1..=1).map(move |y| CellIndex::new(cell.x + x, cell.y + y)));
    around.into_iter().any(|cell| is_solid(grid, cell))
}

fn is_solid(grid: &ProbabilityGrid, cell: CellIndex) -> bool {
    grid.is_known(cell) && grid.probability(cell) > SOLID_CELL
}

fn is_free(grid: &ProbabilityGrid, cell: CellIndex) -> bool {
    grid.is_known(cell) && grid.probability(cell) < FREE_CELL
}

/// Compares a scan with a grid of probabilities. `points` are metres in the frame of the scanner, whose pose in
/// the frame of the grid is `grid_from_scan`. None for distance fields and without points.
pub fn scan_agreement(grid: &Grid2d, grid_from_scan: &Rigid2, points: &PointCloud) -> Option<ScanAgreement> {
    let mut ends = beam_ends(grid, grid_from_scan, points).map(|(_, end)| end).peekable();
    ends.peek()?;
    Some(ends.collect())
}

/// Difference, in standard errors, between the probabilities of the cells at the points at the first of two
/// poses and at the second. Differences are paired, point by point, and weighted. None for distance fields
/// and without points.
pub fn score_difference(
    grid: &Grid2d,
    grid_from_scan: [&Rigid2; 2],
    points: &PointCloud,
    weights: &[f32],
) -> Option<f64> {
    let Grid2d::Probability(grid) = grid else { return None };
    let (mut sum, mut squares) = (0.0, 0.0);
    for (point, weight) in points.points.iter().zip(weights) {
        let [first, second] = grid_from_scan.map(|pose| {
            let end = pose.transform_point(&Vector2::new(f64::from(point.x), f64::from(point.y)));
            grid.probability(grid.limits().cell_index(end.cast::<f32>()))
        });
        let difference = f64::from(weight * (first - second));
        sum += difference;
        squares += difference * difference;
    }
    (!points.points.is_empty()).then(|| if squares > 0.0 { sum / squares.sqrt() } else { 0.0 })
}

/// Mean probability of the occupied cells of a grid of probabilities; 1 for distance fields and without any.
pub fn mean_of_solid_cells(grid: &Grid2d) -> f32 {
    let Grid2d::Probability(grid) = grid else { return 1.0 };
    let of_code = |code: &u16| 1.0 - grid.code().decode(*code, grid.code().upper());
    let solid = grid.cells().iter().filter(|code| **code != 0).map(of_code).filter(|p| *p > SOLID_CELL);
    let (sum, count) = solid.fold((0.0f64, 0u64), |(sum, n), p| (sum + f64::from(p), n + 1));
    if count > 0 { (sum / count as f64) as f32 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MapLimits, ProbabilityGrid};
    use portolan_geometry::Point3f;

    #[test]
    fn beams_are_explained_contradicted_or_unknown() {
        let limits = MapLimits::new(0.1, Vector2::new(10.0, 10.0), 200, 200).unwrap();
        let mut grid = ProbabilityGrid::new(limits);
        let mut set = |x: f32, y: f32, p: f32| {
            let cell = grid.limits().cell_index(nalgebra::Vector2::new(x, y));
            // Some cells are met twice: the first value counts.
            grid.set_probability(cell, p);
        };
        for i in 0..40 {
            for j in 1..30 {
                set(0.05 + 0.1 * j as f32, -1.95 + 0.1 * i as f32, 0.2);
            }
            set(3.05, -1.95 + 0.1 * i as f32, 0.8);
            set(3.15, -1.95 + 0.1 * i as f32, 0.8);
        }
        let agreement = |x: f32, y: f32| {
            let cloud = PointCloud::new(vec![Point3f::new(x, y, 0.0)]);
            scan_agreement(&Grid2d::Probability(grid.clone()), &Rigid2::identity(), &cloud).unwrap()
        };
        assert_eq!(agreement(3.05, 0.55).explained, 1.0);
        assert_eq!(agreement(1.5, 0.55).in_free_space, 1.0);
        assert_eq!(agreement(5.0, 0.55).through_solid, 1.0);
        assert_eq!(agreement(-5.0, 0.55), ScanAgreement::default());
        assert_eq!(agreement(1.5, 0.55).contradiction(), 1.0);
        let grid = Grid2d::Probability(grid.clone());
        let is_open = |x: f32, metres: f64| {
            ends_in_the_open(&grid, &Rigid2::identity(), &Point3f::new(x, 0.0, 0.0), metres)
        };
        assert!(is_open(1.5, 1.0) && !is_open(1.5, 2.0));
        // At a wall, before unknown space, and beyond it.
        assert!(!is_open(3.05, 0.0) && !is_open(-0.2, 0.0) && !is_open(5.0, 0.0));
    }
}
