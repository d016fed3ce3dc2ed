//! The grid of 3D submaps: probabilities that cells in 3D are occupied.

use portolan_geometry::Point3f;
use portolan_sensor::lround_small;

use super::value::{MIN_PROBABILITY, PROBABILITY_CODE, UNKNOWN_CELL};
use super::voxel_map::{Block, BlockKey, VoxelMap};
use super::{GridError, MAX_VOXEL_INDEX, VoxelIndex};

/// Geometry of the cells of a grid in 3D: cell i spans half an edge to both sides of i times the edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelLattice {
    /// Edge of a cell, metres.
    pub resolution: f32,
}

impl VoxelLattice {
    /// Cells with an edge of `resolution` metres.
    ///
    /// # Errors
    /// If that is not positive and finite.
    pub fn new(resolution: f32) -> Result<Self, GridError> {
        if resolution > 0.0 && resolution.is_finite() {
            Ok(Self { resolution })
        } else {
            Err(GridError::InvalidResolution(resolution))
        }
    }

    /// The cell of a position, each coordinate divided in single precision and rounded half away from zero;
    /// none where there are no cells.
    #[inline]
    pub fn cell(&self, point: &Point3f) -> Option<VoxelIndex> {
        let cell = self.unchecked_cell([point.x, point.y, point.z]);
        super::voxel_map::is_possible(cell).then_some(cell)
    }

    /// The same without checking whether there is such a cell; far away, and where a coordinate is
    /// not-a-number, the result is outside.
    #[inline(always)]
    pub fn unchecked_cell(&self, place: [f32; 3]) -> VoxelIndex {
        // Written out: `map` on arrays is not always compiled into the loops that need it.
        [self.index(place[0]), self.index(place[1]), self.index(place[2])]
    }

    #[inline(always)]
    fn index(&self, coordinate: f32) -> i32 {
        let scaled = coordinate / self.resolution;
        // Beyond these bounds there are no cells; not-a-number becomes the upper one.
        let bound = MAX_VOXEL_INDEX as f32 + 1.0;
        lround_small(if scaled < bound { scaled.max(-bound) } else { bound })
    }

    /// The centre of a cell, metres.
    pub fn center(&self, cell: VoxelIndex) -> Point3f {
        Point3f::from(cell.map(|i| i as f32 * self.resolution))
    }
}

/// Probabilities of cells in 3D, of which only the known ones take memory (3 to 5 bytes each where a
/// surface was seen). Indices reach from −8192 to 8191 along each axis.
#[derive(Clone, Debug, PartialEq)]
pub struct HybridGrid {
    lattice: VoxelLattice,
    cells: VoxelMap<u16>,
}

impl HybridGrid {
    /// An empty grid of cells with an edge of `resolution` metres.
    ///
    /// # Errors
    /// If the resolution is not positive and finite.
    pub fn new(resolution: f32) -> Result<Self, GridError> {
        Ok(Self::of_cells(VoxelLattice::new(resolution)?, VoxelMap::default()))
    }

    fn of_cells(lattice: VoxelLattice, cells: VoxelMap<u16>) -> Self {
        Self { lattice, cells }
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

    /// The values of its known cells, coded.
    #[inline]
    pub fn cells(&self) -> &VoxelMap<u16> {
        &self.cells
    }

    /// Number of known cells.
    pub fn num_cells(&self) -> usize {
        self.cells.num_cells()
    }

    /// Edge, in cells, of the cube around the origin that Cartographer would have reserved: 128, doubled
    /// until it holds all known cells. The search of whole submaps covers it.
    pub fn extent(&self) -> u32 {
        self.cells.extent()
    }

    /// The cell of a point (metres, in the frame of the grid); none if it is not finite or too far away.
    #[inline]
    pub fn cell_index(&self, point: &Point3f) -> Option<VoxelIndex> {
        self.lattice.cell(point)
    }

    /// The centre of a cell, metres.
    pub fn cell_center(&self, cell: VoxelIndex) -> Point3f {
        self.lattice.center(cell)
    }

    /// The code of a cell; 0 if unknown.
    #[inline]
    pub fn code(&self, cell: VoxelIndex) -> u16 {
        self.cells.get(cell).unwrap_or(UNKNOWN_CELL)
    }

    /// Whether something is known about a cell.
    pub fn is_known(&self, cell: VoxelIndex) -> bool {
        self.cells.get(cell).is_some()
    }

    /// The probability of a cell; 0.1 if unknown.
    #[inline]
    pub fn probability(&self, cell: VoxelIndex) -> f32 {
        PROBABILITY_CODE.decode(self.code(cell), MIN_PROBABILITY)
    }

    /// The probabilities of the eight cells from `low` to `low + (1, 1, 1)`, in the order of [`VoxelMap::corners`].
    #[inline]
    pub fn corner_probabilities(&self, low: VoxelIndex) -> [f32; 8] {
        let decode =
            |code: Option<u16>| PROBABILITY_CODE.decode(code.unwrap_or(UNKNOWN_CELL), MIN_PROBABILITY);
        self.cells.corners(low).map(decode)
    }

    /// Sets the probability of a cell, clamped to [0.1, 0.9]. Returns whether there is such a cell.
    pub fn set_probability(&mut self, cell: VoxelIndex, probability: f32) -> bool {
        self.set_code(cell, PROBABILITY_CODE.encode(probability))
    }

    pub(crate) fn set_code(&mut self, cell: VoxelIndex, code: u16) -> bool {
        self.cells.entry(cell).map(|value| *value = code).is_some()
    }

    /// Changes codes of the cells of one block. False if there is no room for them.
    pub(crate) fn update_block(&mut self, key: BlockKey, update: impl FnOnce(&mut Block<u16>)) -> bool {
        self.cells.update_block(key, update)
    }

    /// Visits every known cell with its code, in the order of map files.
    pub fn for_each_cell(&self, visit: impl FnMut(VoxelIndex, u16)) {
        self.cells.for_each_in_file_order(visit);
    }

    /// A grid of the same cells of which none is known.
    #[must_use]
    pub fn emptied(&self) -> Self {
        Self::of_cells(self.lattice, VoxelMap::default())
    }

    /// The same grid without spare memory, for submaps that are finished.
    #[must_use]
    pub fn compacted(&self) -> Self {
        Self::of_cells(self.lattice, self.cells.compacted())
    }

    /// Memory taken, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.cells.memory_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Lcg;

    #[test]
    fn points_belong_to_the_nearest_cell() {
        let grid = HybridGrid::new(2.0).unwrap();
        for (point, cell) in [
            ((0.0, 26.0, 10.0), [0, 13, 5]),
            ((14.0, 0.0, 10.0), [7, 0, 5]),
            ((14.0, 26.0, 0.0), [7, 13, 0]),
            ((8.5, 11.5, 0.5), [4, 6, 0]),
            ((7.5, 12.5, 1.5), [4, 6, 1]),
            ((6.5, 14.5, 2.5), [3, 7, 1]),
            ((5.5, 13.5, 3.5), [3, 7, 2]),
            ((-1.0, -0.99, 1.0), [-1, 0, 1]),
        ] {
            assert_eq!(grid.cell_index(&Point3f::new(point.0, point.1, point.2)), Some(cell));
        }
        assert_eq!(grid.cell_center([3, 2, 1]), Point3f::new(6.0, 4.0, 2.0));
        for far in [16383.0, -16386.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(grid.cell_index(&Point3f::new(0.0, far, 0.0)), None, "{far}");
        }
        assert_eq!(grid.cell_index(&Point3f::new(-16384.0, 0.0, 16382.0)), Some([-8192, 0, 8191]));
    }

    #[test]
    fn rounding_is_that_of_the_standard_library() {
        let lattice = VoxelLattice::new(0.1).unwrap();
        let mut lcg = Lcg::new(9);
        for _ in 0..20_000 {
            let v = (lcg.symmetric(800.0) * 20.0).round() / 20.0;
            assert_eq!(lattice.unchecked_cell([v; 3])[0], (v / 0.1f32).round() as i32, "{v}");
        }
        assert_eq!(VoxelLattice::new(1.0).unwrap().unchecked_cell([0.499_999_97; 3]), [0; 3]);
    }

    #[test]
    fn probabilities_are_kept() {
        let mut grid = HybridGrid::new(1.0).unwrap();
        let cell = [5, -5, 2];
        assert!(!grid.is_known(cell) && grid.probability(cell) == 0.1);
        assert!(grid.set_probability(cell, 0.7) && !grid.set_probability([9000, 0, 0], 0.7));
        assert!(grid.is_known(cell) && (grid.probability(cell) - 0.7).abs() < 1e-4);
        assert!(HybridGrid::new(0.0).is_err() && HybridGrid::new(f32::NAN).is_err());
    }

    #[test]
    fn corners_have_the_probabilities_of_their_cells() {
        let (mut grid, mut lcg) = (HybridGrid::new(1.0).unwrap(), Lcg::new(4));
        let mut cell = || [0; 3].map(|_| lcg.symmetric(6.0) as i32);
        for i in 0..400 {
            grid.set_probability(cell(), 0.1 + 0.002 * i as f32);
        }
        for low in (0..400).map(|_| cell()).chain([[MAX_VOXEL_INDEX - 1; 3]]) {
            let expected = [0, 1, 2, 3, 4, 5, 6, 7]
                .map(|c| grid.probability([low[0] + (c & 1), low[1] + (c >> 1 & 1), low[2] + (c >> 2)]));
            assert_eq!(grid.corner_probabilities(low), expected, "{low:?}");
        }
    }
}
