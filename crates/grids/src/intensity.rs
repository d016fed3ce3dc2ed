//! Mean intensities of cells in 3D.

use portolan_geometry::Point3f;

use super::hybrid::VoxelLattice;
use super::voxel_map::VoxelMap;
use super::{GridError, VoxelIndex};

/// Sum and number of the intensities measured in a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Average {
    sum: f32,
    count: u32,
}

impl Average {
    /// The mean intensity; 0 if there is none.
    #[inline]
    pub fn mean(&self) -> f32 {
        if self.count == 0 { 0.0 } else { self.sum / self.count as f32 }
    }
}

/// Mean intensity that a lidar measured in each cell. Unknown cells have intensity 0.
#[derive(Clone, Debug, PartialEq)]
pub struct IntensityGrid {
    lattice: VoxelLattice,
    cells: VoxelMap<Average>,
}

impl IntensityGrid {
    /// An empty grid of cells with an edge of `resolution` metres.
    ///
    /// # Errors
    /// If the resolution is not positive and finite.
    pub fn new(resolution: f32) -> Result<Self, GridError> {
        Ok(Self { lattice: VoxelLattice::new(resolution)?, cells: VoxelMap::default() })
    }

    /// Edge of a cell, metres.
    pub fn resolution(&self) -> f32 {
        self.lattice.resolution
    }

    /// Geometry of its cells.
    #[inline]
    pub fn lattice(&self) -> VoxelLattice {
        self.lattice
    }

    /// The values of its known cells.
    #[inline]
    pub fn cells(&self) -> &VoxelMap<Average> {
        &self.cells
    }

    /// Number of cells with an intensity.
    pub fn num_cells(&self) -> usize {
        self.cells.num_cells()
    }

    /// The cell of a point (metres, in the frame of the grid); none if it is not finite or too far away.
    pub fn cell_index(&self, point: &Point3f) -> Option<VoxelIndex> {
        self.lattice.cell(point)
    }

    /// Adds an intensity to a cell. Returns whether there is such a cell; not-a-number is left out.
    pub fn add_intensity(&mut self, cell: VoxelIndex, intensity: f32) -> bool {
        if !intensity.is_finite() {
            return false;
        }
        let Some(average) = self.cells.entry(cell) else { return false };
        average.sum += intensity;
        average.count = average.count.saturating_add(1);
        true
    }

    /// The mean of the intensities measured in a cell; 0 if there are none.
    pub fn intensity(&self, cell: VoxelIndex) -> f32 {
        self.cells.get(cell).unwrap_or_default().mean()
    }

    /// Memory taken, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.cells.memory_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intensities_are_averaged() {
        let mut grid = IntensityGrid::new(0.3).unwrap();
        let cell = grid.cell_index(&Point3f::new(0.4, -0.1, 1.0)).unwrap();
        assert_eq!((cell, grid.intensity(cell)), ([1, 0, 3], 0.0));
        for value in [10.0, 20.0, 60.0] {
            assert!(grid.add_intensity(cell, value));
        }
        assert_eq!((grid.intensity(cell), grid.intensity([1, 0, 2])), (30.0, 0.0));
        assert!(!grid.add_intensity(cell, f32::NAN) && !grid.add_intensity([8192, 0, 0], 1.0));
    }
}
