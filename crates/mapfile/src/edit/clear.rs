//! Sets cells of grids to unknown by area.

use std::collections::BTreeMap;

use portolan_geometry::Rigid3;
use portolan_geometry::nalgebra::Point3;

use crate::paint::MapArea;
use portolan_pbstream::proto::mapping::grid2_d::Grid;
use portolan_pbstream::proto::mapping::{Grid2D, HybridGrid, Submap};
use portolan_pbstream::{IdInFile, pose_from_proto};
use portolan_pbstream::{check_grid_2d, check_hybrid_grid, mend_grid_2d, mend_hybrid_grid};

/// A rectangle of the global map in which cells are cleared, and the poses of the submaps at that time.
pub(super) struct ClearedArea {
    pub area: MapArea,
    pub submaps: BTreeMap<IdInFile, Rigid3>,
}

impl ClearedArea {
    /// Sets the cells in the rectangle to unknown. Returns how many were known.
    ///
    /// # Errors
    /// Why the grid is broken, so that the positions of its cells are unknown.
    pub fn clear(&self, id: IdInFile, submap: &mut Submap) -> Result<u64, String> {
        let Some(map_from_submap) = self.submaps.get(&id) else { return Ok(0) };
        let mut cleared = 0;
        if let Some(submap) = &mut submap.submap_2d
            && let (Some(grid), Some(local_from_submap)) =
                (&mut submap.grid, pose_from_proto(submap.local_pose.as_ref()))
        {
            cleared += self.clear_plane(grid, &(map_from_submap * local_from_submap.inverse()))?;
        }
        if let Some(submap) = &mut submap.submap_3d {
            let grids = [&mut submap.high_resolution_hybrid_grid, &mut submap.low_resolution_hybrid_grid];
            for grid in grids.into_iter().flatten() {
                cleared += self.clear_space(grid, map_from_submap)?;
            }
            if cleared > 0 {
                submap.planes = None;
            }
        }
        Ok(cleared)
    }

    fn holds(&self, p: &Point3<f64>) -> bool {
        let area = &self.area;
        (area.min_x..=area.max_x).contains(&p.x) && (area.min_y..=area.max_y).contains(&p.y)
    }

    fn clear_plane(&self, grid: &mut Grid2D, map_from_local: &Rigid3) -> Result<u64, String> {
        let report = check_grid_2d(grid);
        if !report.is_good() {
            report.broken.map_or(Ok(()), Err)?;
            mend_grid_2d(grid);
        }
        let limits = grid.limits.unwrap_or_default();
        let (corner, size) = (limits.max.unwrap_or_default(), limits.cell_limits.unwrap_or_default());
        let columns = usize::try_from(size.num_x_cells).unwrap_or(0).max(1);
        let mut weights = match &mut grid.grid {
            Some(Grid::Tsdf2d(tsdf)) => Some(&mut tsdf.weight_cells),
            _ => None,
        };
        let mut cleared = 0;
        for (index, cell) in grid.cells.iter_mut().enumerate().filter(|(_, cell)| **cell != 0) {
            let (row, column) = (index / columns, index % columns);
            let metres = |i: usize| limits.resolution * (i as f64 + 0.5);
            let centre = Point3::new(corner.x - metres(row), corner.y - metres(column), 0.0);
            if self.holds(&(map_from_local * centre)) {
                *cell = 0;
                if let Some(weight) = weights.as_mut().and_then(|w| w.get_mut(index)) {
                    *weight = 0;
                }
                cleared += 1;
            }
        }
        if cleared > 0 {
            // The box of known cells changes.
            mend_grid_2d(grid);
        }
        Ok(cleared)
    }

    fn clear_space(&self, grid: &mut HybridGrid, map_from_submap: &Rigid3) -> Result<u64, String> {
        let report = check_hybrid_grid(grid);
        if !report.is_good() {
            report.broken.map_or(Ok(()), Err)?;
            mend_hybrid_grid(grid);
        }
        let metres = |i: i32| f64::from(grid.resolution) * f64::from(i);
        let indices = grid.x_indices.iter().zip(&grid.y_indices).zip(&grid.z_indices);
        let centres = indices.map(|((x, y), z)| Point3::new(metres(*x), metres(*y), metres(*z)));
        let keep: Vec<bool> = centres.map(|p| !self.holds(&(map_from_submap * p))).collect();
        for values in [&mut grid.x_indices, &mut grid.y_indices, &mut grid.z_indices, &mut grid.values] {
            let mut keep = keep.iter();
            values.retain(|_| keep.next().copied().unwrap_or(true));
        }
        Ok(keep.iter().filter(|keep| !**keep).count() as u64)
    }
}
