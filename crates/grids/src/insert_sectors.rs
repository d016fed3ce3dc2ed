//! Inserts range data whose beams represent sectors.
//!
//! A beam samples the sector halfway to its neighbours. Far away that sector is many cells wide, and the
//! measurement holds for one of them only. Along a wall, beams a degree apart with a heading error of a
//! fraction of that erase cells that were measured from nearby. So the evidence of a beam (log odds) is
//! distributed over the cells across its sector.

use std::f32::consts::TAU;

use portolan_sensor::RangeData;

use super::insert_probability::{Offset, draw};
use super::value::{UpdateTable, odds};
use super::{GridError, InsertReport, InserterOptionError, ProbabilityGrid, ProbabilityInserterOptions};

/// Number of weights of evidence: 1, and each √½ of the one before, down to 1/64: 64 cells across are 180 m
/// at 1° and 5 cm.
const LEVELS: usize = 13;

/// Inserts range data into probability grids, every beam as a sector.
#[derive(Clone, Debug, PartialEq)]
pub struct SectorInserter {
    /// By level.
    hits: Vec<UpdateTable>,
    /// By level.
    misses: Vec<UpdateTable>,
    insert_free_space: bool,
    max_cells: usize,
}

impl SectorInserter {
    /// Computes the tables of an inserter, which may then serve any number of grids.
    ///
    /// # Errors
    /// If a probability is out of its bounds.
    pub fn new(options: &ProbabilityInserterOptions) -> Result<Self, InserterOptionError> {
        let (hit, miss) = (options.hit_probability, options.miss_probability);
        InserterOptionError::check_probabilities(hit, miss)?;
        let tables = |probability: f64| {
            let of_level = |level: usize| {
                let weight = (-0.5 * level as f32).exp2();
                UpdateTable::for_correspondence_costs(odds(probability as f32).powf(weight))
            };
            (0..LEVELS).map(of_level).collect()
        };
        Ok(Self {
            hits: tables(hit),
            misses: tables(miss),
            insert_free_space: options.insert_free_space,
            max_cells: options.max_cells,
        })
    }

    /// Inserts one scan (metres, in the frame of the grid) whose beams are `spacing` radians apart: as
    /// [`ProbabilityInserter::insert`](super::ProbabilityInserter::insert) where the sector of a beam is
    /// narrower than a cell, with evidence in inverse proportion to its width beyond.
    ///
    /// # Errors
    /// If the origin is not finite or the grid would grow too large; the grid remains unchanged.
    pub fn insert(
        &self,
        range_data: &RangeData,
        spacing: f32,
        grid: &mut ProbabilityGrid,
    ) -> Result<InsertReport, GridError> {
        // Squared distances in cells from which on the next level holds: halfway to it in terms of the width.
        let begin_of_level = |level: usize| ((0.5 * level as f32 + 0.25).exp2() / spacing.max(0.0)).powi(2);
        let begins: [f32; LEVELS - 1] = std::array::from_fn(begin_of_level);
        let level = |[dx, dy]: Offset| {
            let squared_distance = (dx * dx + dy * dy) as f32;
            begins.iter().take_while(|begin| squared_distance >= **begin).count()
        };
        let free = self.insert_free_space.then_some(|offset| &self.misses[level(offset)]);
        draw((range_data, &[]), grid, self.max_cells, |offset| &self.hits[level(offset)], free)
    }
}

/// Angle between the beams of a scan, radians: the lower quartile of the angles from one point to the next
/// around the origin, because thinning leaves out points and some beams have no return. Infinity with fewer
/// than two points.
pub fn beam_spacing(scan: &RangeData) -> f32 {
    let origin = scan.origin;
    let points = scan.returns.points.iter().chain(&scan.misses.points);
    let mut directions: Vec<f32> =
        points.map(|p| (p.y - origin.y).atan2(p.x - origin.x)).filter(|a| a.is_finite()).collect();
    directions.sort_unstable_by(f32::total_cmp);
    let (Some(first), Some(last)) = (directions.first(), directions.last()) else { return f32::INFINITY };
    let around = TAU - (last - first);
    let mut gaps: Vec<f32> = directions.windows(2).map(|pair| pair[1] - pair[0]).chain([around]).collect();
    let quarter = gaps.len() / 4;
    *gaps.select_nth_unstable_by(quarter, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MapLimits, ProbabilityInserter};
    use portolan_geometry::{Point3f, Vector2, Vector2f};
    use portolan_sensor::PointCloud;

    const DEGREE: f32 = TAU / 360.0;

    fn scan(origin: [f32; 2], returns: impl Iterator<Item = [f32; 2]>) -> RangeData {
        let point = |[x, y]: [f32; 2]| Point3f::new(x, y, 0.0);
        RangeData {
            origin: point(origin),
            returns: PointCloud::new(returns.map(point).collect()),
            misses: PointCloud::default(),
        }
    }

    fn grid() -> ProbabilityGrid {
        ProbabilityGrid::new(MapLimits::new(0.05, Vector2::new(50.0, 5.0), 200, 1200).unwrap())
    }

    fn inserters() -> (ProbabilityInserter, SectorInserter) {
        let options = ProbabilityInserterOptions::default();
        (ProbabilityInserter::new(&options).unwrap(), SectorInserter::new(&options).unwrap())
    }

    /// The wall y = 1 seen from nearby, at x from 20 to 22 m.
    fn near() -> RangeData {
        scan([21.0, 0.0], (0..200).map(|i| [20.0 + 0.01 * i as f32, 1.02]))
    }

    /// Beams from far along the wall, whose heading is off so that they end behind it.
    fn far() -> RangeData {
        scan([0.0, 0.0], (0..20).map(|i| [40.0, 1.0 + 0.05 * i as f32 + 0.5]))
    }

    fn wall(grid: &ProbabilityGrid) -> f32 {
        let probability = |i: i32| {
            let cell = grid.limits().cell_index(Vector2f::new(20.225 + 0.05 * i as f32, 1.02));
            grid.probability(cell)
        };
        (0..30).map(probability).sum::<f32>() / 30.0
    }

    #[test]
    fn distant_beams_do_not_erase_a_wall_seen_from_nearby() {
        let (rays, sectors) = inserters();
        let (mut by_rays, mut by_sectors) = (grid(), grid());
        for _ in 0..5 {
            rays.insert(&near(), &mut by_rays).unwrap();
            sectors.insert(&near(), DEGREE, &mut by_sectors).unwrap();
        }
        let before = wall(&by_sectors);
        for _ in 0..40 {
            rays.insert(&far(), &mut by_rays).unwrap();
            sectors.insert(&far(), DEGREE, &mut by_sectors).unwrap();
        }
        assert!(wall(&by_rays) < 0.6, "{}", wall(&by_rays));
        assert!(wall(&by_sectors) > before - 0.05, "{} of {before}", wall(&by_sectors));
    }

    #[test]
    fn nearby_a_sector_is_a_ray() {
        let (rays, sectors) = inserters();
        let (mut by_rays, mut by_sectors) = (grid(), grid());
        rays.insert(&near(), &mut by_rays).unwrap();
        sectors.insert(&near(), DEGREE, &mut by_sectors).unwrap();
        assert_eq!(by_rays, by_sectors);
        rays.insert(&far(), &mut by_rays).unwrap();
        sectors.insert(&far(), 0.0, &mut by_sectors).unwrap();
        assert_eq!(by_rays, by_sectors);
    }

    #[test]
    fn evidence_falls_with_the_width_of_the_sector() {
        let (_, sectors) = inserters();
        let mut grid = grid();
        sectors.insert(&scan([0.0, 0.0], [[40.0, 0.0]].into_iter()), DEGREE, &mut grid).unwrap();
        let log_odds = |x: f32| {
            let p = grid.probability(grid.limits().cell_index(Vector2f::new(x, 0.0)));
            (p / (1.0 - p)).ln()
        };
        let near = log_odds(1.0);
        // 0.35 and 0.5 m of sector: 7 and 10 cells of 0.05 m.
        for (x, cells) in [(20.0, 7.0), (30.0, 10.5)] {
            let ratio = near / log_odds(x);
            assert!((ratio / cells - 1.0).abs() < 0.25, "{ratio} at {x} m");
        }
    }

    #[test]
    fn the_spacing_of_beams_is_estimated_from_the_scan() {
        let ring = |step: f32, n: usize, keep: fn(usize) -> bool| {
            let direction = move |i: usize| (i as f32 * step - 1.5).sin_cos();
            scan(
                [0.0, 0.0],
                (0..n).filter(move |i| keep(*i)).map(direction).map(|(sin, cos)| [5.0 * cos, 5.0 * sin]),
            )
        };
        let spacing = beam_spacing(&ring(DEGREE, 180, |_| true));
        assert!((spacing / DEGREE - 1.0).abs() < 0.01, "{spacing}");
        let spacing = beam_spacing(&ring(0.25 * DEGREE, 1081, |i| i % 7 < 4));
        assert!((spacing / DEGREE - 0.25).abs() < 0.01, "{spacing}");
        assert_eq!(beam_spacing(&RangeData::default()), f32::INFINITY);
    }
}
