//! The optimisation problem in the plane (`slam2d.md` §14.6).

use std::collections::BTreeMap;

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::{Rigid2, Rigid3, embed_3d, interpolate, project_2d};
use portolan_solver::{Loss, Problem, SolverOptions, VariableId, factors};

use super::data::{LandmarkSighting, OptimizationData, OptimizationNode, OptimizationSummary};
use super::interpolation::{fixed_frame_at, odometry_at};
use crate::{Constraint, NodeId, SubmapId, TrajectoryId, of_trajectory};

/// Moves submaps, nodes, landmarks and fixed-frame origins to where everything agrees best. The first
/// submap, frozen trajectories and frozen landmarks stay where they are.
pub fn optimize_2d(
    data: &mut OptimizationData,
    constraints: &[Constraint],
    options: &OptimizationProblemOptions,
) -> OptimizationSummary {
    if data.nodes.is_empty() || data.submaps.is_empty() {
        return OptimizationSummary::default();
    }
    let mut problem = PlanarProblem::new(data);
    problem.add_constraints(constraints, options);
    problem.add_landmarks(data, options);
    problem.add_consecutive_nodes(data, options);
    problem.add_fixed_frames(data, options);
    let summary = run_solver(&mut problem.problem, data, options);
    problem.write_back(data);
    summary
}

struct PlanarProblem {
    problem: Problem,
    submaps: BTreeMap<SubmapId, VariableId>,
    nodes: BTreeMap<NodeId, VariableId>,
    landmarks: BTreeMap<String, VariableId>,
    fixed_frames: BTreeMap<TrajectoryId, VariableId>,
}

impl PlanarProblem {
    fn new(data: &OptimizationData) -> Self {
        let mut problem = Problem::new();
        problem.reserve_variables(data.submaps.len() + data.nodes.len(), 3);
        let mut add = |pose: &Rigid3, constant: bool| {
            let id = problem.add_se2(&project_2d(pose));
            if constant {
                problem.set_constant(id);
            }
            id
        };
        let first_submap = data.submaps.keys().next().copied();
        let submaps = data
            .submaps
            .iter()
            .map(|(id, pose)| {
                let anchored = Some(*id) == first_submap || data.anchors.contains(id);
                let constant = anchored || data.frozen.contains(&id.trajectory_id);
                (*id, add(pose, constant))
            })
            .collect();
        let nodes = data
            .nodes
            .iter()
            .map(|(id, node)| (*id, add(&node.map_from_node, data.frozen.contains(&id.trajectory_id))))
            .collect();
        Self { problem, submaps, nodes, landmarks: BTreeMap::new(), fixed_frames: BTreeMap::new() }
    }

    /// `measured` is the pose of b in a. Errors of `add_factor` are impossible here: the variables are
    /// this problem's own and different.
    fn add_between(
        &mut self,
        a: VariableId,
        b: VariableId,
        measured: Rigid2,
        weights: (f64, f64),
        loss: Loss,
    ) {
        let factor = factors::Se2Between {
            variables: [a, b],
            measurement: measured,
            translation_weight: weights.0,
            rotation_weight: weights.1,
        };
        let added = self.problem.add_factor(factor, loss);
        debug_assert!(added.is_ok());
    }

    fn add_constraints(&mut self, constraints: &[Constraint], options: &OptimizationProblemOptions) {
        for constraint in constraints {
            let (Some(submap), Some(node)) =
                (self.submaps.get(&constraint.submap_id), self.nodes.get(&constraint.node_id))
            else {
                continue;
            };
            let loss =
                if constraint.is_loop_closure() { Loss::Huber(options.huber_scale) } else { Loss::None };
            let weights = (constraint.translation_weight, constraint.rotation_weight);
            self.add_between(*submap, *node, project_2d(&constraint.submap_from_node), weights, loss);
        }
    }

    /// Every landmark is seen from a pose between two nodes.
    fn add_landmarks(&mut self, data: &OptimizationData, options: &OptimizationProblemOptions) {
        for (name, landmark) in &data.landmarks {
            for sighting in &landmark.sightings {
                let Some(seen) = SightingBetweenNodes::find(sighting, data) else { continue };
                let (Some(previous), Some(next)) =
                    (self.nodes.get(&seen.previous.0).copied(), self.nodes.get(&seen.next.0).copied())
                else {
                    continue;
                };
                let variable = *self.landmarks.entry(name.clone()).or_insert_with(|| {
                    let pose = landmark.map_from_landmark.unwrap_or_else(|| {
                        seen.map_from_tracking(sighting) * sighting.observation.tracking_from_landmark
                    });
                    let id = self.problem.add_se3(&pose);
                    if landmark.frozen {
                        self.problem.set_constant(id);
                    }
                    id
                });
                let factor = factors::Landmark2d {
                    variables: [previous, next, variable],
                    interpolation_factor: seen.factor,
                    gravity_alignments: [seen.previous.1.gravity_alignment, seen.next.1.gravity_alignment],
                    tracking_from_landmark: sighting.observation.tracking_from_landmark,
                    translation_weight: sighting.observation.translation_weight,
                    rotation_weight: sighting.observation.rotation_weight,
                };
                let added = self.problem.add_factor(factor, Loss::Huber(options.huber_scale));
                debug_assert!(added.is_ok());
            }
        }
    }

    /// What odometry and local SLAM say of neighbouring nodes.
    fn add_consecutive_nodes(&mut self, data: &OptimizationData, options: &OptimizationProblemOptions) {
        let local_weights =
            (options.local_slam_pose_translation_weight, options.local_slam_pose_rotation_weight);
        let odometry_weights = (options.odometry_translation_weight, options.odometry_rotation_weight);
        for ((id_a, a), (id_b, b)) in data.nodes.iter().zip(data.nodes.iter().skip(1)) {
            let follow = id_a.trajectory_id == id_b.trajectory_id && id_b.index == id_a.index + 1;
            if !follow || data.frozen.contains(&id_a.trajectory_id) {
                continue;
            }
            let (variable_a, variable_b) = (self.nodes[id_a], self.nodes[id_b]);
            if let Some(measured) = odometry_between(data, *id_a, a, b) {
                self.add_between(variable_a, variable_b, measured, odometry_weights, Loss::None);
            }
            let measured = project_2d(&(a.local_from_node.inverse() * b.local_from_node));
            self.add_between(variable_a, variable_b, measured, local_weights, Loss::None);
        }
    }

    /// Ties nodes to the fixed frame of their trajectory.
    fn add_fixed_frames(&mut self, data: &OptimizationData, options: &OptimizationProblemOptions) {
        let weights = (options.fixed_frame_pose_translation_weight, options.fixed_frame_pose_rotation_weight);
        let loss = if options.fixed_frame_pose_use_tolerant_loss {
            Loss::Tolerant(
                options.fixed_frame_pose_tolerant_loss_param_a,
                options.fixed_frame_pose_tolerant_loss_param_b,
            )
        } else {
            Loss::None
        };
        for (trajectory_id, sensors) in &data.sensors {
            for (node_id, node) in of_trajectory(&data.nodes, *trajectory_id) {
                let Some(fixed_from_tracking) = fixed_frame_at(&sensors.fixed_frame, node.time) else {
                    continue;
                };
                let measured = project_2d(&fixed_from_tracking);
                let origin = *self.fixed_frames.entry(*trajectory_id).or_insert_with(|| {
                    let known = data.fixed_frame_origins.get(trajectory_id).copied().flatten();
                    let origin = known.map_or_else(
                        || project_2d(&node.map_from_node) * measured.inverse(),
                        |pose| project_2d(&pose),
                    );
                    self.problem.add_se2(&origin)
                });
                let variable = self.nodes[&node_id];
                self.add_between(origin, variable, measured, weights, loss);
            }
        }
    }

    fn write_back(&self, data: &mut OptimizationData) {
        for (id, variable) in &self.submaps {
            data.submaps.insert(*id, embed_3d(&self.problem.se2(*variable)));
        }
        for (id, variable) in &self.nodes {
            if let Some(node) = data.nodes.get_mut(id) {
                node.map_from_node = embed_3d(&self.problem.se2(*variable));
            }
        }
        for (name, variable) in &self.landmarks {
            if let Some(landmark) = data.landmarks.get_mut(name) {
                landmark.map_from_landmark = Some(self.problem.se3(*variable));
            }
        }
        for (id, variable) in &self.fixed_frames {
            data.fixed_frame_origins.insert(*id, Some(embed_3d(&self.problem.se2(*variable))));
        }
    }
}

/// Solves a problem as the options say.
pub(super) fn run_solver(
    problem: &mut Problem,
    data: &OptimizationData,
    options: &OptimizationProblemOptions,
) -> OptimizationSummary {
    let solver = &options.ceres_solver_options;
    let iterations = u32::try_from(solver.max_num_iterations).unwrap_or(u32::MAX);
    let settings = SolverOptions {
        max_num_iterations: data.max_iterations_override.unwrap_or(iterations),
        use_nonmonotonic_steps: solver.use_nonmonotonic_steps,
        ..SolverOptions::default()
    };
    match problem.solve(&settings) {
        Ok(summary) => {
            if options.log_solver_summary {
                tracing::info!("{summary:?}");
            }
            OptimizationSummary {
                initial_cost: summary.initial_cost,
                final_cost: summary.final_cost,
                iterations: summary.iterations,
                converged: summary.termination.is_convergence(),
            }
        }
        Err(error) => {
            tracing::warn!("the pose graph was not optimised: {error}");
            OptimizationSummary::default()
        }
    }
}

/// Odometry from node a to node b in their gravity-aligned frames, if it covers both.
fn odometry_between(
    data: &OptimizationData,
    id: NodeId,
    a: &OptimizationNode,
    b: &OptimizationNode,
) -> Option<Rigid2> {
    let odometry = &data.sensors.get(&id.trajectory_id)?.odometry;
    let odom_from_a = odometry_at(odometry, a.time)?;
    let odom_from_b = odometry_at(odometry, b.time)?;
    let a_from_b = odom_from_a.inverse() * odom_from_b;
    Some(project_2d(&(a.gravity_alignment * a_from_b * b.gravity_alignment.inverse())))
}

/// The nodes around a landmark observation.
pub(super) struct SightingBetweenNodes<'a> {
    pub previous: (NodeId, &'a OptimizationNode),
    pub next: (NodeId, &'a OptimizationNode),
    /// Time of the observation as a fraction of the way from the previous to the next.
    pub factor: f64,
}

impl<'a> SightingBetweenNodes<'a> {
    /// None before the first node of the trajectory or after its last.
    pub fn find(sighting: &LandmarkSighting, data: &'a OptimizationData) -> Option<Self> {
        let mut nodes = of_trajectory(&data.nodes, sighting.trajectory_id);
        let mut previous = nodes.next()?;
        if sighting.time < previous.1.time {
            return None;
        }
        // Node times rise with their indices; a landmark on the first node uses the first two.
        let next = nodes.find(|(id, node)| {
            let found = node.time >= sighting.time;
            if !found {
                previous = (*id, node);
            }
            found
        })?;
        let span = next.1.time.seconds_since(previous.1.time);
        let factor = if span > 0.0 { sighting.time.seconds_since(previous.1.time) / span } else { 0.0 };
        Some(Self { previous, next, factor })
    }

    fn map_from_tracking(&self, sighting: &LandmarkSighting) -> Rigid3 {
        let pose = |node: &OptimizationNode| node.map_from_node * node.gravity_alignment;
        interpolate(
            self.previous.1.time,
            &pose(self.previous.1),
            self.next.1.time,
            &pose(self.next.1),
            sighting.time,
        )
    }
}
