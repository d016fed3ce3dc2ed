//! Reduces clouds of any size to one point per voxel.
//!
//! Cells accumulate in memory until there are [`CELLS_IN_MEMORY`] of them. They are then sorted, written to a
//! temporary file as a run, and dropped from memory. At the end all runs are merged in order of their cells.
//! Memory is independent of the number of points and of the size of the cloud; the disk holds 60 bytes for
//! each cell of each run. The same points in the same order give the same cloud.

mod runs;

use std::path::Path;

use portolan_spatial::{VoxelHash, VoxelKey as Key};

use crate::error::CloudError;
use runs::{Cell, Runs};

/// Maximum number of cells in memory: about 150 MB.
pub const CELLS_IN_MEMORY: usize = 1 << 20;

/// Mean of the points of a voxel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelPoint {
    /// Mean position, metres.
    pub position: [f64; 3],
    /// Mean intensity.
    pub intensity: f32,
    /// Mean time, in the seconds of the points.
    pub time: f64,
    /// Number of points.
    pub count: u64,
}

/// Accumulates points in voxels.
pub struct VoxelThinner {
    voxel_size: f64,
    cells_in_memory: usize,
    cells: VoxelHash<Cell>,
    runs: Runs,
    /// Times are summed relative to the first one to keep their precision.
    first_time: Option<f64>,
    not_finite: u64,
}

impl VoxelThinner {
    /// An empty thinner; `voxel_size` in metres.
    ///
    /// # Errors
    /// Fails if the size is not 0.1 mm to 1 km.
    pub fn new(voxel_size: f64) -> Result<Self, CloudError> {
        Self::with_memory(voxel_size, CELLS_IN_MEMORY)
    }

    /// As [`VoxelThinner::new`], with at most this number of cells in memory.
    ///
    /// # Errors
    /// Fails if the size is not 0.1 mm to 1 km.
    pub fn with_memory(voxel_size: f64, cells_in_memory: usize) -> Result<Self, CloudError> {
        check_voxel_size(voxel_size)?;
        Ok(Self {
            voxel_size,
            cells_in_memory: cells_in_memory.max(1),
            cells: VoxelHash::default(),
            runs: Runs::in_folder(&std::env::temp_dir()),
            first_time: None,
            not_finite: 0,
        })
    }

    /// Writes cells that do not fit in memory to a file in this folder instead of that for temporary files.
    #[must_use]
    pub fn in_folder(mut self, folder: &Path) -> Self {
        self.runs = Runs::in_folder(folder);
        self
    }

    /// Adds a point; one that is not finite or farther than two thousand million voxels is only counted.
    ///
    /// # Errors
    /// Fails if the temporary file cannot be written.
    #[inline]
    pub fn add(&mut self, position: [f64; 3], intensity: f32, time: f64) -> Result<(), CloudError> {
        let scaled = position.map(|v| v / self.voxel_size);
        if !scaled.iter().all(|v| v.abs() < 2e9) || !time.is_finite() {
            self.not_finite += 1;
            return Ok(());
        }
        let [x, y, z] = scaled.map(f64::floor);
        let key = [x as i32, y as i32, z as i32];
        let first_time = *self.first_time.get_or_insert(time);
        let within = [scaled[0] - x, scaled[1] - y, scaled[2] - z];
        self.cells.or_default(key).add(within, intensity, time - first_time);
        if self.cells.len() >= self.cells_in_memory { self.spill() } else { Ok(()) }
    }

    fn spill(&mut self) -> Result<(), CloudError> {
        let cells = self.cells.drain_sorted();
        self.runs.write(&cells)
    }

    /// Ends the accumulation.
    ///
    /// # Errors
    /// Fails if the temporary file cannot be written.
    pub fn finish(mut self) -> Result<ThinnedCloud, CloudError> {
        if !self.runs.is_empty() {
            self.spill()?;
        }
        let cells = self.cells.drain_sorted();
        let Self { voxel_size, runs, first_time, not_finite, .. } = self;
        Ok(ThinnedCloud { voxel_size, cells, runs, first_time: first_time.unwrap_or(0.0), not_finite })
    }
}

pub(crate) fn check_voxel_size(voxel_size: f64) -> Result<(), CloudError> {
    if (1e-4..=1e3).contains(&voxel_size) { Ok(()) } else { Err(CloudError::VoxelSize(voxel_size)) }
}

/// A cloud with one point per voxel, which can be read repeatedly.
pub struct ThinnedCloud {
    voxel_size: f64,
    /// All cells, if they fit in memory; otherwise none.
    cells: Vec<(Key, Cell)>,
    runs: Runs,
    first_time: f64,
    not_finite: u64,
}

impl ThinnedCloud {
    /// Number of points left out because their values are not finite.
    pub fn not_finite(&self) -> u64 {
        self.not_finite
    }

    /// Visits all voxels in ascending order of x, then y, then z; an error of `visit` ends the iteration.
    ///
    /// # Errors
    /// Fails if the temporary file cannot be read, or as `visit` does.
    pub fn for_each(
        &mut self,
        visit: &mut dyn FnMut(&VoxelPoint) -> Result<(), CloudError>,
    ) -> Result<(), CloudError> {
        let (size, first_time) = (self.voxel_size, self.first_time);
        let mut each = |key: &Key, cell: &Cell| visit(&cell.point(*key, size, first_time));
        if self.runs.is_empty() {
            return self.cells.iter().try_for_each(|(key, cell)| each(key, cell));
        }
        self.runs.merge(&mut each)
    }
}

#[cfg(test)]
mod tests;
