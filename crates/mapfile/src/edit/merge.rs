//! Adds another map at the place where its scans match.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use portolan_config::Options;
use portolan_geometry::{Dimension, NearFrame, Rigid3};
use portolan_issue::IssueLog;
use portolan_mapping::{
    Constraint, ConstraintTag, NodeId, PoseGraph, PoseGraphPolicy, Space2d, Space3d, SubmapId, TrajectoryId,
};
use portolan_sensor::LandmarkData;
use serde::Serialize;

use super::loop_search::check_size;
use super::optimize::{
    Collected, MapOptimization, in_file, node_in_memory, submap_in_memory, trajectory_in_memory,
};
use super::{EditError, MapDraft};
use crate::convert::{MapFileSpace, node_data};
use portolan_pbstream::MapReader;
use portolan_pbstream::proto::mapping::pose_graph::Constraint as ConstraintMessage;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{NodeId as NodeIdMessage, SubmapId as SubmapIdMessage};
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, pose_to_proto, submap_id, submap_poses};

/// Result of placing a merged map.
#[derive(Clone, Debug, Serialize)]
pub struct JoinedMap {
    /// From the numbers of its trajectories to those in this map.
    pub ids: BTreeMap<i32, i32>,
    /// Transform of the first node of its first trajectory: from its map to this one.
    #[serde(skip)]
    pub map_from_other: Rigid3,
    /// Number of loop closures between the maps.
    pub loop_closures: u64,
    /// Optimisation of all poses with these loop closures.
    pub optimization: MapOptimization,
}

impl MapDraft {
    /// Adds all of another map where its scans match this one, closes loops between the two, and optimises
    /// all poses. Its trajectories get the next free numbers.
    ///
    /// # Errors
    /// As for [`MapDraft::append`]; [`EditError::NotPlaced`] if its scans do not agree on a pose. The draft
    /// should be dropped then.
    pub fn append_aligned(
        &mut self,
        path: impl AsRef<Path>,
        options: &Options,
    ) -> Result<JoinedMap, EditError> {
        let path = path.as_ref();
        let frame = self.near_frame();
        let ids = self.append(path, &Rigid3::identity())?;
        self.require_on_earth()?;
        match self.dimension {
            Some(Dimension::ThreeD) => self.join::<Space3d>(path, ids, options, &frame),
            _ => self.join::<Space2d>(path, ids, options, &frame),
        }
    }

    /// Joins the maps in a near frame of this map, because the other map will be placed near it.
    fn join<S: MapFileSpace>(
        &mut self,
        path: &Path,
        ids: BTreeMap<i32, i32>,
        options: &Options,
        frame: &NearFrame,
    ) -> Result<JoinedMap, EditError> {
        let collected = Collected::read(self)?;
        let mut graph = self.pose_graph_in_memory::<S>(&collected, options)?;
        graph.move_by(&-frame.origin());
        let joining: BTreeSet<TrajectoryId> = ids.values().map(|id| trajectory_in_memory(*id)).collect();
        let lost = graph.join(&joining);
        if !lost.is_empty() {
            let here: BTreeMap<i32, i32> = ids.iter().map(|(there, here)| (*here, *there)).collect();
            let there = lost.iter().filter_map(|id| here.get(&id.0.cast_signed()).copied()).collect();
            return Err(EditError::NotPlaced { path: path.to_owned(), trajectories: there });
        }
        let is_first = |id: &IdInFile| ids.values().min() == Some(&id.0);
        let first = self.all_node_poses().into_iter().find(|(id, _)| is_first(id));
        graph.move_by(&frame.origin());
        let (_, summary) = graph.optimizations();
        let optimization = self.take_over::<S>(graph.problem(), graph.state().constraints.len(), summary)?;
        let moved = first.and_then(|(id, old)| Some(self.all_node_poses().get(&id)? * old.inverse()));
        let loop_closures = self.take_over_loops(&graph, &joining);
        Ok(JoinedMap {
            ids,
            map_from_other: moved.unwrap_or_else(Rigid3::identity),
            loop_closures,
            optimization,
        })
    }

    /// The draft as a pose graph of mapping.
    fn pose_graph_in_memory<S: MapFileSpace>(
        &self,
        collected: &Collected,
        options: &Options,
    ) -> Result<PoseGraph<S>, EditError> {
        let mut graph = PoseGraph::<S>::new(options.map_builder.pose_graph.clone());
        graph.set_policy(PoseGraphPolicy::new(&options.portolan));
        for id in self.trajectory_ids() {
            graph.load_trajectory(trajectory_in_memory(id), None);
        }
        self.load_submaps_and_nodes(&mut graph)?;
        for constraint in self.constraints::<S>(collected) {
            graph.load_constraint(constraint);
        }
        for (id, sensors) in &collected.sensors {
            sensors.imu.values().for_each(|data| graph.add_imu_data(*id, *data));
            sensors.odometry.values().for_each(|data| graph.add_odometry_data(*id, *data));
            sensors.fixed_frame.values().for_each(|data| graph.add_fixed_frame_pose_data(*id, *data));
            graph.set_imu_state(*id, sensors.imu_state);
        }
        for sighting in collected.landmarks.values().flat_map(|landmark| &landmark.sightings) {
            let (time, observations) = (sighting.time, vec![sighting.observation.clone()]);
            graph.add_landmark_data(sighting.trajectory_id, LandmarkData { time, observations });
        }
        for landmark in &self.graph.landmark_poses {
            if let Some(pose) = pose_from_proto(landmark.global_pose.as_ref()) {
                graph.set_landmark_pose(&landmark.landmark_id, pose, false);
            }
        }
        for (id, origin) in &collected.fixed_frame_origins {
            if let Some(origin) = origin {
                graph.set_fixed_frame_origin(*id, *origin);
            }
        }
        graph.complete_loaded_submaps(options);
        Ok(graph)
    }

    fn load_submaps_and_nodes<S: MapFileSpace>(&self, graph: &mut PoseGraph<S>) -> Result<(), EditError> {
        let (submap_poses, node_poses) = (submap_poses(&self.graph), self.all_node_poses());
        for source in &self.sources {
            let failed = |error| EditError::File { path: source.path.clone(), source: error };
            let unusable = |error| EditError::Content { path: source.path.clone(), source: Box::new(error) };
            let here = |id: IdInFile| source.ids.get(&id.0).map(|trajectory| (*trajectory, id.1));
            let mut reader = MapReader::open_with(&source.path, self.limits).map_err(failed)?;
            while let Some(message) = reader.next_message().map_err(failed)? {
                match message.data {
                    Data::Submap(m) => {
                        let Some(id) = here(submap_id(m.submap_id.as_ref())) else { continue };
                        let Some(pose) = submap_poses.get(&id) else { continue };
                        let (submap, finished) =
                            S::submap_from_proto(m, id, &mut IssueLog::default()).map_err(unusable)?;
                        graph.load_submap(submap_in_memory(id), Arc::new(submap), finished, *pose);
                    }
                    Data::Node(m) => {
                        let Some(id) = here(node_id(m.node_id.as_ref())) else { continue };
                        let Some(pose) = node_poses.get(&id) else { continue };
                        let data = node_data(m, id).map_err(unusable)?;
                        check_size(&data).map_err(|reason| {
                            let reason = format!("node {},{} {reason}", id.0, id.1);
                            EditError::Broken { path: source.path.clone(), reason }
                        })?;
                        graph.load_node(node_in_memory(id), Arc::new(data), *pose);
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }

    /// Removes the loop closures that the pose graph dropped and adds those that it found. Returns the number
    /// of loop closures between the joined trajectories and the others.
    fn take_over_loops<S: MapFileSpace>(
        &mut self,
        graph: &PoseGraph<S>,
        joining: &BTreeSet<TrajectoryId>,
    ) -> u64 {
        let is_loop = |c: &&Constraint| c.tag == ConstraintTag::InterSubmap;
        let mut left: BTreeMap<(SubmapId, NodeId), &Constraint> =
            graph.state().constraints.iter().filter(is_loop).map(|c| ((c.submap_id, c.node_id), c)).collect();
        let between = |(submap, node): &(SubmapId, NodeId)| {
            joining.contains(&submap.trajectory_id) != joining.contains(&node.trajectory_id)
        };
        let count = left.keys().filter(|pair| between(pair)).count() as u64;
        let before = self.graph.constraint.len();
        self.graph.constraint.retain(|c| {
            let pair = (
                submap_in_memory(submap_id(c.submap_id.as_ref())),
                node_in_memory(node_id(c.node_id.as_ref())),
            );
            c.tag() != Tag::InterSubmap || left.remove(&pair).is_some()
        });
        self.report.constraints_removed += (before - self.graph.constraint.len()) as u64;
        self.report.constraints_added += left.len() as u64;
        for constraint in left.into_values() {
            let Some(node) = graph.state().nodes.get(&constraint.node_id) else { continue };
            let pose = S::tracking_pose(&constraint.submap_from_node, &node.data.gravity_alignment);
            let submap = in_file(constraint.submap_id.trajectory_id, constraint.submap_id.index);
            let node = in_file(constraint.node_id.trajectory_id, constraint.node_id.index);
            self.graph.constraint.push(ConstraintMessage {
                submap_id: Some(SubmapIdMessage { trajectory_id: submap.0, submap_index: submap.1 }),
                node_id: Some(NodeIdMessage { trajectory_id: node.0, node_index: node.1 }),
                relative_pose: Some(pose_to_proto(&pose)),
                translation_weight: constraint.translation_weight,
                rotation_weight: constraint.rotation_weight,
                tag: Tag::InterSubmap.into(),
            });
        }
        count
    }
}
