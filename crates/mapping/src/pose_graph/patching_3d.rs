//! Updates cells of 3D submaps, and points of nodes, that newer submaps contradict.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use portolan_geometry::{Point3f, Rigid3, Rigid3f, to_f32};
use portolan_grids::{HybridGrid, SOLID_VOXEL};
use portolan_sensor::PointCloud;
use portolan_submaps::Submap3d;

use super::PoseGraph;
use super::extension::NearestSubmaps;
use crate::{Space3d, SubmapId, TrajectoryId, of_trajectory};

/// Probability of a cell that is not occupied any more.
const FREE: f32 = 0.1;

/// Change of a place in older 3D submaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VoxelFate {
    /// It stays as it is.
    Kept,
    /// Newer submaps show something new there.
    Appeared,
    /// Something that was there is gone.
    Gone,
}

/// The fine and the coarse grid of a submap.
fn grids(submap: &Submap3d) -> [&HybridGrid; 2] {
    [&submap.high_resolution_grid, &submap.low_resolution_grid]
}

/// Occupied cells of a grid, as points of the map with their probabilities.
fn solid(grid: &HybridGrid, map_from_submap: &Rigid3f) -> Vec<(Point3f, f32)> {
    let mut found = Vec::new();
    grid.for_each_cell(|cell, _| {
        let probability = grid.probability(cell);
        if probability > SOLID_VOXEL {
            found.push((map_from_submap * grid.cell_center(cell), probability));
        }
    });
    found
}

impl PoseGraph<Space3d> {
    /// Transfers changes from the submaps of one trajectory into those of the others, where `fate` of a point
    /// of the map says so. What is gone becomes free in all of them, what appeared becomes occupied in the
    /// one that is nearest to it.
    pub fn patch_voxels(&mut self, newer: TrajectoryId, fate: &dyn Fn(&Point3f) -> VoxelFate) {
        let older: BTreeSet<SubmapId> =
            self.state.submaps.keys().filter(|id| id.trajectory_id != newer).copied().collect();
        let appeared = self.appeared(newer, &older, fate);
        let empty = Default::default();
        for id in older {
            let Some(map_from_submap) = self.state.map_from_submap(id).map(|pose| to_f32(&pose)) else {
                continue;
            };
            let Some(submap) = self.state.submaps.get_mut(&id).and_then(|entry| entry.submap.as_mut()) else {
                continue;
            };
            let gone = grids(submap).map(|grid| {
                let solid = solid(grid, &map_from_submap).into_iter();
                let gone = solid.filter(|(point, _)| fate(point) == VoxelFate::Gone);
                gone.map(|(point, _)| (point, FREE)).collect::<Vec<_>>()
            });
            let new = appeared.get(&id).unwrap_or(&empty);
            if gone.iter().chain(new).all(Vec::is_empty) {
                continue;
            }
            let submap = Arc::make_mut(submap);
            submap.planes = None;
            submap.made_planes = None;
            let submap_from_map = map_from_submap.inverse();
            let both = [&mut submap.high_resolution_grid, &mut submap.low_resolution_grid];
            for ((grid, gone), new) in both.into_iter().zip(&gone).zip(new) {
                for (point, probability) in gone.iter().chain(new) {
                    if let Some(cell) = grid.cell_index(&(submap_from_map * point)) {
                        grid.set_probability(cell, *probability);
                    }
                }
            }
            self.search.delete_matcher(id);
        }
    }

    /// New occupied cells of the fine and coarse grids of newer submaps, by the older submap that is nearest
    /// to them.
    fn appeared(
        &self,
        newer: TrajectoryId,
        older: &BTreeSet<SubmapId>,
        fate: &dyn Fn(&Point3f) -> VoxelFate,
    ) -> BTreeMap<SubmapId, [Vec<(Point3f, f32)>; 2]> {
        let nearest = NearestSubmaps::new(self, older);
        let mut found: BTreeMap<SubmapId, [Vec<(Point3f, f32)>; 2]> = BTreeMap::new();
        for (id, entry) in of_trajectory(&self.state.submaps, newer) {
            let (Some(submap), Some(pose)) = (&entry.submap, self.state.map_from_submap(id)) else {
                continue;
            };
            for (which, grid) in grids(submap).into_iter().enumerate() {
                let new = solid(grid, &to_f32(&pose)).into_iter();
                for (point, probability) in new.filter(|(point, _)| fate(point) == VoxelFate::Appeared) {
                    let place = Rigid3::from_parts(point.coords.cast::<f64>().into(), Default::default());
                    let Some(submap) = nearest.find(&place) else { continue };
                    let of_grid = found.entry(submap).or_default().get_mut(which);
                    of_grid.into_iter().for_each(|points| points.push((point, probability)));
                }
            }
        }
        found
    }

    /// Removes points from the scans of nodes of other trajectories where `is_gone` is true of a point of the
    /// map: they are not to be matched any more. Scans of which nothing would be left stay.
    pub fn forget_points_3d(&mut self, newer: TrajectoryId, is_gone: &dyn Fn(&Point3f) -> bool) {
        for (_, node) in self.state.nodes.iter_mut().filter(|(id, _)| id.trajectory_id != newer) {
            let map_from_tracking = to_f32(&node.map_from_tracking);
            let left = |cloud: &PointCloud| -> Option<PointCloud> {
                let is_kept = |point: &&Point3f| !is_gone(&(map_from_tracking * *point));
                let left: Vec<Point3f> = cloud.points.iter().filter(is_kept).copied().collect();
                (!left.is_empty() && left.len() < cloud.points.len()).then(|| PointCloud::new(left))
            };
            let high = left(&node.data.high_resolution_point_cloud);
            let low = left(&node.data.low_resolution_point_cloud);
            if high.is_none() && low.is_none() {
                continue;
            }
            let data = Arc::make_mut(&mut node.data);
            high.into_iter().for_each(|cloud| data.high_resolution_point_cloud = cloud);
            low.into_iter().for_each(|cloud| data.low_resolution_point_cloud = cloud);
        }
    }
}
