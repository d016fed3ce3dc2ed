//! Renews a 2D map by a recording that was localised in it: objects that are gone fade, new ones appear, and
//! the rest stays unchanged.
//!
//! The recording is already a trajectory of the map. Its submaps stay if they show what the map did not
//! know, or if they replace older ones in which something has changed. Changes in the other submaps are
//! copied into the older ones, cell by cell. So the number of nodes, submaps and constraints grows with the
//! area that was seen, not with time (Johannsson, Kaess, Fallon and Leonard, "Temporally scalable visual
//! SLAM using a reduced pose graph", ICRA 2013, bound pose graphs by space in this sense).

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Rigid3, Rigid3f, Vector2, project_2d};
use portolan_mapping::{
    CellFate, PoseGraph, Space, Space2d, SubmapEntry, SubmapId, TrajectoryId, of_trajectory,
};

use crate::changes::{ChangeCounter, ChangeGrid, ChangeKind, ChangedCells};
use crate::known_map_2d::KnownMap2d;
use crate::placed_scan::PlacedScan;
use crate::recent::is_alike;
use crate::settings::changes::{
    AREA_CELL, AROUND_CHANGED, AROUND_REMOVED, LEAST_NEW_AREA, MAX_AREA_LOST, REPLACED_FRACTION,
    REPLACEMENT_2D,
};

/// Changes of a map by a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Renewal {
    /// Submaps of the recording that stay.
    pub added_submaps: usize,
    /// Older submaps that were removed.
    pub removed_submaps: usize,
    /// Area in which something has appeared, square metres.
    pub appeared: f64,
    /// Area in which something is gone, square metres.
    pub gone: f64,
    /// Area that the map did not know, square metres.
    pub discovered: f64,
}

impl Renewal {
    /// Whether the map stays as it was.
    pub fn is_nothing(&self) -> bool {
        self.added_submaps == 0 && self.removed_submaps == 0 && self.appeared == 0.0 && self.gone == 0.0
    }
}

/// A cell of a 2D map, counted from the origin of the map.
type Cell = (i64, i64);

fn cell_at(point: &Vector2) -> Cell {
    let index = |v: f64| (v / AREA_CELL).floor() as i64;
    (index(point.x), index(point.y))
}

/// Cells of a submap of the recording that matter for renewal.
#[derive(Default)]
struct Shown {
    /// Cells that have changed.
    changed: BTreeSet<usize>,
    /// Cells that the map does not know.
    unknown: BTreeSet<Cell>,
}

/// Renews a map by one of its trajectories; `before` is the map without this trajectory.
pub(crate) fn renew(graph: &mut PoseGraph<Space2d>, new: TrajectoryId, before: &KnownMap2d) -> Renewal {
    let changes = changed_cells(graph, new, before);
    let all = shown(graph, new, before, &changes);
    let unknown = all.iter().map(|(id, shown)| (*id, &shown.unknown)).collect();
    let mut kept =
        submaps_with_new_cells(&unknown, (LEAST_NEW_AREA / (AREA_CELL * AREA_CELL)).ceil() as usize);
    let discovered: BTreeSet<Cell> =
        kept.iter().filter_map(|id| all.get(id)).flat_map(|shown| shown.unknown.iter().copied()).collect();
    let mut removed = replace(graph, new, &all, &changes, &mut kept);
    draw_changes(graph, new, before, &changes);
    let superfluous = all.keys().filter(|id| !kept.contains(id)).copied();
    graph.remove_submaps(&superfluous.chain(removed.iter().copied()).collect());
    let hidden = graph.covered_by(new, REPLACEMENT_2D);
    graph.remove_submaps(&hidden);
    removed.extend(hidden);
    Renewal {
        added_submaps: kept.len(),
        removed_submaps: removed.len(),
        appeared: changes.area(ChangeKind::Appeared),
        gone: changes.area(ChangeKind::Gone),
        discovered: discovered.len() as f64 * AREA_CELL * AREA_CELL,
    }
}

/// Copies changes into older submaps, and removes points that are gone from older scans.
fn draw_changes(
    graph: &mut PoseGraph<Space2d>,
    new: TrajectoryId,
    before: &KnownMap2d,
    changes: &ChangedCells,
) {
    if changes.is_empty() {
        return;
    }
    let around = changes.around(AROUND_CHANGED, |_| true);
    graph.patch(new, &|point| match changes.at(point) {
        Some(_) => CellFate::Replaced,
        None if around.contains(point) && !before.knows(point) => CellFate::Filled,
        None => CellFate::Kept,
    });
    let beside_gone = changes.around(AROUND_REMOVED, |kind| kind == ChangeKind::Gone);
    graph.forget_points(new, &|point| beside_gone.contains(point));
}

/// Cells of the map that nodes of the trajectory contradict, from viewpoints some distance apart.
fn changed_cells(graph: &PoseGraph<Space2d>, new: TrajectoryId, before: &KnownMap2d) -> ChangedCells {
    let mut grid = ChangeGrid::new(before.cells.clone());
    let mut last: Option<Rigid3> = None;
    for (_, node) in of_trajectory(&graph.state().nodes, new) {
        let map_from_tracking = node.map_from_tracking;
        if last.is_some_and(|last| is_alike(&last, &map_from_tracking)) {
            continue;
        }
        last = Some(map_from_tracking);
        let map_from_node = Space2d::graph_pose(&map_from_tracking, &node.data.gravity_alignment);
        let whole = node.data.scan.as_ref().map(|scan| scan.range_data(&Rigid3f::identity()).returns);
        let returns = whole.as_ref().unwrap_or(&node.data.filtered_gravity_aligned_point_cloud);
        grid.add(&PlacedScan {
            time: node.data.time,
            origin: map_from_node.translation.vector,
            map_from_local: map_from_node,
            returns: &returns.points,
        });
    }
    grid.changed_cells()
}

/// Changed and unknown cells of each submap of the trajectory.
fn shown(
    graph: &PoseGraph<Space2d>,
    new: TrajectoryId,
    before: &KnownMap2d,
    changes: &ChangedCells,
) -> BTreeMap<SubmapId, Shown> {
    let state = graph.state();
    let of_submap = |(id, entry): (SubmapId, &SubmapEntry<Space2d>)| {
        let map_from_submap = project_2d(&state.map_from_submap(id)?);
        let centers = Space2d::known_cell_centers(entry.submap.as_ref()?)?;
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

/// Greedily chooses the submaps that show at least `least_cells` cells unknown to the map: in each step the
/// one that shows most cells that no chosen one shows yet.
pub(crate) fn submaps_with_new_cells<C: Ord + Copy>(
    all: &BTreeMap<SubmapId, &BTreeSet<C>>,
    least_cells: usize,
) -> BTreeSet<SubmapId> {
    let mut known = BTreeSet::new();
    let mut chosen = BTreeSet::new();
    loop {
        let rest = all.iter().filter(|(id, _)| !chosen.contains(*id));
        let gain = rest.map(|(id, unknown)| (unknown.difference(&known).count(), Reverse(*id)));
        let Some((cells, Reverse(best))) = gain.max() else { return chosen };
        let Some(unknown) = all.get(&best).filter(|_| cells >= least_cells) else { return chosen };
        known.extend(unknown.iter().copied());
        chosen.insert(best);
    }
}

/// Also keeps submaps of the recording that replace older ones in which something has changed. Each replaces
/// at least one, so that the number of submaps does not grow. Returns the replaced ones.
fn replace(
    graph: &PoseGraph<Space2d>,
    new: TrajectoryId,
    all: &BTreeMap<SubmapId, Shown>,
    changes: &ChangedCells,
    kept: &mut BTreeSet<SubmapId>,
) -> BTreeSet<SubmapId> {
    let has_changed = |id: &SubmapId| {
        let centers = graph
            .state()
            .submaps
            .get(id)
            .and_then(|entry| Space2d::known_cell_centers(entry.submap.as_ref()?));
        let map_from_submap = graph.state().map_from_submap(*id).map(|pose| project_2d(&pose));
        centers.zip(map_from_submap).is_some_and(|(centers, pose)| {
            centers.iter().any(|center| changes.at(&pose.transform_point(center)).is_some())
        })
    };
    let older = graph.state().submaps.keys().filter(|id| id.trajectory_id != new);
    let mut known = graph.coverage(older.clone().copied());
    let of_new = graph.coverage(all.keys().copied());
    kept.iter().for_each(|id| known.take(*id, &of_new));
    let mut outdated: BTreeSet<SubmapId> = older.filter(|id| has_changed(id)).copied().collect();
    let mut candidates: Vec<(usize, Reverse<SubmapId>)> =
        all.iter().map(|(id, shown)| (shown.changed.len(), Reverse(*id))).collect();
    candidates.sort_unstable_by(|a, b| b.cmp(a));
    let mut removed = BTreeSet::new();
    for (_, Reverse(id)) in candidates.into_iter().filter(|(changed, _)| *changed > 0) {
        let is_added = !kept.contains(&id);
        if is_added {
            known.take(id, &of_new);
        }
        let is_covered = |old: &SubmapId| known.fraction_known_by(*old, id, &of_new) >= REPLACED_FRACTION;
        let covered: Vec<SubmapId> = outdated.iter().copied().filter(is_covered).collect();
        let gone: Vec<SubmapId> =
            covered.into_iter().filter(|old| known.remove_unless_alone(*old, MAX_AREA_LOST)).collect();
        if gone.is_empty() {
            if is_added {
                known.remove_unless_alone(id, f64::INFINITY);
            }
            continue;
        }
        outdated.retain(|old| !gone.contains(old));
        removed.extend(gone);
        kept.insert(id);
    }
    removed
}
