//! Removes submaps that are not needed any more (`slam2d.md` §14.7).

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use portolan_config::OverlappingSubmapsTrimmer2dOptions;
use portolan_geometry::{Rigid3, Time, embed_3d, project_2d};

use super::trimmed_nodes::Anchor;
use super::visible_cells::VisibleCells;
use super::{GraphState, PoseGraph, TrajectoryState, TrimmedNode, TrimmedTies};
use crate::{Constraint, ConstraintTag, Node, NodeId, Space, SubmapId, TrajectoryId};

/// How the poses of removed nodes are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Remains {
    /// As poses in the map.
    Fixed,
    /// Relative to a node that stays.
    Anchored,
}

/// Decides after each optimisation what to remove.
#[derive(Clone, Debug)]
pub enum Trimmer {
    /// Keeps the newest submaps of one trajectory: localisation in a given map.
    PureLocalization {
        /// The trajectory.
        trajectory_id: TrajectoryId,
        /// How many submaps stay.
        keep: usize,
    },
    /// Removes submaps whose area fresher submaps cover.
    OverlappingSubmaps {
        /// As documented with the option.
        options: OverlappingSubmapsTrimmer2dOptions,
        /// Submaps left after the last trimming.
        count_after_last_trim: usize,
    },
}

impl Trimmer {
    /// Keeps the newest `keep` submaps (at least two).
    pub fn pure_localization(trajectory_id: TrajectoryId, keep: usize) -> Self {
        Self::PureLocalization { trajectory_id, keep: keep.max(2) }
    }

    /// Removes what fresher submaps cover.
    pub fn overlapping(options: &OverlappingSubmapsTrimmer2dOptions) -> Self {
        Self::OverlappingSubmaps { options: options.clone(), count_after_last_trim: 0 }
    }
}

/// Number of visible cells of each submap.
pub(super) struct SeenAreas {
    pub cells: BTreeMap<SubmapId, u64>,
    /// Edge of a cell, metres.
    pub cell_size: f64,
}

impl SeenAreas {
    /// Whether less than `area` of a submap is visible, square metres.
    pub fn too_little(&self, id: &SubmapId, area: f64) -> bool {
        let needed = (area / (self.cell_size * self.cell_size)).floor().max(1.0);
        (self.cells.get(id).copied().unwrap_or(0) as f64) < needed
    }
}

impl<S: Space> PoseGraph<S> {
    /// Adds a trimmer that removes superfluous submaps after each optimisation.
    pub fn add_trimmer(&mut self, trimmer: Trimmer) {
        self.trimmers.push(trimmer);
    }

    /// Keeps the poses of removed nodes in a file in this folder instead of memory. To be called before
    /// anything is added.
    pub fn spool_in(&mut self, folder: &Path) {
        self.state.trimmed_nodes.keep_in(folder);
    }

    pub(super) fn run_trimmers(&mut self) {
        let trimmers = std::mem::take(&mut self.trimmers);
        for trimmer in trimmers {
            let rest = self.run_trimmer(trimmer);
            self.trimmers.extend(rest);
        }
    }

    /// Runs a trimmer once and returns it unless its work is done.
    fn run_trimmer(&mut self, trimmer: Trimmer) -> Option<Trimmer> {
        match trimmer {
            Trimmer::PureLocalization { trajectory_id, keep } => {
                let finished = self.state.trajectory_state(trajectory_id) == TrajectoryState::Finished;
                let keep = if finished { 0 } else { keep };
                let submaps = self.submaps_of(trajectory_id);
                for id in submaps.iter().take(submaps.len().saturating_sub(keep)) {
                    self.trim_submap(*id);
                }
                if finished {
                    self.mark_deleted(trajectory_id);
                    return None;
                }
                Some(Trimmer::PureLocalization { trajectory_id, keep })
            }
            Trimmer::OverlappingSubmaps { options, count_after_last_trim } => {
                let freshness = self.finished_submap_freshness();
                let added = freshness.len().saturating_sub(count_after_last_trim);
                if added <= options.min_added_submaps_count {
                    return Some(Trimmer::OverlappingSubmaps { options, count_after_last_trim });
                }
                let superfluous = self.covered_submaps(&freshness, &options);
                for id in &superfluous {
                    self.trim_submap(*id);
                }
                let count_after_last_trim = freshness.len() - superfluous.len();
                Some(Trimmer::OverlappingSubmaps { options, count_after_last_trim })
            }
        }
    }

    /// Finished and optimised submaps with the time of their newest own node.
    fn finished_submap_freshness(&self) -> BTreeMap<SubmapId, Option<Time>> {
        let mut newest: BTreeMap<SubmapId, NodeId> = BTreeMap::new();
        for c in self.state.constraints.iter().filter(|c| c.tag == ConstraintTag::IntraSubmap) {
            let node = newest.entry(c.submap_id).or_insert(c.node_id);
            *node = c.node_id.max(*node);
        }
        self.state
            .submaps
            .iter()
            .filter(|(id, s)| {
                s.insertion_finished && s.searchable && self.state.optimized_submaps.contains_key(id)
            })
            .map(|(id, _)| {
                let time = newest.get(id).and_then(|n| self.state.nodes.get(n)).map(|n| n.data.time);
                (*id, time)
            })
            .collect()
    }

    /// Submaps of which too little is visible: every cell of the map counts for its freshest submaps only.
    fn covered_submaps(
        &self,
        freshness: &BTreeMap<SubmapId, Option<Time>>,
        options: &OverlappingSubmapsTrimmer2dOptions,
    ) -> Vec<SubmapId> {
        let mut freshest_first: Vec<(Time, SubmapId)> =
            freshness.iter().filter_map(|(id, time)| Some(((*time)?, *id))).collect();
        freshest_first.sort_unstable_by(|a, b| b.cmp(a));
        let freshest_first = freshest_first.into_iter().map(|(_, id)| id);
        let Some(seen) = self.areas_seen(freshest_first, options.fresh_submaps_count) else {
            return Vec::new();
        };
        let is_hidden = |id: &&SubmapId| seen.too_little(id, options.min_covered_area);
        freshness.keys().filter(is_hidden).copied().collect()
    }

    /// Visible cells of each submap, if every cell of the map counts for the first `counted` submaps that
    /// know it; none where coverage is not defined.
    pub(super) fn areas_seen(
        &self,
        freshest_first: impl Iterator<Item = SubmapId> + Clone,
        counted: usize,
    ) -> Option<SeenAreas> {
        let cell_size_of = |id| self.state.submaps.get(&id)?.submap.as_ref().map(|s| S::cell_size(s));
        let cell_size = freshest_first.clone().find_map(cell_size_of)?;
        let mut visible = VisibleCells::in_first(counted);
        let mut cells: BTreeMap<SubmapId, u64> = BTreeMap::new();
        for id in freshest_first {
            let own = self.covered_cells(id, cell_size)?;
            cells.insert(id, visible.next(&own, &own).len() as u64);
        }
        Some(SeenAreas { cells, cell_size })
    }

    /// Cells of the global map that the submap knows; `None` in spaces without such cells.
    pub(super) fn covered_cells(&self, id: SubmapId, cell_size: f64) -> Option<BTreeSet<(i64, i64)>> {
        let submap = self.state.submaps.get(&id).and_then(|entry| entry.submap.as_ref());
        let (Some(submap), Some(map_from_submap)) = (submap, self.state.optimized_submaps.get(&id)) else {
            return Some(BTreeSet::new());
        };
        let map_from_submap = project_2d(&embed_3d(&project_2d(map_from_submap)));
        let cell = |center: &portolan_geometry::Vector2| {
            let p = map_from_submap.transform_point(center) / cell_size;
            (p.x.round() as i64, p.y.round() as i64)
        };
        Some(S::known_cell_centers(submap)?.iter().map(cell).collect())
    }

    /// Removes a submap, the nodes that belong to no other submap, and every constraint of either.
    pub(super) fn trim_submap(&mut self, id: SubmapId) {
        self.trim(id, Remains::Fixed);
    }

    /// As [`Self::trim_submap`].
    pub(super) fn trim(&mut self, id: SubmapId, remains: Remains) {
        let Some(entry) = self.state.submaps.remove(&id) else { return };
        let orphans: BTreeSet<NodeId> = entry
            .node_ids
            .iter()
            .filter(|node| !self.state.submaps.values().any(|s| s.node_ids.contains(node)))
            .copied()
            .collect();
        self.remember_ties(&entry.node_ids, |c| c.submap_id == id || orphans.contains(&c.node_id));
        let mut weakened: BTreeSet<SubmapId> = BTreeSet::new();
        self.state.constraints.retain(|c| {
            let is_removed = c.submap_id == id || orphans.contains(&c.node_id);
            if is_removed && c.submap_id != id {
                weakened.insert(c.submap_id);
            }
            !is_removed
        });
        for constraint in self.state.constraints.iter().filter(|c| c.is_loop_closure()) {
            weakened.remove(&constraint.submap_id);
        }
        for submap_id in weakened {
            self.search.delete_matcher(submap_id);
        }
        self.search.delete_matcher(id);
        self.search.forget_tasks(|submap, node| submap == id || orphans.contains(&node));
        self.problem.submaps.remove(&id);
        self.extents.remove(&id);
        self.state.optimized_submaps.remove(&id);
        let removed: Vec<(NodeId, Node)> =
            orphans.into_iter().filter_map(|id| self.state.nodes.remove_entry(&id)).collect();
        for (id, Node { data, map_from_tracking }) in removed {
            let (time, local_from_tracking) = (data.time, data.local_from_tracking);
            let trimmed = TrimmedNode { time, local_from_tracking, map_from_tracking };
            let anchor = match remains {
                Remains::Fixed => None,
                Remains::Anchored => self.anchor(&map_from_tracking),
            };
            self.state.trimmed_nodes.add(id, trimmed, anchor);
            self.path_lengths.remove(&id);
            self.open_nodes.forget(id);
            self.problem.trim_node(id);
        }
    }

    /// The node nearest to a pose, and the pose in its frame.
    fn anchor(&self, map_from_tracking: &Rigid3) -> Option<Anchor> {
        let distance = |node: &Node| {
            (node.map_from_tracking.translation.vector - map_from_tracking.translation.vector).norm_squared()
        };
        let nearest = self.state.nodes.iter().min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
        nearest.map(|(id, node)| Anchor {
            node: *id,
            anchor_from_tracking: node.map_from_tracking.inverse() * map_from_tracking,
        })
    }

    /// Counts the loop closures between trajectories that are removed together with a submap of these nodes.
    fn remember_ties(&mut self, of_submap: &BTreeSet<NodeId>, is_removed: impl Fn(&Constraint) -> bool) {
        let submap_since = of_submap.iter().find_map(|id| self.state.nodes.get(id)).map(|n| n.data.time);
        let GraphState { constraints, nodes, trimmed_ties, .. } = &mut self.state;
        for c in constraints.iter().filter(|c| is_removed(c)) {
            let (of_node, of_submap) = (c.node_id.trajectory_id, c.submap_id.trajectory_id);
            if of_node == of_submap {
                continue;
            }
            let node_time = nodes.get(&c.node_id).map(|n| n.data.time);
            for (trajectory_id, time) in [(of_node, node_time), (of_submap, submap_since)] {
                let Some(time) = time else { continue };
                let ties = trimmed_ties.entry(trajectory_id).or_insert(TrimmedTies { count: 0, first: time });
                ties.count += 1;
                ties.first = ties.first.min(time);
            }
        }
    }
}
