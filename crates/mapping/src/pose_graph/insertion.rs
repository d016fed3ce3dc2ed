//! Inserts the results of local SLAM into the pose graph: nodes and submaps get their identity and a first
//! pose, and constraints between them (`slam2d.md` §14.3).

use std::sync::Arc;

use portolan_geometry::{Rigid3, Time};
use portolan_local_slam::InsertedNode;
use portolan_optimization::OptimizationNode;

use super::{PoseGraph, SubmapEntry};
use crate::{
    Constraint, ConstraintTag, Node, NodeData, NodeId, Space, SubmapId, TrajectoryId, of_trajectory,
};

/// Maximum motion between two nodes of a platform at rest, metres and radians.
const STANDING: (f64, f64) = (0.005, 0.003);
/// Minimum time between two nodes at rest whose IMU samples are averaged, seconds.
const LONG_REST: f64 = 1.5;

impl<S: Space> PoseGraph<S> {
    pub(super) fn append_node(&mut self, trajectory_id: TrajectoryId, data: &Arc<NodeData>) -> NodeId {
        let map_from_tracking = self.state.map_from_local(trajectory_id) * data.local_from_tracking;
        let trajectory = self.state.trajectory_mut(trajectory_id);
        let node_id = NodeId::new(trajectory_id, trajectory.next_node_index);
        trajectory.next_node_index += 1;
        let path_length = self.path_length_to(node_id, &data.local_from_tracking);
        self.path_lengths.insert(node_id, path_length);
        self.state.nodes.insert(node_id, Node { data: Arc::clone(data), map_from_tracking });
        node_id
    }

    /// Distance of a new node along its trajectory, metres.
    fn path_length_to(&self, node_id: NodeId, local_from_tracking: &Rigid3) -> f64 {
        let Some((before_id, before)) = of_trajectory(&self.state.nodes, node_id.trajectory_id).next_back()
        else {
            return 0.0;
        };
        let motion = before.data.local_from_tracking.inverse() * local_from_tracking;
        self.path_lengths.get(&before_id).copied().unwrap_or(0.0) + step_length(&motion)
    }

    /// Gives new submaps their identity and first global pose (`slam2d.md` §14.3, 1).
    pub(super) fn register_submaps(
        &mut self,
        trajectory_id: TrajectoryId,
        inserted: &InsertedNode<S>,
    ) -> Vec<SubmapId> {
        let ids: Vec<SubmapId> =
            inserted.submaps.iter().map(|s| SubmapId::new(trajectory_id, s.index)).collect();
        for (id, submap) in ids.iter().zip(&inserted.submaps) {
            self.state.submaps.entry(*id).or_insert_with(|| SubmapEntry {
                submap: None,
                local_from_submap: submap.local_from_submap,
                searchable: false,
                insertion_finished: false,
                node_ids: Default::default(),
            });
            if self.problem.submaps.contains_key(id) {
                continue;
            }
            let previous = of_trajectory(&self.problem.submaps, trajectory_id).next_back();
            let previous = previous.and_then(|(id, pose)| Some((pose, self.state.submaps.get(&id)?)));
            let map_from_submap = match previous {
                Some((map_from_previous, entry)) => {
                    map_from_previous * entry.local_from_submap.inverse() * submap.local_from_submap
                }
                None => self.state.map_from_local(trajectory_id) * submap.local_from_submap,
            };
            self.problem.submaps.insert(*id, map_from_submap);
        }
        ids
    }

    /// Gives the node the pose that follows from its oldest submap, and constrains it to each of its submaps.
    pub(super) fn place_node(
        &mut self,
        node_id: NodeId,
        inserted: &InsertedNode<S>,
        submap_ids: &[SubmapId],
    ) {
        let gravity_alignment = inserted.data.gravity_alignment;
        let local_from_node = S::graph_pose(&inserted.data.local_from_tracking, &gravity_alignment);
        let map_from_oldest = submap_ids.first().and_then(|id| self.problem.submaps.get(id));
        let map_from_node = match (map_from_oldest, inserted.submaps.first()) {
            (Some(map_from_submap), Some(submap)) => {
                map_from_submap * submap.local_from_submap.inverse() * local_from_node
            }
            _ => self.state.map_from_local(node_id.trajectory_id) * local_from_node,
        };
        self.thin_out_rest(node_id, inserted.data.time, &local_from_node);
        if !inserted.open.is_empty() {
            self.problem.open.insert(node_id, inserted.open.clone());
        }
        self.gathered.insert(node_id, inserted.gathered);
        if node_id.index == 0 && self.starts_where_given(node_id.trajectory_id) {
            self.problem.given_starts.insert(node_id, map_from_node);
        }
        self.problem.nodes.insert(
            node_id,
            OptimizationNode { time: inserted.data.time, local_from_node, map_from_node, gravity_alignment },
        );
        for (id, submap) in submap_ids.iter().zip(&inserted.submaps) {
            if let Some(entry) = self.state.submaps.get_mut(id) {
                entry.node_ids.insert(node_id);
            }
            self.state.constraints.push(Constraint {
                submap_id: *id,
                node_id,
                submap_from_node: submap.local_from_submap.inverse() * local_from_node,
                translation_weight: self.options.matcher_translation_weight,
                rotation_weight: self.options.matcher_rotation_weight,
                tag: ConstraintTag::IntraSubmap,
                open: None,
                score: None,
            });
        }
    }

    /// Whether a start given by the user constrains the trajectory. It does where it is verified, too.
    /// Cartographer only begins there.
    fn starts_where_given(&self, id: TrajectoryId) -> bool {
        self.searches_whole_maps()
            && self.state.trajectories.get(&id).is_some_and(|trajectory| trajectory.initial_pose.is_some())
    }

    /// Averages the IMU samples since the node before if the platform was at rest all the time.
    fn thin_out_rest(&mut self, node_id: NodeId, time: Time, local_from_node: &Rigid3) {
        let Some((_, before)) = of_trajectory(&self.problem.nodes, node_id.trajectory_id).next_back() else {
            return;
        };
        let motion = before.local_from_node.inverse() * local_from_node;
        let stood = motion.translation.vector.norm() < STANDING.0 && motion.rotation.angle() < STANDING.1;
        let start = before.time;
        if stood && time.seconds_since(start) >= LONG_REST {
            self.problem.sensors_mut(node_id.trajectory_id).thin_out_rest(start, time);
        }
    }
}

/// Path length of a motion from one node to the next, metres. Rotation shows new sides of a place as
/// translation does, and counts, too.
pub(super) fn step_length(motion: &Rigid3) -> f64 {
    const METRES_PER_RADIAN: f64 = 1.0;
    motion.translation.vector.norm() + METRES_PER_RADIAN * motion.rotation.angle()
}
