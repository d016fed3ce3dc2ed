//! Removes submaps that newer ones supersede, so that a map does not grow with time.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use portolan_geometry::{Point3f, Rigid3, to_f32};

use super::PoseGraph;
use super::visible_cells::VisibleCells;
use crate::{NodeId, Space, SubmapId, TrajectoryId};

/// Criteria by which newer submaps replace older ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replacement {
    /// Number of newest submaps in which each cell counts as visible.
    pub newest: usize,
    /// Visible area below which a submap is replaced, square metres.
    pub least_seen: f64,
    /// Area known only to this submap above which it stays all the same, square metres.
    pub most_alone: f64,
    /// Visible fraction of the area of the submap below which it is replaced; the larger of this and
    /// `least_seen` counts.
    pub least_share: f64,
    /// Fraction of its area that a submap may know alone and still go; the larger of this and `most_alone`
    /// counts.
    pub most_share_alone: f64,
}

/// Edge of the cells in which the coverage of 3D submaps is counted, metres.
const VOXEL: f64 = 0.5;

/// A cell of the map along x, y and, in 3D, z.
type Cell = (i64, i64, i64);

/// The cells of the map that submaps know, and the number of submaps that know each. In 3D these are occupied
/// cells, and a submap also counts as knowing the cells beside them: surfaces are never measured in quite the
/// same cells again.
#[derive(Clone, Debug)]
pub struct Coverage {
    cells: BTreeMap<SubmapId, BTreeSet<Cell>>,
    known: HashMap<Cell, usize>,
    /// Edge of a cell, metres.
    cell_size: f64,
    is_3d: bool,
}

impl Coverage {
    fn add(&mut self, id: SubmapId, cells: BTreeSet<Cell>) {
        self.with_beside(&cells).iter().for_each(|cell| *self.known.entry(*cell).or_default() += 1);
        self.cells.insert(id, cells);
    }

    /// Cells, and in 3D those beside them.
    fn with_beside(&self, cells: &BTreeSet<Cell>) -> BTreeSet<Cell> {
        if !self.is_3d {
            return cells.clone();
        }
        let near = || -1..=1;
        let around = |(x, y, z): &Cell| {
            let (x, y, z) = (*x, *y, *z);
            near().flat_map(move |i| near().flat_map(move |j| near().map(move |k| (x + i, y + j, z + k))))
        };
        cells.iter().flat_map(around).collect()
    }

    /// Visible area of each submap, square metres, if every cell of the map is visible in the first `counted`
    /// submaps that know it.
    fn seen(&self, newest_first: impl Iterator<Item = SubmapId>, counted: usize) -> BTreeMap<SubmapId, f64> {
        let mut visible = VisibleCells::in_first(counted);
        let mut areas = BTreeMap::new();
        for id in newest_first {
            let Some(own) = self.cells.get(&id) else { continue };
            let seen = visible.next(own, &self.with_beside(own));
            areas.insert(id, self.area(seen.len()));
        }
        areas
    }

    fn area(&self, cells: usize) -> f64 {
        cells as f64 * self.cell_size * self.cell_size
    }

    /// Area known to a submap, square metres.
    fn area_of(&self, id: SubmapId) -> f64 {
        self.area(self.cells.get(&id).map_or(0, BTreeSet::len))
    }

    /// Copies a submap from another coverage.
    pub fn take(&mut self, id: SubmapId, from: &Self) {
        self.add(id, from.cells.get(&id).cloned().unwrap_or_default());
    }

    /// Removes a submap, unless it alone knows more than `most_alone` square metres; returns whether it was
    /// removed.
    pub fn remove_unless_alone(&mut self, id: SubmapId, most_alone: f64) -> bool {
        let Some(own) = self.cells.get(&id) else { return false };
        let alone = own.iter().filter(|cell| self.known.get(*cell) == Some(&1)).count();
        if self.area(alone) > most_alone {
            return false;
        }
        for cell in self.with_beside(own) {
            self.known.entry(cell).and_modify(|count| *count = count.saturating_sub(1));
        }
        self.cells.remove(&id);
        true
    }

    /// Fraction of the cells of a submap that a submap of another coverage knows, too.
    pub fn fraction_known_by(&self, id: SubmapId, other: SubmapId, of: &Self) -> f64 {
        let (Some(own), Some(others)) = (self.cells.get(&id), of.cells.get(&other)) else { return 0.0 };
        own.intersection(others).count() as f64 / own.len().max(1) as f64
    }
}

/// A vertex of the pose graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Part {
    Submap(SubmapId),
    Node(NodeId),
}

/// A vertex by which a part of the graph is tied, with its pose.
type Place<I> = (I, Rigid3);

impl<S: Space> PoseGraph<S> {
    /// Removes submaps, the nodes that belong to no other one, and trajectories of which nothing is left.
    /// Where this disconnects what constraints tied together, the pieces are tied again at their present
    /// relative poses: the removed constraints had measured these.
    pub fn remove_submaps(&mut self, ids: &BTreeSet<SubmapId>) {
        if ids.is_empty() {
            return;
        }
        let whole = self.tied_parts();
        ids.iter().for_each(|id| self.trim_submap(*id));
        self.tie_torn(&whole);
        let of_removed: BTreeSet<TrajectoryId> = ids.iter().map(|id| id.trajectory_id).collect();
        for id in of_removed {
            if self.submaps_of(id).is_empty() && !self.state.nodes.keys().any(|node| node.trajectory_id == id)
            {
                self.mark_deleted(id);
            }
        }
    }

    /// Older submaps that a trajectory covers almost completely. Each cell of the map is visible in the
    /// newest `replacement.newest` submaps that know it; the age of trajectories is the order of their
    /// numbers. Submaps of which the trajectory hides nothing are not among them, nor those that alone know a
    /// place.
    pub fn covered_by(&self, new: TrajectoryId, replacement: Replacement) -> BTreeSet<SubmapId> {
        let newest_first = self.state.submaps.keys().rev().copied();
        let older = newest_first.clone().filter(|id| id.trajectory_id != new);
        let mut known = self.coverage(self.state.submaps.keys().copied());
        let with = known.seen(newest_first, replacement.newest);
        let without = known.seen(older.clone(), replacement.newest);
        let is_hidden = |id: &SubmapId| {
            let least = replacement.least_seen.max(replacement.least_share * known.area_of(*id));
            with.get(id) < without.get(id) && with.get(id).is_some_and(|seen| *seen < least)
        };
        let mut hidden: Vec<SubmapId> = older.filter(is_hidden).collect();
        hidden.reverse();
        let most_alone = |known: &Coverage, id| {
            replacement.most_alone.max(replacement.most_share_alone * known.area_of(id))
        };
        let is_removed = |id: &SubmapId| known.remove_unless_alone(*id, most_alone(&known, *id));
        hidden.into_iter().filter(is_removed).collect()
    }

    /// The cells of the map that some submaps know.
    pub fn coverage(&self, submaps: impl Iterator<Item = SubmapId>) -> Coverage {
        let mut coverage =
            Coverage { cells: BTreeMap::new(), known: HashMap::new(), cell_size: 1.0, is_3d: false };
        for id in submaps {
            let Some(submap) = self.state.submaps.get(&id).and_then(|entry| entry.submap.as_ref()) else {
                continue;
            };
            if let Some(centers) = S::solid_cell_centers(submap) {
                (coverage.cell_size, coverage.is_3d) = (VOXEL, true);
                coverage.add(id, self.voxels(id, &centers));
                continue;
            }
            if coverage.cells.is_empty() {
                coverage.cell_size = S::cell_size(submap);
            }
            let cells = self.covered_cells(id, coverage.cell_size).unwrap_or_default();
            coverage.add(id, cells.into_iter().map(|(x, y)| (x, y, 0)).collect());
        }
        coverage
    }

    /// The cells of the map that contain points of a submap.
    fn voxels(&self, id: SubmapId, in_submap: &[Point3f]) -> BTreeSet<Cell> {
        let Some(pose) = self.state.optimized_submaps.get(&id).map(to_f32) else { return BTreeSet::new() };
        let cell = |point: &Point3f| {
            let [x, y, z] = (pose * point).coords.map(|v| (f64::from(v) / VOXEL).round() as i64).into();
            (x, y, z)
        };
        in_submap.iter().map(cell).collect()
    }

    /// Connected components of the graph: each vertex with the first one of its component.
    pub(super) fn tied_parts(&self) -> BTreeMap<Part, Part> {
        let mut pieces = Pieces::default();
        self.state.submaps.keys().for_each(|id| pieces.add(Part::Submap(*id)));
        self.state.nodes.keys().for_each(|id| pieces.add(Part::Node(*id)));
        for c in &self.state.constraints {
            pieces.join(Part::Submap(c.submap_id), Part::Node(c.node_id));
        }
        for (a, b) in self.state.nodes.keys().zip(self.state.nodes.keys().skip(1)) {
            if a.trajectory_id == b.trajectory_id && a.index + 1 == b.index {
                pieces.join(Part::Node(*a), Part::Node(*b));
            }
        }
        pieces.roots()
    }

    /// Ties pieces together that were one piece before.
    pub(super) fn tie_torn(&mut self, before: &BTreeMap<Part, Part>) {
        let mut torn: BTreeMap<Part, BTreeMap<Part, Vec<Part>>> = BTreeMap::new();
        for (part, root) in self.tied_parts() {
            let Some(whole) = before.get(&part) else { continue };
            torn.entry(*whole).or_default().entry(root).or_default().push(part);
        }
        for pieces in torn.into_values() {
            let mut pieces: Vec<Vec<Part>> = pieces.into_values().collect();
            pieces.sort_by_key(|piece| (std::cmp::Reverse(piece.len()), piece.first().copied()));
            let mut pieces = pieces.into_iter();
            let mut tied: Vec<Place<NodeId>> = pieces.next().map(|p| self.nodes_in(&p)).unwrap_or_default();
            for piece in pieces {
                self.tie_piece(&piece, &tied);
                tied.extend(self.nodes_in(&piece));
            }
        }
    }

    /// Ties a submap of a piece to a node of the others: the two that are nearest to each other.
    fn tie_piece(&mut self, piece: &[Part], others: &[Place<NodeId>]) {
        let submaps = piece.iter().filter_map(|part| match part {
            Part::Submap(id) => Some((*id, *self.problem.submaps.get(id)?)),
            Part::Node(_) => None,
        });
        let pairs = submaps.flat_map(|submap| others.iter().map(move |node| (submap, node)));
        let distance = |a: &Rigid3, b: &Rigid3| (a.translation.vector - b.translation.vector).norm_squared();
        let nearest =
            pairs.min_by(|((_, a), (_, b)), ((_, c), (_, d))| distance(a, b).total_cmp(&distance(c, d)));
        if let Some(((submap_id, map_from_submap), (node_id, map_from_node))) = nearest {
            let submap_from_node = map_from_submap.inverse() * map_from_node;
            let tie = self.loop_closure(submap_id, *node_id, submap_from_node);
            self.load_constraint(tie);
        }
    }

    fn nodes_in(&self, piece: &[Part]) -> Vec<Place<NodeId>> {
        let place = |part: &Part| match part {
            Part::Node(id) => Some((*id, self.problem.nodes.get(id)?.map_from_node)),
            Part::Submap(_) => None,
        };
        piece.iter().filter_map(place).collect()
    }
}

/// Sets of parts that are joined one by one (union by the smaller first part, with path halving).
#[derive(Default)]
struct Pieces(BTreeMap<Part, Part>);

impl Pieces {
    fn add(&mut self, part: Part) {
        self.0.insert(part, part);
    }

    fn root(&mut self, part: Part) -> Option<Part> {
        let mut at = part;
        loop {
            let above = *self.0.get(&at)?;
            if above == at {
                return Some(at);
            }
            let next = *self.0.get(&above)?;
            self.0.insert(at, next);
            at = next;
        }
    }

    fn join(&mut self, a: Part, b: Part) {
        if let (Some(a), Some(b)) = (self.root(a), self.root(b)) {
            self.0.insert(a.max(b), a.min(b));
        }
    }

    fn roots(mut self) -> BTreeMap<Part, Part> {
        let parts: Vec<Part> = self.0.keys().copied().collect();
        parts.into_iter().filter_map(|part| Some((part, self.root(part)?))).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use portolan_config::Options;

    use super::*;
    use crate::made_rooms::{node, submap};
    use crate::{Constraint, ConstraintTag, Space2d};

    const ROOM: (f32, f32) = (9.0, 7.0);

    fn submap_id(index: u32) -> SubmapId {
        SubmapId::new(TrajectoryId(0), index)
    }

    /// Three submaps of a room on a line, half a metre apart; nodes 0, 1, 2, … with a gap after each, each in a submap and
    /// in the next one.
    fn chain() -> PoseGraph<Space2d> {
        let mut graph = PoseGraph::new(Options::default().map_builder.pose_graph);
        graph.load_trajectory(TrajectoryId(0), None);
        for index in 0..3 {
            let map_from_submap = Rigid3::translation(0.5 * f64::from(index), 0.0, 0.0);
            graph.load_submap(submap_id(index), Arc::new(submap(ROOM)), true, map_from_submap);
        }
        for (index, submaps) in [(0, vec![0]), (2, vec![0, 1]), (4, vec![1, 2]), (6, vec![2])] {
            let node_id = NodeId::new(TrajectoryId(0), index);
            let pose = Rigid3::translation(0.2 * f64::from(index), 0.0, 0.0);
            graph.load_node(node_id, Arc::new(node(ROOM, (0.0, 0.0))), pose);
            for submap in submaps {
                let loaded = graph.load_constraint(Constraint {
                    submap_id: submap_id(submap),
                    node_id,
                    submap_from_node: pose,
                    translation_weight: 1.0,
                    rotation_weight: 1.0,
                    tag: ConstraintTag::IntraSubmap,
                    open: None,
                    score: None,
                });
                assert!(loaded);
            }
        }
        graph
    }

    #[test]
    fn neighbours_of_a_removed_submap_are_connected_at_their_poses() {
        let mut graph = chain();
        graph.remove_submaps(&[submap_id(1)].into());
        let ties: Vec<&Constraint> =
            graph.state().constraints.iter().filter(|c| c.is_loop_closure()).collect();
        let [tie] = ties.as_slice() else { panic!("{ties:?}") };
        assert_eq!((tie.submap_id, tie.node_id.index), (submap_id(2), 2));
        let offset = tie.submap_from_node.translation.x;
        assert!((offset - (0.4 - 1.0)).abs() < 1e-12, "{offset}");
        graph.remove_submaps(&[submap_id(0), submap_id(2)].into());
        assert!(graph.state().nodes.is_empty() && graph.state().constraints.is_empty());
    }

    #[test]
    fn only_submaps_covered_by_newer_ones_are_replaced() {
        let mut graph = chain();
        let replacement = Replacement {
            newest: 2,
            least_seen: 2.0,
            most_alone: 0.1,
            least_share: 0.0,
            most_share_alone: 0.0,
        };
        let newer = TrajectoryId(1);
        graph.load_trajectory(newer, None);
        let far = Rigid3::translation(100.0, 0.0, 0.0);
        graph.load_submap(SubmapId::new(newer, 0), Arc::new(submap(ROOM)), true, far);
        assert!(graph.covered_by(newer, replacement).is_empty(), "it is elsewhere");
        for (index, x) in [(1, 0.0), (2, 0.5)] {
            let pose = Rigid3::translation(x, 0.0, 0.0);
            graph.load_submap(SubmapId::new(newer, index), Arc::new(submap(ROOM)), true, pose);
        }
        // Of the first and the third more than 2 m² at the ends are in the newest two that know them.
        assert_eq!(graph.covered_by(newer, replacement), [submap_id(1)].into());
    }
}
