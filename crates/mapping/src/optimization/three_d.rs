//! The optimisation problem in space (`slam3d.md` §9.1).

use std::collections::BTreeMap;

use portolan_config::OptimizationProblemOptions;
use portolan_geometry::{Duration, Quaternion, Rigid3, Time, rotation_from_roll_pitch_yaw, yaw};
use portolan_solver::{Loss, Problem, RotationFreedom, TranslationFreedom, VariableId, factors};

use super::data::{ImuState, OptimizationData, OptimizationNode, OptimizationSummary};
use super::imu_bias::{ImuBias, velocity_change};
use super::interpolation::{fixed_frame_at, odometry_at};
use super::two_d::{SightingBetweenNodes, run_solver};
use crate::imu_integration::integrate_imu;
use crate::{Constraint, NodeId, SubmapId, TrajectoryId, of_trajectory};

/// Moves submaps, nodes, landmarks, fixed-frame origins, gravity and the calibration of IMUs to where
/// everything agrees best. The first submap only aligns itself with gravity; frozen trajectories and
/// landmarks stay where they are.
///
/// Neighbouring nodes are tied by the IMU where it measured what lies between them, elsewhere (and
/// everywhere with `fix_z_in_3d`) by local SLAM and odometry. The reference demands an IMU.
pub fn optimize_3d(
    data: &mut OptimizationData,
    constraints: &[Constraint],
    options: &OptimizationProblemOptions,
) -> OptimizationSummary {
    if data.nodes.is_empty() || data.submaps.is_empty() {
        return OptimizationSummary::default();
    }
    let mut problem = SpatialProblem::new(data, options);
    problem.add_constraints(constraints, options);
    problem.add_landmarks(data, options);
    problem.estimate_imu_biases(data, options);
    problem.add_consecutive_nodes(data, options);
    problem.add_fixed_frames(data, options);
    let summary = run_solver(&mut problem.problem, data, options);
    problem.write_back(data);
    summary
}

/// Gravity and calibration of the IMU of a trajectory.
#[derive(Clone, Copy)]
struct ImuVariables {
    gravity: VariableId,
    calibration: VariableId,
}

struct SpatialProblem {
    problem: Problem,
    submaps: BTreeMap<SubmapId, VariableId>,
    nodes: BTreeMap<NodeId, VariableId>,
    landmarks: BTreeMap<String, VariableId>,
    fixed_frames: BTreeMap<TrajectoryId, VariableId>,
    imus: BTreeMap<TrajectoryId, ImuVariables>,
    imu_biases: BTreeMap<TrajectoryId, ImuBias>,
}

impl SpatialProblem {
    fn new(data: &OptimizationData, options: &OptimizationProblemOptions) -> Self {
        let mut problem = Problem::new();
        problem.reserve_variables(data.submaps.len() + data.nodes.len(), 7);
        let free = match options.fix_z_in_3d {
            true => TranslationFreedom::ConstantZ,
            false => TranslationFreedom::Free,
        };
        let mut add = |pose: &Rigid3, is_frozen: bool, is_first: bool| {
            let (translation, rotation) = match (is_frozen, is_first) {
                (true, _) => (TranslationFreedom::Constant, RotationFreedom::Constant),
                (_, true) => (TranslationFreedom::Constant, RotationFreedom::ConstantYaw),
                _ => (free, RotationFreedom::Free),
            };
            problem.add_se3_with(pose, translation, rotation)
        };
        let first = data.submaps.keys().next().copied();
        let submaps = data.submaps.iter().map(|(id, pose)| {
            let anchored = Some(*id) == first || data.anchors.contains(id);
            (*id, add(pose, data.frozen.contains(&id.trajectory_id), anchored))
        });
        let submaps = submaps.collect();
        let nodes = data.nodes.iter().map(|(id, node)| {
            (*id, add(&node.map_from_node, data.frozen.contains(&id.trajectory_id), false))
        });
        let nodes = nodes.collect();
        Self {
            submaps,
            nodes,
            problem,
            landmarks: BTreeMap::new(),
            fixed_frames: BTreeMap::new(),
            imus: BTreeMap::new(),
            imu_biases: BTreeMap::new(),
        }
    }

    /// `measurement` is the pose of b in a. Errors of `add_factor` are impossible here: the variables are
    /// this problem's own and different.
    fn add_between(
        &mut self,
        a: VariableId,
        b: VariableId,
        measurement: Rigid3,
        (translation_weight, rotation_weight): (f64, f64),
        loss: Loss,
    ) {
        let variables = [a, b];
        let factor = factors::Se3Between { variables, measurement, translation_weight, rotation_weight };
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
            self.add_between(*submap, *node, constraint.submap_from_node, weights, loss);
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
                let observation = &sighting.observation;
                let mut factor = factors::Landmark3d {
                    // The third one is replaced below.
                    variables: [previous, next, next],
                    interpolation_factor: seen.factor,
                    tracking_from_landmark: observation.tracking_from_landmark,
                    translation_weight: observation.translation_weight,
                    rotation_weight: observation.rotation_weight,
                };
                let poses = (&seen.previous.1.map_from_node, &seen.next.1.map_from_node);
                let problem = &mut self.problem;
                factor.variables[2] = *self.landmarks.entry(name.clone()).or_insert_with(|| {
                    let pose = landmark.map_from_landmark.unwrap_or_else(|| {
                        factor.interpolated_tracking_pose(poses.0, poses.1)
                            * observation.tracking_from_landmark
                    });
                    let id = problem.add_se3(&pose);
                    if landmark.frozen {
                        problem.set_constant(id);
                    }
                    id
                });
                let added = problem.add_factor(factor, Loss::Huber(options.huber_scale));
                debug_assert!(added.is_ok());
            }
        }
    }

    /// What the IMU, or else odometry and local SLAM, say of neighbouring nodes.
    fn add_consecutive_nodes(&mut self, data: &OptimizationData, options: &OptimizationProblemOptions) {
        let nodes: Vec<(NodeId, &OptimizationNode)> = data.nodes.iter().map(|(id, n)| (*id, n)).collect();
        let follows = |a: &NodeId, b: &NodeId| a.trajectory_id == b.trajectory_id && b.index == a.index + 1;
        for (i, pair) in nodes.windows(2).enumerate() {
            let [first, second] = pair else { continue };
            if !follows(&first.0, &second.0) || data.frozen.contains(&first.0.trajectory_id) {
                continue;
            }
            if options.fix_z_in_3d || !self.add_imu_rotation(data, options, *first, *second) {
                self.add_local_motion(data, options, *first, *second);
                continue;
            }
            if let Some(third) = nodes.get(i + 2).filter(|third| follows(&second.0, &third.0)) {
                self.add_imu_acceleration(data, options, [*first, *second, *third]);
            }
        }
    }

    fn add_local_motion(
        &mut self,
        data: &OptimizationData,
        options: &OptimizationProblemOptions,
        (id_a, a): (NodeId, &OptimizationNode),
        (id_b, b): (NodeId, &OptimizationNode),
    ) {
        let variables = (self.nodes[&id_a], self.nodes[&id_b]);
        let odometry = data.sensors.get(&id_a.trajectory_id).map(|s| &s.odometry);
        let at = |node: &OptimizationNode| odometry_at(odometry?, node.time);
        if let (Some(odom_from_a), Some(odom_from_b)) = (at(a), at(b)) {
            let weights = (options.odometry_translation_weight, options.odometry_rotation_weight);
            let measured = odom_from_a.inverse() * odom_from_b;
            self.add_between(variables.0, variables.1, measured, weights, Loss::None);
        }
        let weights = (options.local_slam_pose_translation_weight, options.local_slam_pose_rotation_weight);
        let measured = a.local_from_node.inverse() * b.local_from_node;
        self.add_between(variables.0, variables.1, measured, weights, Loss::None);
    }

    /// Variables of the IMU of a trajectory.
    fn imu(
        &mut self,
        data: &OptimizationData,
        options: &OptimizationProblemOptions,
        id: TrajectoryId,
    ) -> ImuVariables {
        let problem = &mut self.problem;
        *self.imus.entry(id).or_insert_with(|| {
            let state = data.sensors.get(&id).map_or_else(ImuState::default, |s| s.imu_state);
            let freedom = match options.use_online_imu_extrinsics_in_3d {
                true => RotationFreedom::Free,
                false => RotationFreedom::Constant,
            };
            ImuVariables {
                gravity: problem.add_nonnegative(state.gravity_constant),
                calibration: problem.add_rotation(&state.calibration, freedom),
            }
        })
    }

    fn estimate_imu_biases(&mut self, data: &OptimizationData, options: &OptimizationProblemOptions) {
        let wanted = data.corrects_imu_biases && !options.fix_z_in_3d;
        let moving = data.sensors.keys().filter(|id| wanted && !data.frozen.contains(id));
        self.imu_biases = moving.map(|id| (*id, ImuBias::estimate(data, *id, options))).collect();
    }

    fn imu_agrees_after(&self, id: TrajectoryId, time: Time) -> bool {
        self.imu_biases.get(&id).is_none_or(|bias| bias.agrees_after(time))
    }

    /// False if the IMU did not measure what lies between the nodes, or not rightly.
    fn add_imu_rotation(
        &mut self,
        data: &OptimizationData,
        options: &OptimizationProblemOptions,
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
        let calibration = self.imu(data, options, id_a.trajectory_id).calibration;
        let factor = factors::ImuRotation {
            variables: [self.nodes[&id_a], self.nodes[&id_b], calibration],
            first_from_second: motion.delta_rotation,
            weight: options.rotation_weight / duration,
        };
        let added = self.problem.add_factor(factor, Loss::None);
        debug_assert!(added.is_ok());
        true
    }

    fn add_imu_acceleration(
        &mut self,
        data: &OptimizationData,
        options: &OptimizationProblemOptions,
        nodes: [(NodeId, &OptimizationNode); 3],
    ) {
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
        let ImuVariables { gravity, calibration } = self.imu(data, options, id);
        let [a, b, c] = nodes.map(|(id, _)| self.nodes[&id]);
        let factor = factors::ImuAcceleration {
            variables: [a, b, c, gravity, calibration],
            delta_velocity_in_second: measured - by_bias * (0.5 * (first + second)),
            first_duration: first,
            second_duration: second,
            weight: options.acceleration_weight / (first + second),
        };
        let added = self.problem.add_factor(factor, Loss::None);
        debug_assert!(added.is_ok());
    }

    /// Ties nodes to the fixed frame of their trajectory, which is level.
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
                let Some(measured) = fixed_frame_at(&sensors.fixed_frame, node.time) else { continue };
                let problem = &mut self.problem;
                let origin = *self.fixed_frames.entry(*trajectory_id).or_insert_with(|| {
                    let known = data.fixed_frame_origins.get(trajectory_id).copied().flatten();
                    let origin = known.unwrap_or_else(|| node.map_from_node * measured.inverse());
                    let level = rotation_from_roll_pitch_yaw(0.0, 0.0, yaw(&origin.rotation));
                    let origin = Rigid3::from_parts(origin.translation, level);
                    problem.add_se3_with(&origin, TranslationFreedom::Free, RotationFreedom::YawOnly)
                });
                self.add_between(origin, self.nodes[&node_id], measured, weights, loss);
            }
        }
    }

    fn write_back(&self, data: &mut OptimizationData) {
        // Normalisation would change the last bit of what is frozen.
        let moves = |data: &OptimizationData, id: TrajectoryId| !data.frozen.contains(&id);
        for (id, variable) in &self.submaps {
            if moves(data, id.trajectory_id) {
                data.submaps.insert(*id, self.problem.se3(*variable));
            }
        }
        for (id, variable) in &self.nodes {
            if !moves(data, id.trajectory_id) {
                continue;
            }
            if let Some(node) = data.nodes.get_mut(id) {
                node.map_from_node = self.problem.se3(*variable);
            }
        }
        for (name, variable) in &self.landmarks {
            if let Some(landmark) = data.landmarks.get_mut(name) {
                landmark.map_from_landmark = Some(self.problem.se3(*variable));
            }
        }
        for (id, variable) in &self.fixed_frames {
            data.fixed_frame_origins.insert(*id, Some(self.problem.se3(*variable)));
        }
        for (id, imu) in &self.imus {
            let calibration: Quaternion = self.problem.rotation(imu.calibration);
            let gravity_constant = self.problem.scalar(imu.gravity);
            data.sensors_mut(*id).imu_state = ImuState { gravity_constant, calibration };
        }
    }
}

#[cfg(test)]
mod tests;
