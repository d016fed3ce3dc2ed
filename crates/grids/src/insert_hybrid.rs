//! Inserts range data into grids in 3D.

use portolan_sensor::RangeData;

use super::value::{UPDATE_MARKER, UpdateTable, odds};
use super::voxel_map::BlockKey;
use super::{GridError, HybridGrid, InsertReport, InserterOptionError, IntensityGrid, VoxelIndex, is_finite};
use crate::voxel_order::sort_by_voxel;

/// Options of inserting scans into hybrid grids: how strongly a scan changes cells.
#[derive(Clone, Debug, PartialEq)]
pub struct HybridInserterOptions {
    /// Probability that a cell in which a ray ended is occupied; above 0.5, default 0.55.
    pub hit_probability: f64,
    /// Probability that a cell through which a ray passed is occupied; below 0.5, default 0.49.
    pub miss_probability: f64,
    /// Number of cells in front of each hit that become less probable, default 2.
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

/// Inserts range data into hybrid grids.
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

    /// Inserts the returns of one scan (metres, in the frame of the grid) that are at most `max_range` metres
    /// from its origin. The cells in which rays end become more probable, the last few cells before them less
    /// (`slam3d.md` §5). A cell changes at most once, and being hit wins. `intensities` gets the intensity of
    /// each return that has one below the threshold. Misses do not count in 3D.
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
        if grid.cell_index(&origin).is_none() {
            return Err(GridError::InvalidOrigin { x: origin.x, y: origin.y, z: origin.z });
        }
        if let Some(intensities) = intensities {
            self.insert_intensities(range_data, max_range, intensities);
        }
        Ok(self.insert_all(std::slice::from_ref(range_data), max_range, grid))
    }

    /// Adds the intensities of the returns of a scan to cells, as [`Self::insert`] does.
    pub fn insert_intensities(&self, range_data: &RangeData, max_range: f32, grid: &mut IntensityGrid) {
        let returns = &range_data.returns;
        for (point, intensity) in returns.points.iter().zip(&returns.intensities) {
            if *intensity <= self.intensity_threshold && (point - range_data.origin).norm() <= max_range {
                let cell = grid.cell_index(point);
                cell.map(|cell| grid.add_intensity(cell, *intensity));
            }
        }
    }

    /// Inserts scans one after the other, as [`Self::insert`] does, without their intensities. Scans whose
    /// origin the grid cannot hold are passed over. All changes are sorted by blocks of cells first, so that
    /// each block is fetched from memory once, however many scans change it.
    pub fn insert_all(&self, scans: &[RangeData], max_range: f32, grid: &mut HybridGrid) -> InsertReport {
        let mut report = InsertReport::default();
        for scans in scans.chunks(1 << SCAN_BITS) {
            let mut changes = Changes::default();
            for (number, scan) in (0..).zip(scans) {
                self.collect(scan, number, max_range, grid, &mut changes, &mut report);
            }
            report.outside += self.apply(changes, grid);
        }
        report
    }

    /// Collects the changes by a scan.
    fn collect(
        &self,
        scan: &RangeData,
        number: u64,
        max_range: f32,
        grid: &HybridGrid,
        changes: &mut Changes,
        report: &mut InsertReport,
    ) {
        let Some(begin) = grid.cell_index(&scan.origin) else { return };
        let mut ends: Vec<VoxelIndex> = Vec::with_capacity(scan.returns.len());
        for point in &scan.returns.points {
            if (point - scan.origin).norm() <= max_range {
                match grid.cell_index(point) {
                    Some(end) => {
                        report.hits += 1;
                        if changes.add(end, number, Change::Hit) {
                            ends.push(end);
                        }
                    }
                    None => report.outside += 1,
                }
            } else if !is_finite(point) {
                report.not_finite += 1;
            }
        }
        for end in ends {
            self.clear_before(begin, end, |cell| {
                changes.add(cell, number, Change::Miss);
            });
        }
    }

    /// The last few cells on the ray from `begin` to `end`: step k of n is k/n of the distance along each
    /// axis, without its fraction.
    #[inline]
    fn clear_before(&self, begin: VoxelIndex, end: VoxelIndex, mut clear: impl FnMut(VoxelIndex)) {
        let delta = [end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]];
        let sizes = delta.map(i32::abs);
        let steps = sizes[0].max(sizes[1]).max(sizes[2]);
        // From the end: j steps back along an axis is j/n of its distance, with the fraction rounded up; a
        // product that grows by no more than n is followed by a count, without a division.
        let (mut products, mut back) = ([0; 3], [0; 3]);
        for _ in 0..self.num_free_space_voxels.min(steps) {
            let mut cell = end;
            for axis in 0..3 {
                products[axis] += sizes[axis];
                if back[axis] * steps < products[axis] {
                    back[axis] += 1;
                }
                cell[axis] -= back[axis] * delta[axis].signum();
            }
            clear(cell);
        }
    }

    /// Changes the cells; returns the number of hits for which there was no room.
    fn apply(&self, changes: Changes, grid: &mut HybridGrid) -> usize {
        let is_hit = |change: &&u64| **change >> PLACE_BITS & 1 == 0;
        let mut left_out = 0;
        let changes = changes.in_order();
        for of_block in changes.chunk_by(|a, b| a >> CHANGE_BITS == b >> CHANGE_BITS) {
            let key = BlockKey::from_number(of_block[0] >> CHANGE_BITS);
            let has_room = grid.update_block(key, |block| {
                let (mut scan, mut changed) = (u64::MAX, 0u64);
                for change in of_block {
                    let place = (change & PLACE_MASK) as u32;
                    let scan_of_change = change >> (PLACE_BITS + 1);
                    if scan_of_change != scan {
                        (scan, changed) = (scan_of_change, 0);
                    }
                    if changed & 1 << place == 0 {
                        changed |= 1 << place;
                        let is_miss = change >> PLACE_BITS & 1 == 1;
                        let table = if is_miss { &self.miss_table } else { &self.hit_table };
                        block.change(place, |code| table.updated(code) & !UPDATE_MARKER);
                    }
                }
            });
            if !has_room {
                left_out += of_block.iter().filter(is_hit).count();
            }
        }
        left_out
    }
}

/// Bits of a change: its scan, whether it is a miss, the place in the block; above these those of the block.
const SCAN_BITS: u32 = 63 - BlockKey::BITS - PLACE_BITS;
const PLACE_BITS: u32 = 6;
const PLACE_MASK: u64 = (1 << PLACE_BITS) - 1;
const CHANGE_BITS: u32 = SCAN_BITS + 1 + PLACE_BITS;
/// Number of changes from which equal ones are removed.
const MANY: usize = 1 << 22;

/// Kind of change of a cell by a scan.
#[derive(Clone, Copy)]
enum Change {
    Hit = 0,
    Miss = 1,
}

/// Changes of cells by scans, a number each: in the order of scans, for each scan its hits first.
struct Changes {
    numbers: Vec<u64>,
    /// Number of changes at which equal ones are removed.
    limit: usize,
    /// Some of the cells that the scan has changed. Most hits in coarse cells, and many cells before hits, are in one
    /// that was changed a little earlier.
    recent: Vec<u64>,
}

/// Number of recent cells that are kept, as a power of two: as many as fit the nearest cache.
const RECENT_BITS: u32 = 11;

impl Default for Changes {
    fn default() -> Self {
        Self { numbers: Vec::new(), limit: MANY, recent: vec![u64::MAX; 1 << RECENT_BITS] }
    }
}

impl Changes {
    /// Adds a change; false for one of a cell that the scan is known to have changed before.
    #[inline]
    fn add(&mut self, cell: VoxelIndex, scan: u64, change: Change) -> bool {
        // Rays begin and end in possible cells, and so are all cells between.
        let Some((key, place)) = BlockKey::of(cell) else { return false };
        let by_hit = key.number() << CHANGE_BITS | scan << (PLACE_BITS + 1) | u64::from(place);
        let slot = by_hit.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - RECENT_BITS);
        if std::mem::replace(&mut self.recent[slot as usize], by_hit) == by_hit {
            return false;
        }
        self.numbers.push(by_hit | (change as u64) << PLACE_BITS);
        if self.numbers.len() >= self.limit {
            self.numbers.sort_unstable();
            self.numbers.dedup();
            self.limit = MANY.max(2 * self.numbers.len());
        }
        true
    }

    /// The changes in order of blocks.
    fn in_order(mut self) -> Vec<u64> {
        sort_by_voxel(&mut self.numbers, CHANGE_BITS);
        self.numbers
    }
}

#[cfg(test)]
mod tests;
