//! Searches nodes of one piece of map in all submaps of another piece at once, by a place index.
//!
//! The search of the whole map proposes poses for the path segment around a node. The matcher of single
//! submaps accepts or rejects them, as it does everything else, by the scan of that node alone. So the index
//! does not decide what is accepted; it only saves searching submaps that cannot match.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Rigid3, Vector3};
use portolan_submaps::SearchWindow;
use rayon::prelude::*;

use super::PoseGraph;
use crate::{NodeData, NodeId, PlaceFinder, Space, SubmapId, SubmapInMap, TrajectoryId, of_trajectory};

/// Minimum distance along the path between the scans around a node that are searched together, metres.
const SCAN_SPACING: f64 = 0.5;
/// Number of submaps in which a proposed pose is matched: those whose nodes came nearest to it.
const SUBMAPS_A_PLACE: usize = 2;
/// Search window around a proposed pose, metres and radians: half of a diagonal of its cells and headings,
/// which also covers the disagreement of the submaps of a place before the last optimisation.
pub(super) const AROUND_PROPOSAL: SearchWindow = SearchWindow { linear: 0.5, angular: 0.09 };

/// Growth of the map, as a fraction of its complete submaps, after which the place indices are built again.
const GROWTH: f64 = 0.1;

/// Maximum number of connected parts that are searched: those with the most complete submaps. Otherwise, in a
/// recording whose pose is lost again and again, every piece would be searched in every other one, and time
/// would grow with the square of the recording length.
const MOST_PARTS: usize = 8;

/// A connected part of the map in which nodes are searched.
pub(super) struct SearchedPart {
    finder: Box<dyn PlaceFinder>,
    /// Submaps, their poses in the map, and the positions of their nodes.
    submaps: Vec<(SubmapId, Rigid3, Vec<Vector3>)>,
}

impl SearchedPart {
    /// The submaps whose nodes came nearest to a pose, the nearest first.
    fn submaps_near(&self, pose: &Rigid3) -> impl Iterator<Item = (SubmapId, Rigid3)> {
        let at = pose.translation.vector;
        let distance =
            |nodes: &[Vector3]| nodes.iter().map(|n| (n - at).norm()).fold(f64::INFINITY, f64::min);
        let mut near: Vec<(f64, SubmapId, Rigid3)> =
            self.submaps.iter().map(|(id, pose, nodes)| (distance(nodes), *id, *pose)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.into_iter().take(SUBMAPS_A_PLACE).map(|(_, id, pose)| (id, pose))
    }
}

/// Budget of searches for each node of the map while mapping, and the same again at the end, in cell
/// look-ups: a few milliseconds, as long as it takes to make a node. What is not used is saved, up to
/// [`MOST_SAVED`]; a search that needs more delays the next ones.
const LOOKUPS_A_NODE: i64 = 3_000_000;
/// Maximum budget that is saved, in cell look-ups: as much as a search can need.
const MOST_SAVED: i64 = 2_000_000_000;
/// Minimum budget of a search in one part of the map, in cell look-ups, some hundredths of a second: with
/// fewer it finds nothing.
const LEAST_LOOKUPS: u64 = 1 << 24;

/// Searches for nodes of trajectories without a place, while they are being recorded.
#[derive(Default)]
pub(super) struct PlaceSearches {
    ready: Option<ReadyParts>,
    /// Distance along its trajectory of the last node that was searched, metres.
    last: Steps,
    /// Look-ups left in the budget; below zero, those that were spent in advance.
    saved: i64,
}

/// By trajectory: distance along it at which something was done last, metres.
#[derive(Default)]
pub(super) struct Steps(BTreeMap<TrajectoryId, f64>);

impl Steps {
    /// Starts counting at this distance along the trajectory.
    fn begin(&mut self, id: TrajectoryId, path_length: f64) {
        self.0.entry(id).or_insert(path_length);
    }

    /// Whether it is due again, once in `spacing` metres; if so, this distance is noted.
    pub fn is_due(&mut self, id: TrajectoryId, path_length: f64, spacing: f64) -> bool {
        let is_due = self.0.get(&id).is_none_or(|last| path_length - last >= spacing);
        if is_due {
            self.0.insert(id, path_length);
        }
        is_due
    }
}

impl PlaceSearches {
    /// The trajectories whose nodes were searched.
    pub fn looked_for(&self) -> impl Iterator<Item = TrajectoryId> {
        self.last.0.keys().copied()
    }

    /// Adds the budget of one more node.
    fn save(&mut self) {
        self.saved = (self.saved + LOOKUPS_A_NODE).min(MOST_SAVED);
    }

    /// Adds the budget of this number of nodes, as at the end.
    pub fn save_for(&mut self, nodes: usize) {
        let all = LOOKUPS_A_NODE.saturating_mul(i64::try_from(nodes).unwrap_or(i64::MAX));
        self.saved = self.saved.max(0).saturating_add(all);
    }

    /// Lifts the limit: the caller wants a place to be found at any cost.
    pub fn save_without_limit(&mut self) {
        self.saved = i64::MAX;
    }

    /// Budget of the nodes of one round in all parts together: half of what is left, so that later rounds
    /// have some.
    pub fn most_lookups_of_round(&self) -> u64 {
        u64::try_from(self.saved / 2).unwrap_or(0)
    }

    pub fn may_search(&self) -> bool {
        self.saved >= 0
    }

    pub fn spend(&mut self, lookups: u64) {
        self.saved = self.saved.saturating_sub_unsigned(lookups);
    }
}

/// Proposed poses of a node.
#[derive(Default)]
struct Proposals {
    /// The node, a submap, and its pose in that submap.
    pairs: Vec<(NodeId, SubmapId, Rigid3)>,
    lookups: u64,
}

/// Searchable parts of the map, as they were when their indices were built.
struct ReadyParts {
    /// The trajectories that were left out.
    without: BTreeSet<TrajectoryId>,
    /// Number of complete submaps.
    complete: usize,
    parts: Vec<SearchedPart>,
}

impl<S: Space> PoseGraph<S> {
    /// Whether trajectories without a place are searched in whole maps at once.
    pub(super) fn searches_whole_maps(&self) -> bool {
        self.policy.loops.searches_whole_maps
    }

    /// Distance along the path between two nodes that are searched, metres.
    pub(super) fn spacing_of_searches(&self) -> f64 {
        self.policy.loops.spacing.max(SCAN_SPACING)
    }

    /// Schedules the search for a new node in the parts of the map that its trajectory is not connected with,
    /// once per distance along the path, as for the search in a submap. Parts before and after a gap are
    /// searched in each other around the pose that odometry predicts, and everywhere only at the end.
    pub(super) fn look_everywhere(&mut self, node_id: NodeId) {
        let id = node_id.trajectory_id;
        self.places.save();
        let may_search = self.places.may_search() && !self.stop.is_requested();
        let is_wanted = self.searches_whole_maps() && may_search;
        if !is_wanted || self.state.connectivity.components().len() < 2 {
            return;
        }
        let path_length = self.path_lengths.get(&node_id).copied().unwrap_or(0.0);
        self.places.last.begin(id, path_length);
        if !self.places.last.is_due(id, path_length, self.spacing_of_searches()) {
            return;
        }
        let mut without = self.parts_beyond_gaps(id);
        without.extend(self.tracked.trajectories());
        if self.state.trajectories.keys().all(|id| without.contains(id)) {
            return;
        }
        let ready = self.ready_parts(without);
        let lookups = self.add_proposed(&[node_id], &ready.parts, MOST_SAVED.unsigned_abs());
        self.places.spend(lookups);
        self.places.ready = Some(ready);
    }

    /// The indexed parts; built again if other parts are needed, or the map has grown.
    fn ready_parts(&mut self, without: BTreeSet<TrajectoryId>) -> ReadyParts {
        let submaps = self.state.submaps.iter();
        let complete = submaps
            .filter(|(id, entry)| entry.insertion_finished && !without.contains(&id.trajectory_id))
            .count();
        let is_as_before = |ready: &ReadyParts| {
            let most = ready.complete as f64 * (1.0 + GROWTH);
            ready.without == without && (ready.complete..=most as usize).contains(&complete)
        };
        self.places.ready.take().filter(is_as_before).unwrap_or_else(|| {
            let parts = self.searched_parts(&without);
            ReadyParts { without, complete, parts }
        })
    }

    /// The parts of the map without some trajectories, indexed for searching, at most [`MOST_PARTS`]; none
    /// where whole maps cannot be searched.
    pub(super) fn searched_parts(&self, without: &BTreeSet<TrajectoryId>) -> Vec<SearchedPart> {
        let parts = self.state.connectivity.components().into_iter().map(|mut part| {
            part.retain(|id| !without.contains(id));
            part
        });
        let complete = |id: &TrajectoryId| {
            of_trajectory(&self.state.submaps, *id).filter(|(_, entry)| entry.insertion_finished).count()
        };
        let mut parts: Vec<(usize, Vec<TrajectoryId>)> =
            parts.map(|part| (part.iter().map(complete).sum(), part)).collect();
        if parts.len() > MOST_PARTS {
            parts.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
            parts.truncate(MOST_PARTS);
            parts.sort_by(|a, b| a.1.cmp(&b.1));
        }
        let wanted = parts.iter().take_while(|_| !self.stop.is_requested());
        wanted.filter_map(|(_, part)| self.searched_part(part)).collect()
    }

    fn searched_part(&self, part: &[TrajectoryId]) -> Option<SearchedPart> {
        let complete = part.iter().flat_map(|id| of_trajectory(&self.state.submaps, *id));
        let complete = complete.filter(|(_, entry)| entry.insertion_finished);
        let (mut parts, mut submaps) = (Vec::new(), Vec::new());
        for (id, entry) in complete {
            let (Some(submap), Some(pose)) = (&entry.submap, self.problem.submaps.get(&id)) else { continue };
            let nodes = entry.node_ids.iter().filter_map(|id| self.problem.nodes.get(id));
            let mut places: Vec<Vector3> = nodes.map(|node| node.map_from_node.translation.vector).collect();
            if places.is_empty() {
                places.push(pose.translation.vector);
            }
            parts.push(SubmapInMap { map_from_submap: *pose, submap: &**submap, nodes: places.clone() });
            submaps.push((id, *pose, places));
        }
        Some(SearchedPart { finder: S::place_finder(&parts)?, submaps })
    }

    /// Schedules the search for nodes at the poses that whole parts of the map propose. All together look up
    /// at most `most_lookups` cells, or [`LEAST_LOOKUPS`] a node and part. Returns the number of cells looked
    /// up.
    pub(super) fn add_proposed(
        &mut self,
        node_ids: &[NodeId],
        parts: &[SearchedPart],
        most_lookups: u64,
    ) -> u64 {
        let searches = (node_ids.len() * parts.len()).max(1) as u64;
        let each = (most_lookups / searches).max(LEAST_LOOKUPS);
        let proposed: Vec<Proposals> =
            node_ids.par_iter().map(|node_id| self.proposals(*node_id, parts, each)).collect();
        let lookups = proposed.iter().map(|proposals| proposals.lookups).sum();
        for (node_id, submap_id, guess) in proposed.into_iter().flat_map(|proposals| proposals.pairs) {
            if let Some((submap, node)) = self.state.pair(submap_id, node_id) {
                self.search.add_proposed(submap, node, guess, AROUND_PROPOSAL);
            }
        }
        lookups
    }

    /// Submaps in which a node may be, with its pose there. At most `most_lookups` cells are looked up in
    /// each part.
    fn proposals(&self, node_id: NodeId, parts: &[SearchedPart], most_lookups: u64) -> Proposals {
        let scans = self.stretch_around(node_id);
        let mut proposals = Proposals::default();
        for part in parts.iter().take_while(|_| !self.stop.is_requested()) {
            let found = part.finder.find(&scans, most_lookups);
            proposals.lookups += found.lookups;
            for map_from_node in found.poses {
                let near = part.submaps_near(&map_from_node);
                proposals.pairs.extend(near.map(|(id, pose)| (node_id, id, pose.inverse() * map_from_node)));
            }
        }
        proposals
    }

    /// The scan of a node and those around it along the path, with their poses in its frame.
    fn stretch_around(&self, node_id: NodeId) -> Vec<(Rigid3, &NodeData)> {
        let pose = |id: &NodeId| self.problem.nodes.get(id).map(|node| node.map_from_node);
        let (Some(node), Some(map_from_node), Some(middle)) =
            (self.state.nodes.get(&node_id), pose(&node_id), self.path_lengths.get(&node_id).copied())
        else {
            return Vec::new();
        };
        let mut scans = vec![(Rigid3::identity(), &*node.data)];
        let earlier = self.path_lengths.range(..node_id).rev();
        let later = self.path_lengths.range(node_id..).skip(1);
        for side in [&mut earlier.into_iter() as &mut dyn Iterator<Item = _>, &mut later.into_iter()] {
            let mut last = middle;
            for (id, path_length) in side {
                if id.trajectory_id != node_id.trajectory_id
                    || (path_length - middle).abs() > S::STRETCH_METRES
                {
                    break;
                }
                if (path_length - last).abs() < SCAN_SPACING {
                    continue;
                }
                last = *path_length;
                let (Some(other), Some(map_from_other)) = (self.state.nodes.get(id), pose(id)) else {
                    continue;
                };
                scans.push((map_from_node.inverse() * map_from_other, &*other.data));
            }
        }
        scans
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn searches_end_when_the_lookup_budget_is_spent() {
        let mut searches = PlaceSearches::default();
        searches.save_for(1000);
        let (mut spent, mut rounds) = (0, 0);
        while searches.may_search() {
            let lookups = searches.most_lookups_of_round().max(LEAST_LOOKUPS);
            searches.spend(lookups);
            (spent, rounds) = (spent + lookups, rounds + 1);
        }
        assert!(rounds > 5, "{rounds}");
        assert!(spent <= 1000 * LOOKUPS_A_NODE.unsigned_abs() + LEAST_LOOKUPS, "{spent}");
    }
}
