//! Lifelong mapping: bounds the graph by the mapped area, not by the time of mapping.
//!
//! Of each place the first submap that knew it stays, which anchors the map, and a given number of the
//! newest, which show it as it is now. Submaps of which little then remains visible are removed, with the
//! nodes that belong to no other one, their constraints and the measurements between them. Their information
//! on the submaps that stay is summarised (`summary_ties.rs`). The poses of removed nodes are kept relative
//! to nodes that stay ([`TrimmedNodes`](super::TrimmedNodes)).

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::f64::consts::FRAC_PI_2;

use portolan_geometry::{Time, project_2d, yaw};
use rayon::prelude::*;

use super::trimming::Remains;
use super::visible_cells::VisibleCells;
use super::{PoseGraph, TrajectoryState};
use crate::{Space, SubmapId, TrajectoryId};

/// Number of new submaps after which covered ones are looked for.
const AT_ONCE: usize = 4;
/// Fraction of visible cells below which a submap is removed.
const LEAST_SEEN: f64 = 0.1;
/// Fraction of cells known to a submap alone above which it stays all the same.
const MOST_ALONE: f64 = 0.005;
/// Edge of a cell of known area in 2D, metres.
const AREA: f64 = 0.5;
/// Edge of a cell of scan positions in 3D, metres; each heading quadrant is a cell of its own.
const PLACE: f64 = 2.0;

/// Indices along x, y and z, and the heading quadrant.
type Cell = [i32; 4];

/// A complete submap and the cells that it knows.
struct SubmapCells {
    id: SubmapId,
    newest_node: Time,
    is_removable: bool,
    cells: BTreeSet<Cell>,
}

impl SubmapCells {
    /// Its cells and those beside them: outlines and paths are never quite the same again.
    fn around(&self) -> BTreeSet<Cell> {
        let beside = |[x, y, z, heading]: Cell| {
            (-1..=1).flat_map(move |i| (-1..=1).map(move |j| [x + i, y + j, z, heading]))
        };
        self.cells.iter().flat_map(|cell| beside(*cell)).collect()
    }
}

impl<S: Space> PoseGraph<S> {
    /// Drops the submaps that others cover, if the policy says so and there are enough new ones.
    pub(super) fn drop_covered(&mut self) {
        let newest = self.policy.submaps_per_place;
        if newest == 0 || self.complete_submaps() < self.complete_after_dropping + AT_ONCE {
            return;
        }
        let covered: Vec<SubmapId> = self
            .state
            .connectivity
            .components()
            .iter()
            .flat_map(|part| self.covered_in(part, newest))
            .collect();
        if !covered.is_empty() {
            let whole = self.tied_parts();
            for id in covered {
                self.summarise(id);
                self.trim(id, Remains::Anchored);
                self.forget_summaries();
            }
            self.tie_torn(&whole);
        }
        self.forget_unconnected_sightings();
        self.complete_after_dropping = self.complete_submaps();
    }

    fn complete_submaps(&self) -> usize {
        self.state.submaps.values().filter(|entry| entry.insertion_finished).count()
    }

    /// The submaps of a part of the map that others of it cover.
    fn covered_in(&self, part: &[TrajectoryId], newest: usize) -> Vec<SubmapId> {
        let submaps: Vec<SubmapId> = part.iter().flat_map(|id| self.submaps_of(*id)).collect();
        let mut known: Vec<SubmapCells> = submaps.par_iter().filter_map(|id| self.known(*id)).collect();
        known.sort_by_key(|known| (known.newest_node, known.id));
        let around: Vec<BTreeSet<Cell>> = known.par_iter().map(SubmapCells::around).collect();
        let with_around = || known.iter().zip(&around);
        let mut stay: Vec<BTreeSet<Cell>> = visible(with_around(), 1);
        let mut of_newest = visible(with_around().rev(), newest);
        of_newest.reverse();
        stay.iter_mut().zip(of_newest).for_each(|(stay, mut newest)| stay.append(&mut newest));
        let mut knowing: HashMap<Cell, usize> = HashMap::new();
        around.iter().flatten().for_each(|cell| *knowing.entry(*cell).or_default() += 1);
        let mut covered = Vec::new();
        for ((known, around), stay) in with_around().zip(&stay) {
            let all = known.cells.len() as f64;
            let alone = known.cells.iter().filter(|cell| knowing.get(*cell) == Some(&1)).count() as f64;
            if known.is_removable && (stay.len() as f64) < LEAST_SEEN * all && alone <= MOST_ALONE * all {
                around.iter().for_each(|cell| *knowing.entry(*cell).or_insert(1) -= 1);
                covered.push(known.id);
            }
        }
        covered
    }

    /// The cells of a complete submap; none before it was optimised.
    fn known(&self, id: SubmapId) -> Option<SubmapCells> {
        let entry = self.state.submaps.get(&id).filter(|s| s.insertion_finished && s.searchable)?;
        let newest_node = self.state.time_of_last_node(entry).unwrap_or(Time::MIN);
        let is_removable = self.state.trajectory_state(id.trajectory_id) != TrajectoryState::Frozen;
        let cells = self.cells_of_area(id).or_else(|| self.cells_of_places(id))?;
        Some(SubmapCells { id, newest_node, is_removable, cells })
    }

    /// The cells of the map that a submap knows; none where that is not defined (3D).
    fn cells_of_area(&self, id: SubmapId) -> Option<BTreeSet<Cell>> {
        let map_from_submap = project_2d(self.state.optimized_submaps.get(&id)?);
        let centers = S::known_cell_centers(self.state.submaps.get(&id)?.submap.as_ref()?)?;
        let cell = |center| {
            let p = map_from_submap.transform_point(center) / AREA;
            [p.x.round() as i32, p.y.round() as i32, 0, 0]
        };
        Some(centers.iter().map(cell).collect())
    }

    /// The cells of the map in which the scans of a submap were taken.
    fn cells_of_places(&self, id: SubmapId) -> Option<BTreeSet<Cell>> {
        self.state.optimized_submaps.get(&id)?;
        let nodes = self.state.submaps.get(&id)?.node_ids.iter().filter_map(|id| self.problem.nodes.get(id));
        let cell = |node: &portolan_optimization::OptimizationNode| {
            let [x, y, z] = (node.map_from_node.translation.vector / PLACE).map(|v| v.round() as i32).into();
            [x, y, z, (yaw(&node.map_from_node.rotation) / FRAC_PI_2).round() as i32 & 3]
        };
        Some(nodes.map(cell).collect())
    }

    /// Removes landmark sightings between nodes that were removed: they constrain nothing any more.
    fn forget_unconnected_sightings(&mut self) {
        let nodes = &self.state.nodes;
        let mut spans: BTreeMap<TrajectoryId, Vec<(Time, Time)>> = BTreeMap::new();
        for ((a, before), (b, after)) in nodes.iter().zip(nodes.iter().skip(1)) {
            if a.trajectory_id == b.trajectory_id && a.index + 1 == b.index {
                spans.entry(a.trajectory_id).or_default().push((before.data.time, after.data.time));
            }
        }
        let newest: BTreeMap<TrajectoryId, Time> =
            nodes.iter().map(|(id, node)| (id.trajectory_id, node.data.time)).collect();
        let is_held = |id: TrajectoryId, time: Time| {
            let spans = spans.get(&id).map(Vec::as_slice).unwrap_or_default();
            let next = spans.partition_point(|(_, end)| *end < time);
            spans.get(next).is_some_and(|(begin, _)| *begin <= time)
                || newest.get(&id).is_none_or(|newest| time > *newest)
        };
        for landmark in self.problem.landmarks.values_mut() {
            landmark.sightings.retain(|seen| is_held(seen.trajectory_id, seen.time));
        }
    }
}

/// The cells of each submap that are visible in it, if each cell is in the first `count` submaps of this order.
fn visible<'a>(
    submaps: impl Iterator<Item = (&'a SubmapCells, &'a BTreeSet<Cell>)>,
    count: usize,
) -> Vec<BTreeSet<Cell>> {
    let mut visible = VisibleCells::in_first(count);
    submaps.map(|(known, around)| visible.next(&known.cells, around).into_iter().collect()).collect()
}
