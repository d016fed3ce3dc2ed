//! Updates cells of 2D submaps, and points of nodes, that newer submaps contradict.

use std::collections::BTreeSet;
use std::sync::Arc;

use portolan_geometry::{Rigid2, Vector2, project_2d};
use portolan_grids::{CellIndex, CellValue, Grid2d};
use portolan_sensor::PointCloud;

use super::PoseGraph;
use crate::{NodeId, Space2d, SubmapId, TrajectoryId, of_trajectory};

/// Change of a place of the map in older submaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellFate {
    /// It stays as it is.
    Kept,
    /// Known cells take the value of newer submaps.
    Replaced,
    /// Unknown cells take the value of newer submaps, in submaps in which something is replaced.
    Filled,
}

/// A grid and its pose in the map.
struct PlacedGrid<'a> {
    grid: &'a Grid2d,
    grid_from_map: Rigid2,
}

impl PlacedGrid<'_> {
    fn value(&self, point: &Vector2) -> CellValue {
        let point = self.grid_from_map.transform_point(point);
        self.grid.value(self.grid.limits().cell_index(point.cast::<f32>()))
    }
}

impl PoseGraph<Space2d> {
    /// Transfers cell values from the submaps of one trajectory into those of the others, where `fate` of a
    /// point of the map says so; returns the number of changed cells. Cells that the newer submaps do not
    /// know become unknown.
    pub fn patch(&mut self, newer: TrajectoryId, fate: &(dyn Fn(&Vector2) -> CellFate + Sync)) -> usize {
        let state = &self.state;
        let sources: Vec<PlacedGrid> = of_trajectory(&state.submaps, newer)
            .filter_map(|(id, entry)| {
                let grid_from_map = self.map_from_grid(id)?.inverse();
                Some(PlacedGrid { grid: &entry.submap.as_ref()?.grid, grid_from_map })
            })
            .collect();
        let newest = |point: &Vector2| {
            let values = sources.iter().map(|source| source.value(point));
            values.into_iter().find(|value| *value != CellValue::Unknown).unwrap_or(CellValue::Unknown)
        };
        let older = state.submaps.keys().filter(|id| id.trajectory_id != newer);
        let rewritten: Vec<(SubmapId, Grid2d, usize)> =
            older.filter_map(|id| self.patched(*id, fate, &newest)).collect();
        let mut cells = 0;
        for (id, grid, count) in rewritten {
            if let Some(submap) = self.state.submaps.get_mut(&id).and_then(|entry| entry.submap.as_mut()) {
                Arc::make_mut(submap).grid = grid;
            }
            self.search.delete_matcher(id);
            cells += count;
        }
        cells
    }

    fn map_from_grid(&self, id: SubmapId) -> Option<Rigid2> {
        let local_from_submap = self.state.submaps.get(&id)?.local_from_submap;
        Some(project_2d(&(self.state.map_from_submap(id)? * local_from_submap.inverse())))
    }

    /// The grid of a submap with the values of newer ones; none if nothing of it is replaced.
    fn patched(
        &self,
        id: SubmapId,
        fate: &(dyn Fn(&Vector2) -> CellFate + Sync),
        newest: &dyn Fn(&Vector2) -> CellValue,
    ) -> Option<(SubmapId, Grid2d, usize)> {
        let grid = &self.state.submaps.get(&id)?.submap.as_ref()?.grid;
        let map_from_grid = self.map_from_grid(id)?;
        let limits = *grid.limits();
        let point = |cell: CellIndex| map_from_grid.transform_point(&limits.cell_center(cell));
        let is_replaced = |cell: CellIndex| grid.is_known(cell) && fate(&point(cell)) == CellFate::Replaced;
        if !grid.known_cells_box()?.cells().any(is_replaced) {
            return None;
        }
        let mut patched = grid.clone();
        let count = patched.rewrite(|cell| {
            let point = point(cell);
            let is_due = match fate(&point) {
                CellFate::Kept => false,
                CellFate::Replaced => grid.is_known(cell),
                CellFate::Filled => !grid.is_known(cell),
            };
            is_due.then(|| newest(&point))
        });
        Some((id, patched, count))
    }

    /// Removes points from the scans of nodes of other trajectories where `is_gone` is true of a point of the
    /// map: they are not to be matched any more. Scans of which nothing would be left stay. Returns the
    /// number of points removed.
    pub fn forget_points(&mut self, newer: TrajectoryId, is_gone: &dyn Fn(&Vector2) -> bool) -> usize {
        let older: BTreeSet<NodeId> =
            self.state.nodes.keys().filter(|id| id.trajectory_id != newer).copied().collect();
        let mut forgotten = 0;
        for id in older {
            let Some(map_from_node) = self.problem.nodes.get(&id).map(|node| project_2d(&node.map_from_node))
            else {
                continue;
            };
            let Some(node) = self.state.nodes.get_mut(&id) else { continue };
            let cloud = &node.data.filtered_gravity_aligned_point_cloud;
            let is_removed: Vec<bool> = cloud
                .points
                .iter()
                .map(|p| is_gone(&map_from_node.transform_point(&Vector2::new(p.x.into(), p.y.into()))))
                .collect();
            let count = is_removed.iter().filter(|is_removed| **is_removed).count();
            if count == 0 || count == is_removed.len() {
                continue;
            }
            let left = cloud
                .points
                .iter()
                .zip(&is_removed)
                .filter(|(_, is_removed)| !**is_removed)
                .map(|(point, _)| *point);
            let left = PointCloud::new(left.collect());
            Arc::make_mut(&mut node.data).filtered_gravity_aligned_point_cloud = left;
            forgotten += count;
        }
        forgotten
    }
}
