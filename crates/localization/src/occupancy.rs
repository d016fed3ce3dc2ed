//! Classifies the voxels of a whole 3D map as solid, free or unknown.

use portolan_geometry::{Point3f, to_f32};
use portolan_grids::{GridError, MAX_VOXEL_INDEX, SOLID_VOXEL, VoxelIndex, VoxelLattice};
use portolan_mapping::{GraphState, Space3d};

use crate::settings::maps::{FREE_BEAM_CLEARANCE, FREE_BEAM_RANGE, GONE_PROBABILITY, OCCUPANCY_CELL};
use crate::submap_cells::SubmapCells;
use crate::voxel_states::{VoxelState, VoxelStates};

/// Negative of the smallest index of a cell.
const FIRST: i32 = MAX_VOXEL_INDEX;

/// Cells that are solid, free or unknown.
pub(crate) struct Occupancy {
    lattice: VoxelLattice,
    cells: VoxelStates,
}

/// An occupancy to which submaps are added, one after the other.
pub(crate) struct OccupancyBuilder {
    occupancy: Occupancy,
    /// Centres of fine cells with a low probability, where nothing is left.
    faded: Vec<Point3f>,
}

impl OccupancyBuilder {
    /// An occupancy without submaps.
    ///
    /// # Errors
    /// If the grid cannot be made.
    pub fn new() -> Result<Self, GridError> {
        let occupancy = Occupancy { lattice: VoxelLattice::new(OCCUPANCY_CELL)?, cells: VoxelStates::new() };
        Ok(Self { occupancy, faded: Vec::new() })
    }

    /// Adds a submap.
    pub fn add(&mut self, submap: &SubmapCells) {
        let Occupancy { lattice, cells } = &mut self.occupancy;
        for (place, probability) in &submap.cells {
            if *probability < GONE_PROBABILITY {
                self.faded.push(*place);
            } else if *probability > SOLID_VOXEL
                && let Some(cell) = lattice.cell(place)
            {
                cells.learn(cell, VoxelState::Solid);
            }
        }
    }

    /// Adds the beams of all nodes and returns the result.
    pub fn finish(self, state: &GraphState<Space3d>) -> Occupancy {
        let Self { occupancy: Occupancy { lattice, mut cells }, faded } = self;
        for place in faded {
            let Some(cell) = lattice.cell(&place) else { continue };
            if !around(cell).any(|cell| cells.get(cell) == Some(VoxelState::Solid)) {
                cells.learn(cell, VoxelState::Free);
            }
        }
        for node in state.nodes.values() {
            let pose = to_f32(&node.map_from_tracking);
            let origin = Point3f::from(pose.translation.vector);
            let clouds = [&node.data.high_resolution_point_cloud, &node.data.low_resolution_point_cloud];
            for point in clouds.into_iter().flat_map(|cloud| &cloud.points) {
                let beam = pose * point - origin;
                let length = beam.norm();
                let steps =
                    ((length.min(FREE_BEAM_RANGE) - FREE_BEAM_CLEARANCE) / OCCUPANCY_CELL).max(0.0) as u32;
                // In cells, offset so that no index is negative: truncation then gives the index.
                let first = origin.coords.map(|v| v / OCCUPANCY_CELL + 0.5 + FIRST as f32);
                let step = beam / length;
                for i in 2..steps {
                    let cell = (first + step * i as f32).map(|v| (v as i32).saturating_sub(FIRST));
                    cells.learn(cell.into(), VoxelState::Free);
                }
            }
        }
        Occupancy { lattice, cells }
    }
}

impl Occupancy {
    /// The cell of a point; none outside the range of indices.
    #[inline]
    pub fn cell(&self, point: &Point3f) -> Option<VoxelIndex> {
        self.lattice.cell(point)
    }

    /// The middle of a cell, metres.
    pub fn middle(&self, cell: VoxelIndex) -> Point3f {
        self.lattice.center(cell)
    }

    /// Whether a cell is solid.
    #[inline]
    pub fn is_solid(&self, cell: VoxelIndex) -> bool {
        self.cells.get(cell) == Some(VoxelState::Solid)
    }

    /// Whether beams passed through a cell, or the object in it is gone.
    #[inline]
    pub fn is_free_cell(&self, cell: VoxelIndex) -> bool {
        self.cells.get(cell) == Some(VoxelState::Free)
    }

    /// Middles of the solid cells.
    pub fn solid(&self) -> Vec<Point3f> {
        let mut solid = Vec::new();
        self.cells.for_each_solid(|cell| solid.push(self.lattice.center(cell)));
        solid
    }

    /// Whether the cell of a point or one of its six neighbours is solid.
    pub fn is_solid_near(&self, point: &Point3f) -> bool {
        const AROUND: [[i32; 3]; 7] =
            [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
        let Some([x, y, z]) = self.lattice.cell(point) else { return false };
        AROUND.iter().any(|[i, j, k]| self.is_solid([x + i, y + j, z + k]))
    }

    /// Whether a point is in a free cell.
    pub fn is_free(&self, point: &Point3f) -> bool {
        let Some(cell) = self.lattice.cell(point) else { return false };
        self.is_free_cell(cell)
    }
}

/// A cell and the 26 around it.
pub(crate) fn around([x, y, z]: VoxelIndex) -> impl Iterator<Item = VoxelIndex> {
    (-1..=1).flat_map(move |i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [x + i, y + j, z + k])))
}
