//! Common parts of the optimisation problems in 2D and 3D.

use std::collections::{BTreeMap, BTreeSet};
use std::marker::PhantomData;

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::nalgebra as na;
use portolan_geometry::{Rigid3, Time, interpolate};
use portolan_motion::odometry_at;
use portolan_solver::{Factor, Loss, Problem, SolverOptions, VariableId};

use super::data::{LandmarkSighting, OptimizationData, OptimizationNode, OptimizationSummary};
use super::degeneracy::weakened;
use super::fixes::{self, FixedFrame};
use crate::{Constraint, NodeId, SubmapId, TrajectoryId, of_trajectory};

/// Degrees of freedom of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Stays.
    Frozen,
    /// Holds its connected part of the map.
    Anchor,
    /// Moves.
    Free,
    /// The origin of a fixed frame: moves, and is level.
    FixedFrame,
}

/// Interface to the differences between 2D and 3D. Poses are in 3D here; in 2D only their projection counts.
pub(super) trait ProblemSpace {
    type Between: Factor;
    type Landmark: Factor;

    fn add_pose(
        problem: &mut Problem,
        pose: &Rigid3,
        role: Role,
        options: &OptimizationProblemOptions,
    ) -> VariableId;

    fn pose(problem: &Problem, variable: VariableId) -> Rigid3;

    /// `measured` is the pose of the second variable in the first.
    fn between(variables: [VariableId; 2], measured: &Rigid3, weights: Weights) -> Self::Between;

    /// Adds a relative pose with a square root of its information, by translation and rotation in the second
    /// frame; false where that is not supported.
    fn add_open_between(
        _: &mut Problem,
        _: [VariableId; 2],
        _: &Rigid3,
        _: &na::Matrix6<f64>,
        _: Loss,
    ) -> bool {
        false
    }

    /// `variables` are the nodes before and after the sighting and the landmark.
    fn landmark(
        variables: [VariableId; 3],
        seen: &SightingBetweenNodes<'_>,
        sighting: &LandmarkSighting,
    ) -> Self::Landmark;

    /// Pose of the tracking frame of a node in the map.
    fn map_from_tracking(node: &OptimizationNode) -> Rigid3;

    /// A motion of the tracking frame as one of the frames that constraints use.
    fn between_nodes(a: &OptimizationNode, b: &OptimizationNode, a_from_b_tracking: &Rigid3) -> Rigid3;
}

/// Weights of a start given by the user, 1/m and 1/rad: it is right to some metres and some ten degrees, and
/// constrains the position where loop closures have a degenerate direction. Any loop closure weighs a
/// thousand times as much.
const GIVEN_START: Weights = (75.0, 1e3);

/// Weights of translation and rotation.
pub(super) type Weights = (f64, f64);

/// Poses of a map as variables of a problem.
pub(super) struct GraphProblem<'a, S> {
    pub problem: Problem,
    nodes: BTreeMap<NodeId, VariableId>,
    submaps: BTreeMap<SubmapId, VariableId>,
    landmarks: BTreeMap<String, VariableId>,
    /// Accepted fixed frames and their variables.
    fixed_frames: BTreeMap<TrajectoryId, FixedFrame>,
    origins: BTreeMap<TrajectoryId, VariableId>,
    /// Trajectories with constraints other than those of local SLAM.
    held: BTreeSet<TrajectoryId>,
    options: &'a OptimizationProblemOptions,
    space: PhantomData<S>,
}

impl<'a, S: ProblemSpace> GraphProblem<'a, S> {
    /// A variable for every submap and node.
    pub fn new(data: &OptimizationData, options: &'a OptimizationProblemOptions) -> Self {
        let mut problem = Problem::new();
        problem.reserve_variables(data.submaps.len() + data.nodes.len(), 7);
        let frozen_or = |id: TrajectoryId, role| if data.frozen.contains(&id) { Role::Frozen } else { role };
        let first = data.submaps.keys().next().copied();
        let mut submaps = BTreeMap::new();
        for (id, pose) in &data.submaps {
            let is_anchor = Some(*id) == first || data.anchors.contains(id);
            let role = frozen_or(id.trajectory_id, if is_anchor { Role::Anchor } else { Role::Free });
            submaps.insert(*id, S::add_pose(&mut problem, pose, role, options));
        }
        let mut nodes = BTreeMap::new();
        for (id, node) in &data.nodes {
            let role = frozen_or(id.trajectory_id, Role::Free);
            nodes.insert(*id, S::add_pose(&mut problem, &node.map_from_node, role, options));
        }
        let fixed_frame = |id: &TrajectoryId| Some((*id, FixedFrame::of(data, *id, options)?));
        let fixed_frames: BTreeMap<_, _> = data.sensors.keys().filter_map(fixed_frame).collect();
        let sightings = data.landmarks.values().flat_map(|landmark| &landmark.sightings);
        let seen = sightings.map(|sighting| sighting.trajectory_id);
        let held = fixed_frames.keys().copied().chain(seen).collect();
        let (landmarks, origins) = (BTreeMap::new(), BTreeMap::new());
        Self { problem, nodes, submaps, landmarks, fixed_frames, origins, held, options, space: PhantomData }
    }

    /// Whether anything but local SLAM constrains the nodes of a trajectory: satellites, landmarks, or other
    /// parts of the map. Otherwise there is no reason to move along degenerate directions of scans: an
    /// accelerometer alone drifts without bound.
    pub fn is_held(&self, id: TrajectoryId) -> bool {
        self.held.contains(&id)
    }

    /// The variable of a node. Every node of the data has one. A request for another node is logged, and the
    /// caller leaves it out.
    pub fn node(&self, id: NodeId) -> Option<VariableId> {
        let variable = self.nodes.get(&id).copied();
        if variable.is_none() {
            tracing::error!("Node {id} is not part of the optimisation; a measurement of it is left out.");
        }
        variable
    }

    /// The variables of two nodes, as [`Self::node`] finds them.
    pub fn node_pair(&self, a: NodeId, b: NodeId) -> Option<[VariableId; 2]> {
        Some([self.node(a)?, self.node(b)?])
    }

    /// Errors are impossible: the variables are this problem's own and different.
    pub fn add_factor(&mut self, factor: impl Factor, loss: Loss) {
        let added = self.problem.add_factor(factor, loss);
        debug_assert!(added.is_ok());
    }

    fn add_between(&mut self, variables: [VariableId; 2], measured: &Rigid3, weights: Weights, loss: Loss) {
        self.add_factor(S::between(variables, measured, weights), loss);
    }

    pub fn add_constraints(&mut self, constraints: &[Constraint], data: &OptimizationData) {
        let by_loops = constraints.iter().filter(|c| c.is_loop_closure()).map(|c| c.node_id.trajectory_id);
        self.held.extend(by_loops);
        // Time of the first node of each submap: degenerate directions of scans drift from then on.
        let mut begun: BTreeMap<SubmapId, Time> = BTreeMap::new();
        if !data.open.is_empty() {
            for constraint in constraints.iter().filter(|c| !c.is_loop_closure()) {
                let Some(node) = data.nodes.get(&constraint.node_id) else { continue };
                begun.entry(constraint.submap_id).and_modify(|t| *t = node.time.min(*t)).or_insert(node.time);
            }
        }
        for constraint in constraints {
            let (Some(submap), Some(node)) =
                (self.submaps.get(&constraint.submap_id), self.nodes.get(&constraint.node_id))
            else {
                continue;
            };
            let is_loop = constraint.is_loop_closure();
            let loss = if is_loop { Loss::Huber(self.options.huber_scale) } else { Loss::None };
            let weights = (constraint.translation_weight, constraint.rotation_weight);
            let seconds = || -> Option<f64> {
                let time = data.nodes.get(&constraint.node_id)?.time;
                Some(time.seconds_since(*begun.get(&constraint.submap_id)?))
            };
            if !is_loop
                && self.is_held(constraint.node_id.trajectory_id)
                && let Some((of, seconds)) = data.open.get(&constraint.node_id).zip(seconds())
            {
                let root = weakened(of, weights, &constraint.submap_from_node, seconds);
                let variables = [*submap, *node];
                if S::add_open_between(
                    &mut self.problem,
                    variables,
                    &constraint.submap_from_node,
                    &root,
                    loss,
                ) {
                    continue;
                }
            }
            let variables = [*submap, *node];
            if let Some(open) = constraint.open
                && S::add_open_between(
                    &mut self.problem,
                    variables,
                    &constraint.submap_from_node,
                    &open.square_root_information(weights),
                    loss,
                )
            {
                continue;
            }
            self.add_between(variables, &constraint.submap_from_node, weights, loss);
        }
    }

    /// Adds the starts given by the user as weak constraints on the first nodes of trajectories.
    pub fn add_given_starts(&mut self, data: &OptimizationData) {
        for (id, pose) in &data.given_starts {
            let is_frozen = data.frozen.contains(&id.trajectory_id);
            let Some(node) = self.nodes.get(id).copied().filter(|_| !is_frozen) else { continue };
            let given = S::add_pose(&mut self.problem, pose, Role::Frozen, self.options);
            self.add_between([given, node], &Rigid3::identity(), GIVEN_START, Loss::None);
        }
    }

    /// Adds landmarks; each is seen from a pose between two nodes.
    pub fn add_landmarks(&mut self, data: &OptimizationData) {
        for (name, landmark) in &data.landmarks {
            let moving = |s: &&LandmarkSighting| !data.frozen.contains(&s.trajectory_id);
            for sighting in landmark.sightings.iter().filter(moving) {
                let Some(seen) = SightingBetweenNodes::find(sighting, data) else { continue };
                let (Some(previous), Some(next)) =
                    (self.nodes.get(&seen.previous.0).copied(), self.nodes.get(&seen.next.0).copied())
                else {
                    continue;
                };
                let variable = *self.landmarks.entry(name.clone()).or_insert_with(|| {
                    let pose = landmark.map_from_landmark.unwrap_or_else(|| {
                        seen.map_from_tracking::<S>(sighting) * sighting.observation.tracking_from_landmark
                    });
                    let id = self.problem.add_se3(&pose);
                    if landmark.frozen {
                        self.problem.set_constant(id);
                    }
                    id
                });
                let factor = S::landmark([previous, next, variable], &seen, sighting);
                self.add_factor(factor, Loss::Huber(self.options.huber_scale));
            }
        }
    }

    /// Adds the motion between two consecutive nodes by odometry and local SLAM.
    pub fn add_local_motion(
        &mut self,
        data: &OptimizationData,
        (id_a, a): (NodeId, &OptimizationNode),
        (id_b, b): (NodeId, &OptimizationNode),
    ) {
        let Some(variables) = self.node_pair(id_a, id_b) else { return };
        let o = self.options;
        let odometry = data.sensors.get(&id_a.trajectory_id).map(|sensors| &sensors.odometry);
        let at = |node: &OptimizationNode| odometry_at(odometry?, node.time);
        if let (Some(odom_from_a), Some(odom_from_b)) = (at(a), at(b)) {
            let measured = S::between_nodes(a, b, &(odom_from_a.inverse() * odom_from_b));
            let weights = (o.odometry_translation_weight, o.odometry_rotation_weight);
            self.add_between(variables, &measured, weights, Loss::None);
        }
        let measured = a.local_from_node.inverse() * b.local_from_node;
        let weights = (o.local_slam_pose_translation_weight, o.local_slam_pose_rotation_weight);
        if self.is_held(id_b.trajectory_id)
            && let Some(of) = data.open.get(&id_b)
        {
            let root = weakened(of, weights, &measured, b.time.seconds_since(a.time));
            if S::add_open_between(&mut self.problem, variables, &measured, &root, Loss::None) {
                return;
            }
        }
        self.add_between(variables, &measured, weights, Loss::None);
    }

    /// Ties nodes to the fixed frame of their trajectory.
    pub fn add_fixed_frames(&mut self, data: &OptimizationData) {
        let loss = fixes::loss(data, self.options);
        for (id, FixedFrame { map_from_fixed, weights, measured }) in self.fixed_frames.clone() {
            if data.frozen.contains(&id) {
                continue;
            }
            let origin = S::add_pose(&mut self.problem, &map_from_fixed, Role::FixedFrame, self.options);
            self.origins.insert(id, origin);
            for (node_id, in_fixed) in &measured {
                let Some(variable) = self.node(*node_id) else { continue };
                self.add_between([origin, variable], in_fixed, weights, loss);
            }
        }
    }

    /// The fixed frame of a trajectory, if it is accepted.
    pub fn fixed_frame(&self, id: TrajectoryId) -> Option<&FixedFrame> {
        self.fixed_frames.get(&id)
    }

    /// Writes the result back to the data.
    pub fn write_back(&self, data: &mut OptimizationData) {
        // Converting poses to variables and back would change the last bit of frozen ones.
        for (id, variable) in &self.submaps {
            if !data.frozen.contains(&id.trajectory_id) {
                data.submaps.insert(*id, S::pose(&self.problem, *variable));
            }
        }
        for (id, variable) in &self.nodes {
            let is_frozen = data.frozen.contains(&id.trajectory_id);
            if let Some(node) = data.nodes.get_mut(id).filter(|_| !is_frozen) {
                node.map_from_node = S::pose(&self.problem, *variable);
            }
        }
        for (name, variable) in &self.landmarks {
            if let Some(landmark) = data.landmarks.get_mut(name) {
                landmark.map_from_landmark = Some(self.problem.se3(*variable));
            }
        }
        // If fixes are rejected now, the earlier origin of their frame is no longer valid.
        let is_used = |id: &TrajectoryId| {
            self.fixed_frames.contains_key(id)
                || !data.sensor_policy.weighs_fixes_by_scatter
                || data.frozen.contains(id)
        };
        let unused: Vec<TrajectoryId> = data.sensors.keys().filter(|id| !is_used(id)).copied().collect();
        for id in unused {
            data.fixed_frame_origins.remove(&id);
        }
        for (id, variable) in &self.origins {
            data.fixed_frame_origins.insert(*id, Some(S::pose(&self.problem, *variable)));
        }
    }

    /// Solves the problem as the options say.
    pub fn solve(&mut self, data: &OptimizationData) -> OptimizationSummary {
        let solver = &self.options.ceres_solver_options;
        let iterations = u32::try_from(solver.max_num_iterations).unwrap_or(u32::MAX);
        let settings = SolverOptions {
            max_num_iterations: data.max_iterations_override.unwrap_or(iterations),
            use_nonmonotonic_steps: solver.use_nonmonotonic_steps,
            ..SolverOptions::default()
        };
        match self.problem.solve(&settings) {
            Ok(summary) => {
                if self.options.log_solver_summary {
                    tracing::info!("{summary:?}");
                }
                OptimizationSummary {
                    initial_cost: summary.initial_cost,
                    final_cost: summary.final_cost,
                    iterations: summary.iterations,
                    converged: summary.termination.is_convergence(),
                    failed: false,
                }
            }
            Err(error) => {
                tracing::warn!("the pose graph was not optimised: {error}");
                OptimizationSummary { failed: true, ..OptimizationSummary::default() }
            }
        }
    }
}

/// Whether the second node comes right after the first.
pub(super) fn follows(first: &NodeId, second: &NodeId) -> bool {
    first.trajectory_id == second.trajectory_id && second.index == first.index + 1
}

/// The nodes around a landmark observation.
pub(super) struct SightingBetweenNodes<'a> {
    pub previous: (NodeId, &'a OptimizationNode),
    pub next: (NodeId, &'a OptimizationNode),
    /// Time of the observation as a fraction of the interval from the previous to the next.
    pub factor: f64,
}

impl<'a> SightingBetweenNodes<'a> {
    /// None before the first node of the trajectory, after its last, and where nodes between were removed.
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
        if !follows(&previous.0, &next.0) {
            return None;
        }
        let span = next.1.time.seconds_since(previous.1.time);
        let factor = if span > 0.0 { sighting.time.seconds_since(previous.1.time) / span } else { 0.0 };
        Some(Self { previous, next, factor })
    }

    fn map_from_tracking<S: ProblemSpace>(&self, sighting: &LandmarkSighting) -> Rigid3 {
        let (previous, next) = (self.previous.1, self.next.1);
        let poses = (S::map_from_tracking(previous), S::map_from_tracking(next));
        interpolate(previous.time, &poses.0, next.time, &poses.1, sighting.time)
    }
}
