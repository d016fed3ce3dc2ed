//! Renews a 3D map by a recording that was localised in it: objects that are gone fade, new ones appear, and
//! the rest stays unchanged.
//!
//! As in 2D (`renewal.rs`), submaps of the recording stay if they show what the map did not know. Changes
//! are copied into older submaps, cell by cell. Older submaps that newer ones cover nearly completely are
//! removed. So the number of nodes, submaps and constraints grows with the space that was seen, not with
//! time.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Point3f, to_f32};
use portolan_grids::SOLID_VOXEL;
use portolan_mapping::{PoseGraph, Space3d, SubmapEntry, SubmapId, TrajectoryId, VoxelFate, of_trajectory};

use crate::changes::{ChangeCounter, ChangeKind};
use crate::known_map_3d::KnownMap3d;
use crate::renewal::{Renewal, submaps_with_new_cells};
use crate::settings::changes::{LEAST_NEW_CELLS, NEW_CELL, REPLACEMENT_3D};
use crate::voxel_changes::{ChangedVoxels, KeptSweep, VoxelChanges};

type Cell = [i32; 3];

fn cell_at(point: &Point3f) -> Cell {
    [point.x, point.y, point.z].map(|v| (v / NEW_CELL).floor() as i32)
}

fn around([x, y, z]: Cell) -> impl Iterator<Item = Cell> {
    (-1..=1).flat_map(move |i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [x + i, y + j, z + k])))
}

/// Renews a map by one of its trajectories; `before` is the map without this trajectory.
pub(crate) fn renew(
    graph: &mut PoseGraph<Space3d>,
    new: TrajectoryId,
    before: &KnownMap3d,
    sweeps: &[&KeptSweep],
) -> Renewal {
    let changes = changed_voxels(before, sweeps);
    let all = unknown(graph, new, before);
    let kept = submaps_with_new_cells(&all.iter().map(|(id, cells)| (*id, cells)).collect(), LEAST_NEW_CELLS);
    let discovered: BTreeSet<Cell> =
        kept.iter().filter_map(|id| all.get(id)).flat_map(|cells| cells.iter().copied()).collect();
    draw_changes(graph, new, &changes);
    let superfluous = all.keys().filter(|id| !kept.contains(id)).copied().collect();
    graph.remove_submaps(&superfluous);
    let removed = graph.covered_by(new, REPLACEMENT_3D);
    graph.remove_submaps(&removed);
    Renewal {
        added_submaps: kept.len(),
        removed_submaps: removed.len(),
        appeared: changes.area(ChangeKind::Appeared),
        gone: changes.area(ChangeKind::Gone),
        discovered: discovered.len() as f64 * f64::from(NEW_CELL * NEW_CELL),
    }
}

/// Copies changes into older submaps, and removes points that are gone from older scans.
fn draw_changes(graph: &mut PoseGraph<Space3d>, new: TrajectoryId, changes: &ChangedVoxels) {
    if changes.is_empty() {
        return;
    }
    graph.patch_voxels(new, &|point| match changes.at(point) {
        Some(ChangeKind::Appeared) => VoxelFate::Appeared,
        _ if changes.is_gone(point) => VoxelFate::Gone,
        _ => VoxelFate::Kept,
    });
    graph.forget_points_3d(new, &|point| changes.is_gone(point));
}

/// Cells of the map that scans contradict, from viewpoints some distance apart.
fn changed_voxels(before: &KnownMap3d, sweeps: &[&KeptSweep]) -> ChangedVoxels {
    let mut counted = VoxelChanges::new(before.voxels.clone());
    sweeps.iter().for_each(|sweep| counted.add(&sweep.placed()));
    counted.changed()
}

/// Cells unknown to the map that each submap of the trajectory shows.
fn unknown(
    graph: &PoseGraph<Space3d>,
    new: TrajectoryId,
    before: &KnownMap3d,
) -> BTreeMap<SubmapId, BTreeSet<Cell>> {
    let solid = before.occupancy.solid();
    let known: BTreeSet<Cell> = solid.iter().flat_map(|point| around(cell_at(point))).collect();
    let state = graph.state();
    let of_submap = |(id, entry): (SubmapId, &SubmapEntry<Space3d>)| {
        let map_from_submap = to_f32(&state.map_from_submap(id)?);
        let grid = &entry.submap.as_ref()?.high_resolution_grid;
        let mut cells = BTreeSet::new();
        grid.for_each_cell(|cell, _| {
            let point = map_from_submap * grid.cell_center(cell);
            let is_new = grid.probability(cell) > SOLID_VOXEL && !before.occupancy.is_free(&point);
            cells.extend(Some(cell_at(&point)).filter(|cell| is_new && !known.contains(cell)));
        });
        Some((id, cells))
    };
    of_trajectory(&state.submaps, new).filter_map(of_submap).collect()
}
