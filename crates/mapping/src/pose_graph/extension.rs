//! Adds a recording that was localised in a map to this map as a trajectory.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use portolan_geometry::{Rigid3, Time};
use portolan_numeric::median;
use rayon::prelude::*;

use super::PoseGraph;
use crate::{
    Constraint, ConstraintTag, LocalTrack, NodeData, NodeId, Placement, Space, SubmapId, TrackedNode,
    TrajectoryId, of_trajectory,
};

/// Minimum number of localised scans of a submap; submaps with fewer show little and are weakly constrained.
const FEWEST_SCANS: usize = 10;
/// Fraction of localised scans from which a submap is taken as it is if it cannot be drawn from some of its
/// scans: it is rigid, and these scans determine its pose.
const LEAST_PLACED: f64 = 0.5;
/// Minimum distance between matches to the map, metres. Nearer ones see the same errors of the map; one of
/// them is enough.
pub(super) const TIE_SPACING: f64 = 0.5;

/// Statistics of adding a recording to a map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extension {
    /// Nodes.
    pub nodes: usize,
    /// Submaps.
    pub submaps: usize,
    /// Constraints to submaps that were there before.
    pub ties: usize,
    /// Median distance of the nodes from their localised positions after optimisation, metres.
    pub median_correction: f64,
}

/// A submap of local SLAM, restricted to its localised scans.
struct Part<S: Space> {
    submap: Arc<S::Submap>,
    local_from_submap: Rigid3,
    /// Positions of its nodes in the track.
    nodes: Vec<usize>,
}

impl<S: Space> PoseGraph<S> {
    /// Adds a recording as a trajectory: the localised nodes, with the submaps that they fill, tied to the
    /// submaps of the map in which they were found; then optimises. Frozen trajectories keep their poses.
    /// Adds nothing if no submap was filled by localised scans.
    ///
    /// In 3D, and where scans are not kept, submaps are taken whole if at least half of their scans were
    /// localised, or not at all.
    pub fn extend(&mut self, id: TrajectoryId, track: &LocalTrack<S>) -> Option<Extension> {
        let parts = parts(track);
        if parts.is_empty() || self.state.submaps.is_empty() {
            return None;
        }
        let old_submaps: BTreeSet<SubmapId> = self.state.submaps.keys().copied().collect();
        self.load_trajectory(id, None);
        let ids = self.load_tracked_nodes(id, track, &parts);
        for (index, part) in (0..).zip(&parts) {
            self.load_part(SubmapId::new(id, index), part, track, &ids);
        }
        let ties = self.tie_to(&old_submaps, track, &ids);
        self.load_tracked_imu(id, track);
        self.connect_to(id, &old_submaps);
        self.problem.max_iterations_override = u32::try_from(self.options.max_num_final_iterations).ok();
        self.run_optimization();
        self.problem.max_iterations_override = None;
        self.redraw_trajectory(id);
        let mut corrections: Vec<f64> = Vec::new();
        corrections.extend(ids.iter().filter_map(|(position, id)| {
            let optimized = self.state.nodes.get(id)?.map_from_tracking;
            let localised = track.nodes().get(*position)?.placement.map_from_tracking()?;
            Some((optimized.translation.vector - localised.translation.vector).norm())
        }));
        let median_correction = median(&mut corrections).unwrap_or(0.0);
        Some(Extension { nodes: ids.len(), submaps: parts.len(), ties, median_correction })
    }

    /// Nodes by their positions in the track. Indices skip one where nodes are not consecutive, so that no
    /// motion constraint is assumed there.
    fn load_tracked_nodes(
        &mut self,
        id: TrajectoryId,
        track: &LocalTrack<S>,
        parts: &[Part<S>],
    ) -> BTreeMap<usize, NodeId> {
        let kept: BTreeSet<usize> = parts.iter().flat_map(|part| part.nodes.iter().copied()).collect();
        let mut ids = BTreeMap::new();
        let (mut index, mut before) = (0, None);
        for position in kept {
            let Some(node) = track.nodes().get(position) else { continue };
            let Some(map_from_tracking) = node.placement.map_from_tracking() else { continue };
            let here = (position, node.piece);
            if before.is_some_and(|(last, piece)| (last + 1, piece) != here) {
                index += 1;
            }
            let node_id = NodeId::new(id, index);
            self.load_node(node_id, Arc::clone(&node.inserted.data), map_from_tracking);
            if !node.inserted.open.is_empty() {
                self.problem.open.insert(node_id, node.inserted.open.clone());
            }
            ids.insert(position, node_id);
            before = Some(here);
            index += 1;
        }
        ids
    }

    /// A submap with its constraints to the nodes that fill it.
    fn load_part(
        &mut self,
        id: SubmapId,
        part: &Part<S>,
        track: &LocalTrack<S>,
        ids: &BTreeMap<usize, NodeId>,
    ) {
        let of_part = part.nodes.iter().filter_map(|position| Some((*ids.get(position)?, *position)));
        let of_part: Vec<(NodeId, Rigid3)> = of_part
            .filter_map(|(node_id, position)| {
                let data = &track.nodes().get(position)?.inserted.data;
                let local_from_node = S::graph_pose(&data.local_from_tracking, &data.gravity_alignment);
                Some((node_id, part.local_from_submap.inverse() * local_from_node))
            })
            .collect();
        let Some((middle, submap_from_middle)) = of_part.get(of_part.len() / 2) else { return };
        let Some(map_from_middle) = self.problem.nodes.get(middle).map(|node| node.map_from_node) else {
            return;
        };
        let map_from_submap = map_from_middle * submap_from_middle.inverse();
        self.load_submap(id, Arc::clone(&part.submap), true, map_from_submap);
        for (node_id, submap_from_node) in of_part {
            self.load_constraint(Constraint {
                submap_id: id,
                node_id,
                submap_from_node,
                translation_weight: self.options.matcher_translation_weight,
                rotation_weight: self.options.matcher_rotation_weight,
                tag: ConstraintTag::IntraSubmap,
                open: None,
                score: None,
            });
        }
    }

    /// Constrains nodes that were found in the map to the submap there; returns their number.
    fn tie_to(
        &mut self,
        old: &BTreeSet<SubmapId>,
        track: &LocalTrack<S>,
        ids: &BTreeMap<usize, NodeId>,
    ) -> usize {
        let nearest = NearestSubmaps::new(self, old);
        let mut last: Option<Rigid3> = None;
        let mut ties = 0;
        for (position, node_id) in ids {
            let Some(node) = track.nodes().get(*position) else { continue };
            let Placement::Found(map_from_tracking) = node.placement else { continue };
            let step = last.map(|last| super::insertion::step_length(&(last.inverse() * map_from_tracking)));
            if step.is_some_and(|step| step < TIE_SPACING) {
                continue;
            }
            let Some(submap_id) = nearest.find(&map_from_tracking) else { continue };
            let Some(map_from_submap) = self.problem.submaps.get(&submap_id) else { continue };
            let map_from_node = S::graph_pose(&map_from_tracking, &node.inserted.data.gravity_alignment);
            let submap_from_node = map_from_submap.inverse() * map_from_node;
            let tie = self.loop_closure(submap_id, *node_id, submap_from_node);
            ties += usize::from(self.load_constraint(tie));
            last = Some(map_from_tracking);
        }
        ties
    }

    pub(super) fn loop_closure(
        &self,
        submap_id: SubmapId,
        node_id: NodeId,
        submap_from_node: Rigid3,
    ) -> Constraint {
        let options = &self.options.constraint_builder;
        Constraint {
            submap_id,
            node_id,
            submap_from_node,
            translation_weight: options.loop_closure_translation_weight,
            rotation_weight: options.loop_closure_rotation_weight,
            tag: ConstraintTag::InterSubmap,
            open: None,
            score: None,
        }
    }

    /// Adds IMU samples between consecutive nodes.
    fn load_tracked_imu(&mut self, id: TrajectoryId, track: &LocalTrack<S>) {
        let nodes: Vec<(u32, Time)> =
            of_trajectory(&self.problem.nodes, id).map(|(id, node)| (id.index, node.time)).collect();
        let mut samples = track.imu().iter().peekable();
        for pair in nodes.windows(2) {
            let [(a, start), (b, end)] = pair else { continue };
            let mut before = None;
            while let Some(sample) = samples.next_if(|sample| sample.time <= *start) {
                before = Some(*sample);
            }
            if b - a != 1 {
                continue;
            }
            before.into_iter().for_each(|sample| self.add_imu_data(id, sample));
            while let Some(sample) = samples.next_if(|sample| sample.time <= *end) {
                self.add_imu_data(id, *sample);
            }
            samples.peek().into_iter().for_each(|sample| self.add_imu_data(id, **sample));
        }
    }

    /// Connects the trajectory with the map, whether constraints tie it or not.
    fn connect_to(&mut self, id: TrajectoryId, old: &BTreeSet<SubmapId>) {
        let time = of_trajectory(&self.state.nodes, id).next().map(|(_, node)| node.data.time);
        if let (Some(first), Some(time)) = (old.first(), time) {
            self.state.connectivity.connect(id, first.trajectory_id, time);
        }
    }

    fn redraw_trajectory(&mut self, id: TrajectoryId) {
        let submaps = self.submaps_of(id);
        let redrawn: Vec<_> = submaps.par_iter().filter_map(|id| Some((*id, self.redrawn(*id)?))).collect();
        for (id, submap) in redrawn {
            if let Some(entry) = self.state.submaps.get_mut(&id) {
                entry.submap = Some(Arc::new(submap));
            }
        }
    }
}

/// The submaps of a track, restricted to localised scans.
fn parts<S: Space>(track: &LocalTrack<S>) -> Vec<Part<S>> {
    let mut nodes_of: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
    for (position, node) in track.nodes().iter().enumerate() {
        for submap in &node.inserted.submaps {
            nodes_of.entry((node.piece, submap.index)).or_default().push(position);
        }
    }
    let all: Vec<((u32, u32), Vec<usize>)> = nodes_of.into_iter().collect();
    all.par_iter().filter_map(|(key, nodes)| part(track, track.submaps().get(key)?, nodes)).collect()
}

fn part<S: Space>(track: &LocalTrack<S>, submap: &Arc<S::Submap>, all: &[usize]) -> Option<Part<S>> {
    let node = |position: &usize| track.nodes().get(*position);
    let is_placed = |position: &&usize| node(position).is_some_and(|n| n.placement != Placement::Unknown);
    let nodes: Vec<usize> = all.iter().filter(is_placed).copied().collect();
    if nodes.len() < FEWEST_SCANS {
        return None;
    }
    let local_from_submap = S::local_from_submap(submap);
    if nodes.len() == all.len() {
        return Some(Part { submap: Arc::clone(submap), local_from_submap, nodes });
    }
    let placed = |node: &TrackedNode<S>| -> (Arc<NodeData>, Rigid3) {
        let data = &node.inserted.data;
        let local_from_node = S::graph_pose(&data.local_from_tracking, &data.gravity_alignment);
        (Arc::clone(data), local_from_submap.inverse() * local_from_node)
    };
    let scans: Vec<_> = nodes.iter().filter_map(|position| node(position).map(placed)).collect();
    let drawn = S::drawn_from(submap, &mut scans.iter().map(|(data, pose)| (&**data, *pose)));
    let is_mostly_placed = nodes.len() as f64 >= LEAST_PLACED * all.len() as f64;
    let submap = drawn.map(Arc::new).or_else(|| is_mostly_placed.then(|| Arc::clone(submap)))?;
    Some(Part { submap, local_from_submap, nodes })
}

/// Finds the submap nearest to a place: the one whose node is nearest to it.
pub(super) struct NearestSubmaps {
    places: Vec<(Rigid3, SubmapId)>,
}

impl NearestSubmaps {
    pub fn new<S: Space>(graph: &PoseGraph<S>, submaps: &BTreeSet<SubmapId>) -> Self {
        let entries = submaps.iter().filter_map(|id| Some((*id, graph.state.submaps.get(id)?)));
        let places = entries.flat_map(|(id, entry)| {
            let of_nodes = entry.node_ids.iter().filter_map(|node| graph.state.nodes.get(node));
            let poses: Vec<Rigid3> = of_nodes.map(|node| node.map_from_tracking).collect();
            let own = graph.state.map_from_submap(id).filter(|_| poses.is_empty());
            poses.into_iter().chain(own).map(move |pose| (pose, id))
        });
        Self { places: places.collect() }
    }

    pub fn find(&self, place: &Rigid3) -> Option<SubmapId> {
        let distance = |pose: &Rigid3| (pose.translation.vector - place.translation.vector).norm_squared();
        let nearest = self.places.iter().min_by(|a, b| distance(&a.0).total_cmp(&distance(&b.0)));
        nearest.map(|(_, id)| *id)
    }
}
