//! A map of the plane renewed by a recording that was localised in it: what is gone fades, what is new appears, and the rest
//! stays as it was.
//!
//! The recording is a trajectory of the map already. Of its submaps those stay that show what has changed, or what the map
//! did not know; changed cells become unknown in all older submaps; and older submaps of which newer ones leave nothing to
//! be seen are removed. So a map grows with the area that was seen, not with time (Johannsson, Kaess, Fallon and Leonard,
//! "Temporally scalable visual SLAM using a reduced pose graph", ICRA 2013, bound pose graphs by space in this sense).

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Rigid3, Rigid3f, Vector2, project_2d};
use portolan_mapping::{Planar, PoseGraph, Space, SubmapEntry, SubmapId, TrajectoryId, of_trajectory};

use crate::changes::{ChangeGrid, ChangeKind, ChangedCells};
use crate::placed_scan::PlacedScan;
use crate::planar_map::PlanarMap;
use crate::recent::is_alike;

/// A submap that shows less than this of what the map does not know is not worth its size, square metres.
const LEAST_NEW_AREA: f64 = 4.0;
/// Each place is seen by so many of the newest submaps; those of which less than this is seen, square metres, are removed.
const NEWEST: usize = 2;
const LEAST_SEEN: f64 = 2.0;
/// Edge of the cells in which areas are counted, metres.
const CELL: f64 = 0.1;

/// What a recording changed in a map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Renewal {
    /// Submaps of the recording that stay.
    pub added_submaps: usize,
    /// Older submaps that were removed.
    pub removed_submaps: usize,
    /// Square metres in which something has appeared.
    pub appeared: f64,
    /// Square metres in which something is gone.
    pub gone: f64,
    /// Square metres that the map did not know.
    pub discovered: f64,
}

/// A cell of the plane, counted from the origin of the map.
type Cell = (i64, i64);

fn cell_at(point: &Vector2) -> Cell {
    let index = |v: f64| (v / CELL).floor() as i64;
    (index(point.x), index(point.y))
}

/// What a submap of the recording shows.
#[derive(Default)]
struct Shown {
    /// Cells that have changed.
    changed: BTreeSet<usize>,
    /// Cells that the map does not know.
    unknown: BTreeSet<Cell>,
}

/// Renews a map by a trajectory of it; `before` is the map without this trajectory.
pub(crate) fn renew(graph: &mut PoseGraph<Planar>, new: TrajectoryId, before: &PlanarMap) -> Renewal {
    let changes = changed_cells(graph, new, before);
    let all = shown(graph, new, before, &changes);
    let chosen = chosen(&all);
    let (mut changed, mut discovered) = (BTreeSet::new(), BTreeSet::new());
    for shown in chosen.iter().filter_map(|id| all.get(id)) {
        changed.extend(shown.changed.iter().copied());
        discovered.extend(shown.unknown.iter().copied());
    }
    graph.remove_submaps(&all.keys().filter(|id| !chosen.contains(id)).copied().collect());
    graph.forget_cells(&|id, point| {
        id.trajectory_id != new && changes.at(point).is_some_and(|cell| changed.contains(&cell))
    });
    let removed = graph.covered_by(new, NEWEST, LEAST_SEEN);
    graph.remove_submaps(&removed);
    Renewal {
        added_submaps: chosen.len(),
        removed_submaps: removed.len(),
        appeared: changes.area(changed.iter(), ChangeKind::Appeared),
        gone: changes.area(changed.iter(), ChangeKind::Gone),
        discovered: discovered.len() as f64 * CELL * CELL,
    }
}

/// Cells of the map that nodes of the trajectory contradict, from places some way apart.
fn changed_cells(graph: &PoseGraph<Planar>, new: TrajectoryId, before: &PlanarMap) -> ChangedCells {
    let mut grid = ChangeGrid::new(before.cells.clone());
    let mut last: Option<Rigid3> = None;
    for (_, node) in of_trajectory(&graph.state().nodes, new) {
        let map_from_tracking = node.map_from_tracking;
        if last.is_some_and(|last| is_alike(&last, &map_from_tracking)) {
            continue;
        }
        last = Some(map_from_tracking);
        let map_from_node = Planar::graph_pose(&map_from_tracking, &node.data.gravity_alignment);
        let whole = node.data.scan.as_ref().map(|scan| scan.range_data(&Rigid3f::identity()).returns);
        let returns = whole.as_ref().unwrap_or(&node.data.filtered_gravity_aligned_point_cloud);
        grid.add(&PlacedScan {
            time: node.data.time,
            origin: map_from_node.translation.vector.xy(),
            map_from_local: project_2d(&map_from_node),
            returns: &returns.points,
        });
    }
    grid.changed_cells()
}

/// What each submap of the trajectory shows.
fn shown(
    graph: &PoseGraph<Planar>,
    new: TrajectoryId,
    before: &PlanarMap,
    changes: &ChangedCells,
) -> BTreeMap<SubmapId, Shown> {
    let state = graph.state();
    let of_submap = |(id, entry): (SubmapId, &SubmapEntry<Planar>)| {
        let map_from_submap = project_2d(&state.map_from_submap(id)?);
        let centers = Planar::known_cell_centers(entry.submap.as_ref()?)?;
        let mut shown = Shown::default();
        for point in centers.iter().map(|center| map_from_submap.transform_point(center)) {
            shown.changed.extend(changes.at(&point));
            if !before.knows(&point) {
                shown.unknown.insert(cell_at(&point));
            }
        }
        Some((id, shown))
    };
    of_trajectory(&state.submaps, new).filter_map(of_submap).collect()
}

/// The submaps that are worth keeping: one after the other the one that shows most of what no chosen one shows yet.
fn chosen(all: &BTreeMap<SubmapId, Shown>) -> BTreeSet<SubmapId> {
    let (mut changed, mut unknown) = (BTreeSet::new(), BTreeSet::new());
    let mut chosen = BTreeSet::new();
    loop {
        let rest = all.iter().filter(|(id, _)| !chosen.contains(*id));
        let worth = rest.map(|(id, shown)| {
            let new_changes = shown.changed.difference(&changed).count();
            (new_changes, shown.unknown.difference(&unknown).count(), Reverse(*id))
        });
        let Some((new_changes, new_area, Reverse(best))) = worth.max() else { return chosen };
        let is_worth_it = new_changes > 0 || new_area as f64 * CELL * CELL >= LEAST_NEW_AREA;
        let Some(shown) = all.get(&best).filter(|_| is_worth_it) else { return chosen };
        changed.extend(shown.changed.iter().copied());
        unknown.extend(shown.unknown.iter().copied());
        chosen.insert(best);
    }
}
