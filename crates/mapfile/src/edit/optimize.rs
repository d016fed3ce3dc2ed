//! Optimises the poses of a map by its constraints and measurements.

mod collect;

use std::collections::BTreeMap;

use portolan_config::Options;
use portolan_geometry::{Dimension, Rigid3, Time};
use portolan_mapping::{Constraint, ConstraintTag, NodeId, Space, Space2d, Space3d, SubmapId, TrajectoryId};
use portolan_optimization::{
    OptimizationData, OptimizationNode, OptimizationSummary, SensorPolicy, TrajectoryConnectivity,
};
use serde::Serialize;

use super::{EditError, MapDraft};
pub(super) use collect::Collected;
use portolan_pbstream::proto::mapping::pose_graph::constraint::Tag;
use portolan_pbstream::{IdInFile, node_id, pose_from_proto, pose_to_proto, submap_id, submap_poses};

/// Report of the optimisation of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct MapOptimization {
    /// Cost before: half the weighted sum of squared residuals with robust loss.
    pub initial_cost: f64,
    /// Cost afterwards.
    pub final_cost: f64,
    /// Number of iterations.
    pub iterations: u32,
    /// Whether a tolerance was reached before the maximum number of iterations.
    pub converged: bool,
    /// Number of optimised submaps.
    pub submaps: u64,
    /// Number of optimised nodes.
    pub nodes: u64,
    /// Number of constraints used.
    pub constraints: u64,
    /// Largest displacement of a node, metres.
    pub largest_move: f64,
}

impl MapDraft {
    /// Optimises all poses of the map in at most `iterations` steps with all residuals of mapping: loop
    /// closures and constraints within submaps, relative motion of neighbouring nodes by local SLAM, odometry
    /// and (3D) the IMU, fixed-frame poses and landmarks. The first submap is fixed (in 3D it is aligned with
    /// gravity), and so is the first one of every part that no constraint connects to the rest. `options`
    /// should be those of the map ([`MapDraft::options`]): other weights than in mapping distort it.
    ///
    /// # Errors
    /// If the files cannot be read, a node lacks its pose, there is nothing to optimise, a part is at
    /// coordinates that are not possible on the Earth, or the optimisation fails.
    pub fn optimize(&mut self, options: &Options, iterations: u32) -> Result<MapOptimization, EditError> {
        self.require_on_earth()?;
        match self.dimension {
            Some(Dimension::ThreeD) => self.optimize_in::<Space3d>(options, iterations),
            _ => self.optimize_in::<Space2d>(options, iterations),
        }
    }

    fn optimize_in<S: Space>(
        &mut self,
        options: &Options,
        iterations: u32,
    ) -> Result<MapOptimization, EditError> {
        let collected = Collected::read(self)?;
        let mut data = self.problem::<S>(&collected);
        data.max_iterations_override = Some(iterations);
        data.sensor_policy = SensorPolicy::new(&options.portolan);
        let constraints = self.constraints::<S>(&collected);
        data.set_anchors(&connectivity(&data, &constraints));
        if data.nodes.is_empty() || data.submaps.is_empty() {
            return Err(EditError::Optimization("it has no nodes or no submaps".to_owned()));
        }
        // Far from the origin steps would be too short for the solver, in comparison with the coordinates.
        let frame = self.near_frame();
        data.move_by(&-frame.origin());
        let summary =
            S::optimize(&mut data, &constraints, &options.map_builder.pose_graph.optimization_problem);
        data.move_by(&frame.origin());
        self.take_over::<S>(&data, constraints.len(), summary)
    }

    fn problem<S: Space>(&self, collected: &Collected) -> OptimizationData {
        let mut data = OptimizationData {
            landmarks: collected.landmarks.clone(),
            sensors: collected.sensors.clone(),
            fixed_frame_origins: collected.fixed_frame_origins.clone(),
            ..OptimizationData::default()
        };
        for landmark in &self.graph.landmark_poses {
            if let Some(known) = data.landmarks.get_mut(&landmark.landmark_id) {
                known.map_from_landmark = pose_from_proto(landmark.global_pose.as_ref());
            }
        }
        for (id, pose) in submap_poses(&self.graph) {
            data.submaps.insert(submap_in_memory(id), pose);
        }
        for (id, map_from_tracking) in self.all_node_poses() {
            if let Some(node) = collected.nodes.get(&id) {
                let gravity_alignment = node.gravity_alignment;
                let node = OptimizationNode {
                    time: node.time,
                    local_from_node: S::graph_pose(&node.local_from_tracking, &gravity_alignment),
                    map_from_node: S::graph_pose(&map_from_tracking, &gravity_alignment),
                    gravity_alignment,
                };
                data.nodes.insert(node_in_memory(id), node);
            }
        }
        data
    }

    pub(super) fn constraints<S: Space>(&self, collected: &Collected) -> Vec<Constraint> {
        let usable = self.graph.constraint.iter().filter_map(|c| {
            let node = node_id(c.node_id.as_ref());
            let weights = [c.translation_weight, c.rotation_weight];
            let gravity_alignment = collected.nodes.get(&node)?.gravity_alignment;
            let pose = pose_from_proto(c.relative_pose.as_ref())?;
            weights.iter().all(|w| w.is_finite() && *w >= 0.0).then(|| Constraint {
                submap_id: submap_in_memory(submap_id(c.submap_id.as_ref())),
                node_id: node_in_memory(node),
                submap_from_node: S::graph_pose(&pose, &gravity_alignment),
                translation_weight: c.translation_weight,
                rotation_weight: c.rotation_weight,
                tag: match c.tag() {
                    Tag::IntraSubmap => ConstraintTag::IntraSubmap,
                    Tag::InterSubmap => ConstraintTag::InterSubmap,
                },
                open: None,
                score: None,
            })
        });
        usable.collect()
    }

    pub(super) fn take_over<S: Space>(
        &mut self,
        data: &OptimizationData,
        constraints: usize,
        summary: OptimizationSummary,
    ) -> Result<MapOptimization, EditError> {
        if summary.failed {
            let reason = "poses, constraints or weights are too large to compute with; see `portolan check`";
            return Err(EditError::Optimization(reason.to_owned()));
        }
        let submaps: BTreeMap<IdInFile, Rigid3> =
            data.submaps.iter().map(|(id, pose)| (in_file(id.trajectory_id, id.index), *pose)).collect();
        let tracking_pose =
            |node: &OptimizationNode| S::tracking_pose(&node.map_from_node, &node.gravity_alignment);
        let nodes: BTreeMap<IdInFile, Rigid3> = data
            .nodes
            .iter()
            .map(|(id, node)| (in_file(id.trajectory_id, id.index), tracking_pose(node)))
            .collect();
        let old = self.all_node_poses();
        let moves = nodes
            .iter()
            .filter_map(|(id, new)| Some((old.get(id)?.translation.vector - new.translation.vector).norm()));
        let largest_move = moves.fold(0.0, f64::max);
        self.set_poses(&submaps, &nodes);
        for (id, origin) in &data.fixed_frame_origins {
            if let Some(origin) = origin {
                let estimate = self.estimates.entry(id.0.cast_signed()).or_default();
                estimate.fixed_frame_origin = Some(*origin);
            }
        }
        for (id, sensors) in data.sensors.iter().filter(|_| S::OPTIMIZES_WITH_IMU) {
            self.estimates.entry(id.0.cast_signed()).or_default().imu = Some(sensors.imu_state);
        }
        for landmark in &mut self.graph.landmark_poses {
            let found = data.landmarks.get(&landmark.landmark_id).and_then(|l| l.map_from_landmark);
            if let Some(pose) = found {
                landmark.global_pose = Some(pose_to_proto(&pose));
            }
        }
        Ok(MapOptimization {
            initial_cost: summary.initial_cost,
            final_cost: summary.final_cost,
            iterations: summary.iterations,
            converged: summary.converged,
            submaps: submaps.len() as u64,
            nodes: nodes.len() as u64,
            constraints: constraints as u64,
            largest_move,
        })
    }
}

/// Trajectories connected by constraints.
fn connectivity(data: &OptimizationData, constraints: &[Constraint]) -> TrajectoryConnectivity {
    let mut connectivity = TrajectoryConnectivity::default();
    data.submaps.keys().for_each(|id| connectivity.add(id.trajectory_id));
    for c in constraints {
        connectivity.connect(c.submap_id.trajectory_id, c.node_id.trajectory_id, Time::MIN);
    }
    connectivity
}

// Ids of a draft have been checked: they are not negative.
pub(super) fn trajectory_in_memory(id: i32) -> TrajectoryId {
    TrajectoryId(id.unsigned_abs())
}

pub(super) fn submap_in_memory(id: IdInFile) -> SubmapId {
    SubmapId::new(trajectory_in_memory(id.0), id.1.unsigned_abs())
}

pub(super) fn node_in_memory(id: IdInFile) -> NodeId {
    NodeId::new(trajectory_in_memory(id.0), id.1.unsigned_abs())
}

pub(super) fn in_file(trajectory: TrajectoryId, index: u32) -> IdInFile {
    (trajectory.0.cast_signed(), index.cast_signed())
}
