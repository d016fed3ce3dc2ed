//! The optimisation problem in 3D (`slam3d.md` §9.1).

use std::collections::BTreeMap;

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::nalgebra as na;
use portolan_geometry::{Duration, Quaternion, Rigid3, Time, rotation_from_roll_pitch_yaw, yaw};
use portolan_motion::{integrate_imu, velocity_change};
use portolan_solver::{Loss, Problem, RotationFreedom, TranslationFreedom, VariableId, factors};

use super::data::{
    ImuState, LandmarkSighting, OptimizationData, OptimizationNode, OptimizationSummary, TrajectorySensors,
};
use super::degeneracy::only_degenerate_translations;
use super::graph_problem::{GraphProblem, ProblemSpace, Role, SightingBetweenNodes, Weights, follows};
use super::imu_bias::ImuBias;
use crate::{Constraint, NodeId, TrajectoryId, of_trajectory};

/// Standard deviation of the mounting of an IMU, radians. A trajectory with little rotation does not show
/// whether the IMU or the whole map is tilted, so that without this prior noise decides.
const MOUNTING_SIGMA: f64 = 0.02;

/// Standard deviation of the initial level of local SLAM without an IMU, radians: lidars are mounted level,
/// and streets slope by a few degrees. Fixes along a straight path do not constrain the roll about it, so
/// that without this prior noise decides.
const START_LEVEL_SIGMA: f64 = 0.09;
/// Common height error of many fixes, metres: reflections and the troposphere change slowly, so that more
/// fixes do not determine level better.
const COMMON_HEIGHT_ERROR: f64 = 2.0;

/// Optimises submaps, nodes, landmarks, fixed-frame origins, gravity and the calibration of IMUs for the best
/// agreement of all measurements. The first submap only aligns itself with gravity; frozen trajectories and
/// landmarks keep their poses.
///
/// Consecutive nodes are tied by the IMU where it measured the motion between them, elsewhere (and everywhere
/// with `fix_z_in_3d`) by local SLAM and odometry. Cartographer requires an IMU.
pub fn optimize_3d(
    data: &mut OptimizationData,
    constraints: &[Constraint],
    options: &OptimizationProblemOptions,
) -> OptimizationSummary {
    if data.nodes.is_empty() || data.submaps.is_empty() {
        return OptimizationSummary::default();
    }
    let mut problem = GraphProblem3d::new(data, options);
    problem.graph.add_constraints(constraints, data);
    problem.graph.add_given_starts(data);
    problem.graph.add_landmarks(data);
    problem.estimate_imu_biases(data);
    problem.add_consecutive_nodes(data);
    problem.graph.add_fixed_frames(data);
    problem.hold_level_at_start(data);
    let summary = problem.graph.solve(data);
    problem.write_back(data);
    summary
}

/// Gravity and calibration of the IMU of a trajectory.
#[derive(Clone, Copy)]
struct ImuVariables {
    gravity: VariableId,
    calibration: VariableId,
}

struct GraphProblem3d<'a> {
    graph: GraphProblem<'a, ProblemSpace3d>,
    options: &'a OptimizationProblemOptions,
    imus: BTreeMap<TrajectoryId, ImuVariables>,
    imu_biases: BTreeMap<TrajectoryId, ImuBias>,
}

impl<'a> GraphProblem3d<'a> {
    fn new(data: &OptimizationData, options: &'a OptimizationProblemOptions) -> Self {
        let graph = GraphProblem::new(data, options);
        Self { graph, options, imus: BTreeMap::new(), imu_biases: BTreeMap::new() }
    }

    /// Adds factors between consecutive nodes, from the IMU or else from odometry and local SLAM.
    fn add_consecutive_nodes(&mut self, data: &OptimizationData) {
        let nodes: Vec<(NodeId, &OptimizationNode)> = data.nodes.iter().map(|(id, n)| (*id, n)).collect();
        for (i, pair) in nodes.windows(2).enumerate() {
            let [first, second] = pair else { continue };
            if !follows(&first.0, &second.0) || data.frozen.contains(&first.0.trajectory_id) {
                continue;
            }
            if self.options.fix_z_in_3d || !self.add_imu_rotation(data, *first, *second) {
                self.graph.add_local_motion(data, *first, *second);
                continue;
            }
            self.add_open_motion(data, *first, *second);
            if let Some(third) = nodes.get(i + 2).filter(|third| follows(&second.0, &third.0)) {
                self.add_imu_acceleration(data, [*first, *second, *third]);
            }
        }
    }

    /// Ties a node to the one before in the degenerate directions of its scan, where its submap no longer
    /// does: an accelerometer alone drifts without bound.
    fn add_open_motion(
        &mut self,
        data: &OptimizationData,
        (id_a, a): (NodeId, &OptimizationNode),
        (id_b, b): (NodeId, &OptimizationNode),
    ) {
        let Some(of) = data.open.get(&id_b).filter(|_| self.graph.is_held(id_b.trajectory_id)) else {
            return;
        };
        let measured = a.local_from_node.inverse() * b.local_from_node;
        let root = only_degenerate_translations(of, &measured, b.time.seconds_since(a.time));
        let Some(variables) = self.graph.node_pair(id_a, id_b) else { return };
        ProblemSpace3d::add_open_between(&mut self.graph.problem, variables, &measured, &root, Loss::None);
    }

    /// Where fixes, but no IMU, determine the vertical: assumes the start to be about level.
    fn hold_level_at_start(&mut self, data: &OptimizationData) {
        let tilts = |id: &TrajectoryId, sensors: &TrajectorySensors| {
            !data.frozen.contains(id) && sensors.imu.is_empty() && !sensors.fixed_frame.is_empty()
        };
        for (&id, sensors) in
            data.sensors.iter().filter(|(id, s)| data.sensor_policy.holds_start_level && tilts(id, s))
        {
            let Some(frame) = self.graph.fixed_frame(id) else { continue };
            let Some((node_id, node)) = of_trajectory(&data.nodes, id).next() else { continue };
            let Some(variable) = self.graph.node(node_id) else { continue };
            let fixes = of_trajectory(&data.nodes, id).count().min(sensors.fixed_frame.len());
            // All fixes together count as one with this height error.
            let of_fixes = frame.weights.0 * (fixes as f64).sqrt();
            let weight = of_fixes * COMMON_HEIGHT_ERROR / START_LEVEL_SIGMA;
            // Local SLAM and the map may differ in heading.
            let heading = yaw(&node.map_from_node.rotation) - yaw(&node.local_from_node.rotation);
            let level = rotation_from_roll_pitch_yaw(0.0, 0.0, heading) * node.local_from_node.rotation;
            let map = self.graph.problem.add_se3(&Rigid3::identity());
            self.graph.problem.set_constant(map);
            let variables = [map, variable];
            let measured = Rigid3::from_parts(node.map_from_node.translation, level);
            let factor = ProblemSpace3d::between(variables, &measured, (0.0, weight));
            self.graph.add_factor(factor, Loss::None);
        }
    }

    /// Variables of the IMU of a trajectory.
    fn imu(&mut self, data: &OptimizationData, id: TrajectoryId) -> ImuVariables {
        let (problem, options) = (&mut self.graph.problem, self.options);
        if let Some(known) = self.imus.get(&id) {
            return *known;
        }
        let state = data.sensors.get(&id).map_or_else(ImuState::default, |s| s.imu_state);
        let freedom = match options.use_online_imu_extrinsics_in_3d {
            true => RotationFreedom::Free,
            false => RotationFreedom::Constant,
        };
        let variables = ImuVariables {
            gravity: problem.add_nonnegative(state.gravity_constant),
            calibration: problem.add_rotation(&state.calibration, freedom),
        };
        self.imus.insert(id, variables);
        if freedom == RotationFreedom::Free && data.sensor_policy.holds_imu_mounting {
            let (variable, rotation) = (variables.calibration, Quaternion::identity());
            let factor = factors::RotationPrior { variable, rotation, weight: 1.0 / MOUNTING_SIGMA };
            self.graph.add_factor(factor, Loss::None);
        }
        variables
    }

    fn estimate_imu_biases(&mut self, data: &OptimizationData) {
        let options = self.options;
        let wanted = data.sensor_policy.estimates_imu_biases && !options.fix_z_in_3d;
        let moving = data.sensors.keys().filter(|id| wanted && !data.frozen.contains(id));
        self.imu_biases = moving.map(|id| (*id, ImuBias::estimate(data, *id, options))).collect();
    }

    fn imu_agrees_after(&self, id: TrajectoryId, time: Time) -> bool {
        self.imu_biases.get(&id).is_none_or(|bias| bias.agrees_after(time))
    }

    /// False if the IMU did not measure the motion between the nodes, or measured it wrongly.
    fn add_imu_rotation(
        &mut self,
        data: &OptimizationData,
        (id_a, a): (NodeId, &OptimizationNode),
        (id_b, b): (NodeId, &OptimizationNode),
    ) -> bool {
        let Some(sensors) = data.sensors.get(&id_a.trajectory_id) else { return false };
        let duration = b.time.seconds_since(a.time);
        let Some(motion) = integrate_imu(&sensors.imu, a.time, b.time).filter(|_| duration > 0.0) else {
            return false;
        };
        if !self.imu_agrees_after(id_a.trajectory_id, a.time) {
            return false;
        }
        let middle = a.time + Duration::from_seconds(0.5 * duration);
        let motion = match self.imu_biases.get(&id_a.trajectory_id) {
            Some(bias) => bias.corrected(&motion, middle, duration),
            None => motion,
        };
        let Some([first, second]) = self.graph.node_pair(id_a, id_b) else { return false };
        let calibration = self.imu(data, id_a.trajectory_id).calibration;
        let factor = factors::ImuRotation {
            variables: [first, second, calibration],
            first_from_second: motion.delta_rotation,
            weight: self.options.rotation_weight / duration,
        };
        self.graph.add_factor(factor, Loss::None);
        true
    }

    fn add_imu_acceleration(&mut self, data: &OptimizationData, nodes: [(NodeId, &OptimizationNode); 3]) {
        let id = nodes[0].0.trajectory_id;
        let Some(imu_data) = data.sensors.get(&id).map(|s| &s.imu) else { return };
        let times = nodes.map(|(_, node)| node.time);
        let (first, second) = (times[1].seconds_since(times[0]), times[2].seconds_since(times[1]));
        let agrees = times[..2].iter().all(|time| self.imu_agrees_after(id, *time));
        if !(first > 0.0 && second > 0.0 && agrees) {
            return;
        }
        let Some(measured) = velocity_change(imu_data, times) else { return };
        let by_bias = self.imu_biases.get(&id).map_or_else(Default::default, ImuBias::accelerometer);
        let [a, b, c] = nodes.map(|(id, _)| self.graph.node(id));
        let (Some(a), Some(b), Some(c)) = (a, b, c) else { return };
        let ImuVariables { gravity, calibration } = self.imu(data, id);
        let factor = factors::ImuAcceleration {
            variables: [a, b, c, gravity, calibration],
            delta_velocity_in_second: measured - by_bias * (0.5 * (first + second)),
            first_duration: first,
            second_duration: second,
            weight: self.options.acceleration_weight / (first + second),
        };
        self.graph.add_factor(factor, Loss::None);
    }

    fn write_back(&self, data: &mut OptimizationData) {
        self.graph.write_back(data);
        for (id, imu) in &self.imus {
            let calibration: Quaternion = self.graph.problem.rotation(imu.calibration);
            let gravity_constant = self.graph.problem.scalar(imu.gravity);
            let state = ImuState { gravity_constant, calibration };
            if self.options.log_solver_summary {
                log_imu(*id, &state);
            }
            data.sensors_mut(*id).imu_state = state;
        }
    }
}

/// Logs the estimated state of an IMU (`slam3d.md` §9.1).
fn log_imu(id: TrajectoryId, state: &ImuState) {
    if id.0 != 0 {
        tracing::info!("Trajectory {id}:");
    }
    tracing::info!("Gravity was: {}", state.gravity_constant);
    let (degrees, q) = (state.calibration.angle().to_degrees(), state.calibration);
    tracing::info!("IMU correction was: {degrees} deg ({}, {}, {}, {})", q.w, q.i, q.j, q.k);
}

/// Poses in 3D.
struct ProblemSpace3d;

impl ProblemSpace for ProblemSpace3d {
    type Between = factors::Se3Between;
    type Landmark = factors::Landmark3d;

    fn add_pose(
        problem: &mut Problem,
        pose: &Rigid3,
        role: Role,
        options: &OptimizationProblemOptions,
    ) -> VariableId {
        let free = match options.fix_z_in_3d {
            true => TranslationFreedom::ConstantZ,
            false => TranslationFreedom::Free,
        };
        let (translation, rotation) = match role {
            Role::Frozen => (TranslationFreedom::Constant, RotationFreedom::Constant),
            Role::Anchor => (TranslationFreedom::Constant, RotationFreedom::ConstantYaw),
            Role::Free => (free, RotationFreedom::Free),
            Role::FixedFrame => (TranslationFreedom::Free, RotationFreedom::YawOnly),
        };
        if role != Role::FixedFrame {
            return problem.add_se3_with(pose, translation, rotation);
        }
        let level = rotation_from_roll_pitch_yaw(0.0, 0.0, yaw(&pose.rotation));
        problem.add_se3_with(&Rigid3::from_parts(pose.translation, level), translation, rotation)
    }

    fn pose(problem: &Problem, variable: VariableId) -> Rigid3 {
        problem.se3(variable)
    }

    fn between(variables: [VariableId; 2], measured: &Rigid3, weights: Weights) -> Self::Between {
        let (translation_weight, rotation_weight) = weights;
        factors::Se3Between { variables, measurement: *measured, translation_weight, rotation_weight }
    }

    fn add_open_between(
        problem: &mut Problem,
        variables: [VariableId; 2],
        measured: &Rigid3,
        root: &na::Matrix6<f64>,
        loss: Loss,
    ) -> bool {
        let factor = factors::Se3BetweenInformation {
            variables,
            measurement: *measured,
            square_root_information: *root,
            convention: factors::Se3ErrorConvention::DoubledQuaternion,
        };
        problem.add_factor(factor, loss).is_ok()
    }

    fn landmark(
        variables: [VariableId; 3],
        seen: &SightingBetweenNodes<'_>,
        sighting: &LandmarkSighting,
    ) -> Self::Landmark {
        factors::Landmark3d {
            variables,
            interpolation_factor: seen.factor,
            tracking_from_landmark: sighting.observation.tracking_from_landmark,
            translation_weight: sighting.observation.translation_weight,
            rotation_weight: sighting.observation.rotation_weight,
        }
    }

    fn map_from_tracking(node: &OptimizationNode) -> Rigid3 {
        node.map_from_node
    }

    fn between_nodes(_: &OptimizationNode, _: &OptimizationNode, a_from_b_tracking: &Rigid3) -> Rigid3 {
        *a_from_b_tracking
    }
}

#[cfg(test)]
mod tests;
