//! Places the fine cells of the submaps of a 3D map at their poses in the pose graph.

use portolan_geometry::{Point3f, to_f32};
use portolan_mapping::{GraphState, Space3d, SubmapEntry};

/// A submap and its fine cells.
pub(crate) struct SubmapCells<'a> {
    pub entry: &'a SubmapEntry<Space3d>,
    /// Position of the submap, metres in the map.
    pub origin: Point3f,
    /// Centres of its known cells, metres in the map, and their probabilities of being solid.
    pub cells: Vec<(Point3f, f32)>,
}

/// All submaps that have grids, one after the other: each is read once.
pub(crate) fn submap_cells(state: &GraphState<Space3d>) -> impl Iterator<Item = SubmapCells<'_>> {
    state.submaps.iter().filter_map(|(id, entry)| {
        let (submap, pose) = (entry.submap.as_ref()?, state.map_from_submap(*id)?);
        let (pose, grid) = (to_f32(&pose), &submap.high_resolution_grid);
        let mut cells = Vec::with_capacity(grid.num_cells());
        grid.for_each_cell(|cell, _| cells.push((pose * grid.cell_center(cell), grid.probability(cell))));
        Some(SubmapCells { entry, origin: Point3f::from(pose.translation.vector), cells })
    })
}
