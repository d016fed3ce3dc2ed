//! Removes and renames trajectories; cuts maps by time.

use std::collections::{BTreeMap, BTreeSet};

use portolan_geometry::{Rigid3, Time};

use super::{EditError, MapDraft};
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, submap_id};

impl MapDraft {
    /// Checks that a trajectory exists.
    ///
    /// # Errors
    /// [`EditError::NoTrajectory`] if it does not.
    pub fn require_trajectory(&self, id: i32) -> Result<(), EditError> {
        if self.trajectory_ids().any(|t| t == id) {
            return Ok(());
        }
        let known: Vec<String> = self.trajectory_ids().map(|t| t.to_string()).collect();
        Err(EditError::NoTrajectory { id, known: known.join(", ") })
    }

    /// Removes all other trajectories and all parts that depend on them.
    pub fn retain_trajectories(&mut self, keep: impl Fn(i32) -> bool) {
        let before = self.graph.trajectory.len();
        let removed = self.graph.trajectory.iter().filter(|t| !keep(t.trajectory_id));
        let (submaps, nodes) =
            removed.fold((0, 0), |(s, n), t| (s + t.submap.len() as u64, n + t.node.len() as u64));
        self.report.submaps_removed += submaps;
        self.report.nodes_removed += nodes;
        let flags: Vec<bool> = self.graph.trajectory.iter().map(|t| keep(t.trajectory_id)).collect();
        let mut flag = flags.iter();
        self.options.retain(|_| flag.next().copied().unwrap_or(false));
        self.graph.trajectory.retain(|t| keep(t.trajectory_id));
        self.report.trajectories_removed += (before - self.graph.trajectory.len()) as u64;
        for source in &mut self.sources {
            source.ids.retain(|_, id| keep(*id));
        }
        let kept: BTreeSet<i32> = self.trajectory_ids().collect();
        for options in &mut self.options {
            if options.start_relative_to().is_some_and(|id| !kept.contains(&id)) {
                options.set_start_relative_to(None);
            }
        }
        self.drop_loose_constraints();
    }

    /// Renumbers trajectories; those that are not in `names` keep their numbers.
    ///
    /// # Errors
    /// If one is missing, or if two would have the same number.
    pub fn rename_trajectories(&mut self, names: &BTreeMap<i32, i32>) -> Result<(), EditError> {
        names.keys().try_for_each(|id| self.require_trajectory(*id))?;
        let new = |id: i32| names.get(&id).copied().unwrap_or(id);
        let mut seen = BTreeSet::new();
        for id in self.trajectory_ids().map(new) {
            if id < 0 || !seen.insert(id) {
                return Err(EditError::SameTrajectory(id));
            }
        }
        for trajectory in &mut self.graph.trajectory {
            trajectory.trajectory_id = new(trajectory.trajectory_id);
        }
        for constraint in &mut self.graph.constraint {
            if let Some(id) = &mut constraint.submap_id {
                id.trajectory_id = new(id.trajectory_id);
            }
            if let Some(id) = &mut constraint.node_id {
                id.trajectory_id = new(id.trajectory_id);
            }
        }
        for options in &mut self.options {
            if let Some(id) = options.start_relative_to()
                && new(id) != id
            {
                options.set_start_relative_to(Some(new(id)));
            }
        }
        for source in &mut self.sources {
            source.ids.values_mut().for_each(|id| *id = new(*id));
        }
        self.cuts = std::mem::take(&mut self.cuts).into_iter().map(|(id, cut)| (new(id), cut)).collect();
        for area in &mut self.cleared {
            let submaps = std::mem::take(&mut area.submaps);
            area.submaps = submaps.into_iter().map(|(id, pose)| ((new(id.0), id.1), pose)).collect();
        }
        let estimates = std::mem::take(&mut self.estimates);
        self.estimates = estimates.into_iter().map(|(id, estimate)| (new(id), estimate)).collect();
        Ok(())
    }

    /// Times of the first and the last node.
    pub fn time_span(&self) -> Option<(Time, Time)> {
        let times = || self.graph.trajectory.iter().flat_map(|t| t.node.iter().map(|n| n.timestamp));
        Some((Time::from_ticks(times().min()?), Time::from_ticks(times().max()?)))
    }

    /// Keeps only nodes from `start` to `end`. A submap stays if at least half of the nodes inserted into it
    /// stay; a node stays if one of its submaps does.
    ///
    /// # Errors
    /// If nothing would be left.
    pub fn cut_time(&mut self, start: Time, end: Time) -> Result<(), EditError> {
        let range = start.ticks()..=end.ticks();
        let inside = |_: i32, _: &Rigid3, time: i64| range.contains(&time);
        self.retain_nodes(&inside, &|_| true)?;
        for trajectory in &self.graph.trajectory {
            let times = || trajectory.node.iter().map(|n| n.timestamp);
            if let (Some(first), Some(last)) = (times().min(), times().max()) {
                self.cuts.insert(trajectory.trajectory_id, (first, last));
            }
        }
        Ok(())
    }

    /// Keeps only some nodes (by trajectory, pose and time), the submaps at least half of whose nodes are
    /// kept, and the parts that depend on these. `keep_empty` decides on submaps without nodes by their
    /// poses.
    pub(super) fn retain_nodes(
        &mut self,
        keep: &dyn Fn(i32, &Rigid3, i64) -> bool,
        keep_empty: &dyn Fn(&Rigid3) -> bool,
    ) -> Result<(), EditError> {
        let mut nodes: BTreeSet<IdInFile> = BTreeSet::new();
        for trajectory in &self.graph.trajectory {
            let t = trajectory.trajectory_id;
            for node in &trajectory.node {
                let pose = pose_from_proto(node.pose.as_ref());
                if pose.is_some_and(|pose| keep(t, &pose, node.timestamp)) {
                    nodes.insert((t, node.node_index));
                }
            }
        }
        let submaps = self.submaps_of_nodes(&nodes, keep_empty);
        let members = self.graph.constraint.iter().filter(|c| c.tag() == Tag::IntraSubmap);
        let mut homeless: BTreeSet<IdInFile> = BTreeSet::new();
        let mut housed: BTreeSet<IdInFile> = BTreeSet::new();
        for constraint in members {
            let (submap, node) =
                (submap_id(constraint.submap_id.as_ref()), node_id(constraint.node_id.as_ref()));
            if submaps.contains(&submap) {
                housed.insert(node)
            } else {
                homeless.insert(node)
            };
        }
        nodes.retain(|id| housed.contains(id) || !homeless.contains(id));
        self.retain_parts(&submaps, &nodes)
    }

    /// Submaps with at least half of their nodes in `nodes`.
    fn submaps_of_nodes(
        &self,
        nodes: &BTreeSet<IdInFile>,
        keep_empty: &dyn Fn(&Rigid3) -> bool,
    ) -> BTreeSet<IdInFile> {
        let mut counts: BTreeMap<IdInFile, (u64, u64)> = BTreeMap::new();
        for constraint in self.graph.constraint.iter().filter(|c| c.tag() == Tag::IntraSubmap) {
            let count = counts.entry(submap_id(constraint.submap_id.as_ref())).or_default();
            count.0 += u64::from(nodes.contains(&node_id(constraint.node_id.as_ref())));
            count.1 += 1;
        }
        let mut submaps = BTreeSet::new();
        for trajectory in &self.graph.trajectory {
            for submap in &trajectory.submap {
                let id = (trajectory.trajectory_id, submap.submap_index);
                let is_kept = match counts.get(&id) {
                    Some((kept, all)) => *kept > 0 && 2 * kept >= *all,
                    None => pose_from_proto(submap.pose.as_ref()).is_some_and(|pose| keep_empty(&pose)),
                };
                if is_kept {
                    submaps.insert(id);
                }
            }
        }
        submaps
    }

    fn retain_parts(
        &mut self,
        submaps: &BTreeSet<IdInFile>,
        nodes: &BTreeSet<IdInFile>,
    ) -> Result<(), EditError> {
        if nodes.is_empty() && submaps.is_empty() {
            return Err(EditError::Empty);
        }
        for trajectory in &mut self.graph.trajectory {
            let t = trajectory.trajectory_id;
            let before = (trajectory.submap.len(), trajectory.node.len());
            trajectory.submap.retain(|s| submaps.contains(&(t, s.submap_index)));
            trajectory.node.retain(|n| nodes.contains(&(t, n.node_index)));
            self.report.submaps_removed += (before.0 - trajectory.submap.len()) as u64;
            self.report.nodes_removed += (before.1 - trajectory.node.len()) as u64;
        }
        let left = self.graph.trajectory.iter().filter(|t| !t.submap.is_empty() || !t.node.is_empty());
        let left: BTreeSet<i32> = left.map(|t| t.trajectory_id).collect();
        self.retain_trajectories(|id| left.contains(&id));
        Ok(())
    }

    /// Removes constraints to missing submaps and nodes.
    fn drop_loose_constraints(&mut self) {
        let (mut submaps, mut nodes) = (BTreeSet::new(), BTreeSet::new());
        for trajectory in &self.graph.trajectory {
            let t = trajectory.trajectory_id;
            submaps.extend(trajectory.submap.iter().map(|s| (t, s.submap_index)));
            nodes.extend(trajectory.node.iter().map(|n| (t, n.node_index)));
        }
        let before = self.graph.constraint.len();
        self.graph.constraint.retain(|c| {
            submaps.contains(&submap_id(c.submap_id.as_ref())) && nodes.contains(&node_id(c.node_id.as_ref()))
        });
        self.report.constraints_removed += (before - self.graph.constraint.len()) as u64;
    }
}
