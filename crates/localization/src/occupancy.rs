//! What of space is solid and what is free, over a whole map.

use portolan_geometry::{Point3f, to_f32};
use portolan_grids::{GridError, VoxelIndex, VoxelLattice};
use portolan_mapping::{GraphState, Spatial};

use crate::voxel_states::{VoxelState, VoxelStates};

/// Edge of a cell, metres.
pub(crate) const CELL: f32 = 0.2;
/// Cells of submaps of this probability are solid.
pub(crate) const SOLID: f32 = 0.55;
/// Cells of submaps of less than this are free, if nothing solid is near: what was there is gone.
const GONE: f32 = 0.12;
/// Beams of nodes show free space to this range, and end so far in front of what they hit, metres: floors are met at
/// grazing angles.
const RANGE: f32 = 25.0;
const IN_FRONT: f32 = 0.8;

/// Cells that are solid, free or not known.
pub(crate) struct Occupancy {
    lattice: VoxelLattice,
    cells: VoxelStates,
}

impl Occupancy {
    /// Of all submaps and nodes, where the pose graph puts them.
    pub fn new(state: &GraphState<Spatial>) -> Result<Self, GridError> {
        let lattice = VoxelLattice::new(CELL)?;
        let mut cells = VoxelStates::new();
        for (id, entry) in &state.submaps {
            let (Some(submap), Some(pose)) = (&entry.submap, state.map_from_submap(*id)) else { continue };
            let (pose, grid) = (to_f32(&pose), &submap.high_resolution_grid);
            grid.for_each_cell(|cell, _| {
                if grid.probability(cell) > SOLID
                    && let Some(cell) = lattice.cell(&(pose * grid.cell_center(cell)))
                {
                    cells.learn(cell, VoxelState::Solid);
                }
            });
        }
        for place in faded(state) {
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
                let steps = ((length.min(RANGE) - IN_FRONT) / CELL).max(0.0) as u32;
                for i in 2..steps {
                    if let Some(cell) = lattice.cell(&(origin + beam * (i as f32 * CELL / length))) {
                        cells.learn(cell, VoxelState::Free);
                    }
                }
            }
        }
        Ok(Self { lattice, cells })
    }

    /// The cell of a point; none where there can be none.
    pub fn cell(&self, point: &Point3f) -> Option<VoxelIndex> {
        self.lattice.cell(point)
    }

    /// The middle of a cell, metres.
    pub fn middle(&self, cell: VoxelIndex) -> Point3f {
        self.lattice.center(cell)
    }

    /// Whether a cell is solid.
    pub fn is_solid(&self, cell: VoxelIndex) -> bool {
        self.cells.get(cell) == Some(VoxelState::Solid)
    }

    /// Whether beams went through a cell, or what was there is gone.
    pub fn is_free_cell(&self, cell: VoxelIndex) -> bool {
        self.cells.get(cell) == Some(VoxelState::Free)
    }

    /// Middles of the solid cells.
    pub fn solid(&self) -> Vec<Point3f> {
        let mut solid = Vec::new();
        self.cells.for_each_solid(|cell| solid.push(self.lattice.center(cell)));
        solid
    }

    /// Whether something solid is in the cell of a point or right beside it.
    pub fn is_solid_near(&self, point: &Point3f) -> bool {
        const AROUND: [[i32; 3]; 7] =
            [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
        let Some([x, y, z]) = self.lattice.cell(point) else { return false };
        AROUND.iter().any(|[i, j, k]| self.is_solid([x + i, y + j, z + k]))
    }

    /// Whether a point is where beams went through.
    pub fn is_free(&self, point: &Point3f) -> bool {
        let Some(cell) = self.lattice.cell(point) else { return false };
        self.is_free_cell(cell)
    }
}

/// A cell and the 26 around it.
pub(crate) fn around([x, y, z]: VoxelIndex) -> impl Iterator<Item = VoxelIndex> {
    (-1..=1).flat_map(move |i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [x + i, y + j, z + k])))
}

/// Where fine cells of submaps say that nothing is there.
fn faded(state: &GraphState<Spatial>) -> Vec<Point3f> {
    let mut places = Vec::new();
    for (id, entry) in &state.submaps {
        let (Some(submap), Some(pose)) = (&entry.submap, state.map_from_submap(*id)) else { continue };
        let (pose, grid) = (to_f32(&pose), &submap.high_resolution_grid);
        grid.for_each_cell(|cell, _| {
            if grid.probability(cell) < GONE {
                places.push(pose * grid.cell_center(cell));
            }
        });
    }
    places
}
