//! Drawing range data into grids in space.

use portolan_sensor::RangeData;

use super::value::{UpdateTable, odds};
use super::{GridError, HybridGrid, InsertReport, InserterOptionError, IntensityGrid, VoxelIndex, is_finite};

/// How strongly a scan changes the cells it meets.
#[derive(Clone, Debug, PartialEq)]
pub struct HybridInserterOptions {
    /// Probability that a cell in which a ray ended is occupied; above 0.5, default 0.55.
    pub hit_probability: f64,
    /// Probability that a cell through which a ray passed is occupied; below 0.5, default 0.49.
    pub miss_probability: f64,
    /// How many cells in front of each hit become less probable, default 2.
    pub num_free_space_voxels: u32,
    /// Intensities above this are left out, default 40.
    pub intensity_threshold: f32,
}

impl Default for HybridInserterOptions {
    fn default() -> Self {
        Self {
            hit_probability: 0.55,
            miss_probability: 0.49,
            num_free_space_voxels: 2,
            intensity_threshold: 40.0,
        }
    }
}

/// Draws range data into hybrid grids.
#[derive(Clone, Debug, PartialEq)]
pub struct HybridInserter {
    hit_table: UpdateTable,
    miss_table: UpdateTable,
    num_free_space_voxels: i32,
    intensity_threshold: f32,
}

impl HybridInserter {
    /// Computes the tables of an inserter, which may then serve any number of grids.
    ///
    /// # Errors
    /// If a probability is out of its bounds.
    pub fn new(options: &HybridInserterOptions) -> Result<Self, InserterOptionError> {
        InserterOptionError::check_probabilities(options.hit_probability, options.miss_probability)?;
        Ok(Self {
            hit_table: UpdateTable::for_probabilities(odds(options.hit_probability as f32)),
            miss_table: UpdateTable::for_probabilities(odds(options.miss_probability as f32)),
            num_free_space_voxels: i32::try_from(options.num_free_space_voxels).unwrap_or(i32::MAX),
            intensity_threshold: options.intensity_threshold,
        })
    }

    /// Draws the returns of one scan (metres, in the frame of the grid) that are at most `max_range`
    /// metres from its origin. The cells in which rays end become more probable, the last few cells before
    /// them less (`slam3d.md` §5). A cell changes at most once, and being hit wins. `intensities` gets the
    /// intensity of each return that has one below the threshold. Misses do not count in space.
    ///
    /// # Errors
    /// If the origin is not finite or outside of what a grid can hold; nothing is changed then.
    pub fn insert(
        &self,
        range_data: &RangeData,
        max_range: f32,
        grid: &mut HybridGrid,
        intensities: Option<&mut IntensityGrid>,
    ) -> Result<InsertReport, GridError> {
        let origin = range_data.origin;
        let Some(begin) = grid.cell_index(&origin) else {
            return Err(GridError::InvalidOrigin { x: origin.x, y: origin.y, z: origin.z });
        };
        let mut report = InsertReport::default();
        let mut ends: Vec<VoxelIndex> = Vec::new();
        let in_range = |p: &portolan_geometry::Point3f| (p - origin).norm() <= max_range;
        for point in &range_data.returns.points {
            if in_range(point) {
                match grid.cell_index(point).map(|cell| (cell, grid.apply(cell, &self.hit_table))) {
                    Some((cell, Some(first_hit))) => {
                        report.hits += 1;
                        if first_hit {
                            ends.push(cell);
                        }
                    }
                    _ => report.outside += 1,
                }
            } else if !is_finite(point) {
                report.not_finite += 1;
            }
        }
        for end in ends {
            self.clear_before(begin, end, grid);
        }
        grid.finish_update();
        if let Some(intensities) = intensities {
            let returns = &range_data.returns;
            for (point, intensity) in returns.points.iter().zip(&returns.intensities) {
                if *intensity <= self.intensity_threshold && in_range(point) {
                    let cell = intensities.cell_index(point);
                    cell.map(|cell| intensities.add_intensity(cell, *intensity));
                }
            }
        }
        Ok(report)
    }

    /// The last few cells on the way from `begin` to `end`: step k of n is k/n of the way along each axis,
    /// without its fraction.
    fn clear_before(&self, begin: VoxelIndex, end: VoxelIndex, grid: &mut HybridGrid) {
        let delta = [end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]];
        let steps = delta[0].abs().max(delta[1].abs()).max(delta[2].abs());
        let slope = delta.map(|d| f64::from(d) / f64::from(steps));
        for k in (steps - self.num_free_space_voxels).max(0)..steps {
            let along = |axis: usize| begin[axis] + whole_part(slope[axis] * f64::from(k));
            grid.apply([along(0), along(1), along(2)], &self.miss_table);
        }
    }
}

/// The whole part of a quotient of numbers of at most 15 bits, which is off by rounding: it is a whole number,
/// or at least 1/2^15 away from one. Divisions of integers would take several times longer.
#[inline]
fn whole_part(quotient: f64) -> i32 {
    const MORE: f64 = 1.0 / (1 << 20) as f64;
    (quotient + MORE.copysign(quotient)) as i32
}

#[cfg(test)]
mod tests;
