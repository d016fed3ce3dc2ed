//! What of space is solid and what is free, over a whole map.

use portolan_geometry::{Point3f, to_f32};
use portolan_grids::{GridError, HybridGrid};
use portolan_mapping::{GraphState, Spatial};

/// Edge of a cell, metres.
const CELL: f32 = 0.2;
/// Cells of submaps of this probability are solid.
const SOLID: f32 = 0.55;
/// How the two are kept.
const IS_SOLID: f32 = 0.9;
const IS_FREE: f32 = 0.1;
/// Beams of nodes show free space to this range, and end so far in front of what they hit, metres: floors are met at
/// grazing angles.
const RANGE: f32 = 25.0;
const IN_FRONT: f32 = 0.8;

/// Cells that are solid, free or not known.
pub(crate) struct Occupancy {
    cells: HybridGrid,
}

impl Occupancy {
    /// Of all submaps and nodes, where the pose graph puts them.
    pub fn new(state: &GraphState<Spatial>) -> Result<Self, GridError> {
        let mut cells = HybridGrid::new(CELL)?;
        let mut set = |point: &Point3f, probability: f32| {
            if let Some(cell) = cells.cell_index(point)
                && !cells.is_known(cell)
            {
                cells.set_probability(cell, probability);
            }
        };
        for (id, entry) in &state.submaps {
            let (Some(submap), Some(pose)) = (&entry.submap, state.map_from_submap(*id)) else { continue };
            let (pose, grid) = (to_f32(&pose), &submap.high_resolution_grid);
            grid.for_each_cell(|cell, _| {
                if grid.probability(cell) > SOLID {
                    set(&(pose * grid.cell_center(cell)), IS_SOLID);
                }
            });
        }
        for node in state.nodes.values() {
            let pose = to_f32(&node.map_from_tracking);
            let origin = Point3f::from(pose.translation.vector);
            let clouds = [&node.data.high_resolution_point_cloud, &node.data.low_resolution_point_cloud];
            for point in clouds.into_iter().flat_map(|cloud| &cloud.points) {
                let beam = pose * point - origin;
                let length = beam.norm();
                let steps = ((length.min(RANGE) - IN_FRONT) / CELL).max(0.0) as u32;
                (2..steps).for_each(|i| set(&(origin + beam * (i as f32 * CELL / length)), IS_FREE));
            }
        }
        Ok(Self { cells })
    }

    /// Middles of the solid cells.
    pub fn solid(&self) -> Vec<Point3f> {
        let mut solid = Vec::new();
        self.cells.for_each_cell(|cell, _| {
            if self.cells.probability(cell) > 0.5 {
                solid.push(self.cells.cell_center(cell));
            }
        });
        solid
    }

    /// Whether something solid is in the cell of a point or right beside it.
    pub fn is_solid_near(&self, point: &Point3f) -> bool {
        const AROUND: [[i32; 3]; 7] =
            [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
        let Some([x, y, z]) = self.cells.cell_index(point) else { return false };
        AROUND.iter().any(|[i, j, k]| {
            let cell = [x + i, y + j, z + k];
            self.cells.is_known(cell) && self.cells.probability(cell) > 0.5
        })
    }

    /// Whether a point is where beams went through.
    pub fn is_free(&self, point: &Point3f) -> bool {
        let Some(cell) = self.cells.cell_index(point) else { return false };
        self.cells.is_known(cell) && self.cells.probability(cell) < 0.5
    }
}
