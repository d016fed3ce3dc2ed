//! The optimisation problem, in 2D and in 3D, fed directly.
//!
//! Seven nodes in a row. Their measurements contradict each other: submaps say 0.5 m from node to node, local
//! SLAM 0.4 m and a little turn, odometry 0.6 m, the fixed frame 0.7 m; a loop closure says that the last one
//! is elsewhere. Who weighs more wins.

use portolan::config::{OptimizationProblemOptions, Options};
use portolan::geometry::{Quaternion, Rigid3, Vector3, rotation_angle, rotation_from_roll_pitch_yaw, yaw};
use portolan::mapping::{Constraint, ConstraintTag, NodeId, OpenShift, SubmapId, TrajectoryId};
use portolan::optimization::{
    OptimizationData, OptimizationNode, OptimizationSummary, optimize_2d, optimize_3d,
};
use portolan::sensor::{FixedFramePoseData, ImuData, OdometryData};

use crate::effect::{Effect, check, effects};
use crate::world::{GRAVITY, at, pose};

const TRAJECTORY: TrajectoryId = TrajectoryId(0);
const NODES: u32 = 7;

type Optimize = fn(&mut OptimizationData, &[Constraint], &OptimizationProblemOptions) -> OptimizationSummary;

fn node(index: u32) -> NodeId {
    NodeId::new(TRAJECTORY, index)
}

fn step(metres: f64, turn: f64, index: u32) -> Rigid3 {
    pose(metres * f64::from(index), 0.0, turn * f64::from(index))
}

/// Nodes, two submaps, and what ties them.
fn row() -> (OptimizationData, Vec<Constraint>) {
    let mut data = OptimizationData::default();
    let mut constraints = Vec::new();
    let mut relate = |submap: u32, index: u32, submap_from_node: Rigid3, tag| {
        constraints.push(Constraint {
            submap_id: SubmapId::new(TRAJECTORY, submap),
            node_id: node(index),
            submap_from_node,
            translation_weight: 10.0,
            rotation_weight: 10.0,
            tag,
            open: None,
            score: None,
        });
    };
    for index in 0..NODES {
        data.nodes.insert(
            node(index),
            OptimizationNode {
                time: at(f64::from(index)),
                local_from_node: step(0.4, 0.02, index),
                map_from_node: step(0.5, 0.0, index),
                gravity_alignment: Quaternion::identity(),
            },
        );
        let submap = u32::from(index > 3);
        relate(submap, index, step(0.5, 0.0, index - 4 * submap), ConstraintTag::IntraSubmap);
    }
    // Ties the submaps together.
    relate(1, 3, step(-0.5, 0.0, 1), ConstraintTag::IntraSubmap);
    let elsewhere = Rigid3::translation(2.0, 0.4, 0.3);
    relate(0, NODES - 1, elsewhere, ConstraintTag::InterSubmap);
    data.submaps.insert(SubmapId::new(TRAJECTORY, 0), Rigid3::identity());
    data.submaps.insert(SubmapId::new(TRAJECTORY, 1), step(0.5, 0.0, 4));
    (data, constraints)
}

fn with_odometry(mut data: OptimizationData) -> OptimizationData {
    for index in 0..NODES {
        let (time, odom_from_tracking) = (at(f64::from(index)), step(0.6, 0.05, index));
        data.sensors_mut(TRAJECTORY).odometry.insert(time, OdometryData { time, odom_from_tracking });
    }
    data
}

fn with_fixed_frame(mut data: OptimizationData) -> OptimizationData {
    for index in 0..NODES {
        let (time, pose) = (at(f64::from(index)), step(0.7, 0.08, index));
        let fix = FixedFramePoseData { time, fixed_from_tracking: Some(pose) };
        data.sensors_mut(TRAJECTORY).fixed_frame.insert(time, fix);
    }
    data
}

/// An IMU that gathers speed and turns, and is mounted a little askew.
fn with_imu(mut data: OptimizationData) -> OptimizationData {
    let imu_from_tracking = rotation_from_roll_pitch_yaw(0.1, -0.05, 0.0).inverse();
    for sample in 0..=70 {
        let time = at(0.1 * f64::from(sample) - 0.05);
        let linear_acceleration = imu_from_tracking * Vector3::new(0.2, 0.0, GRAVITY);
        let angular_velocity = imu_from_tracking * Vector3::new(0.0, 0.0, 0.1);
        data.sensors_mut(TRAJECTORY)
            .imu
            .insert(time, ImuData { time, linear_acceleration, angular_velocity });
    }
    data
}

struct Solved {
    data: OptimizationData,
    summary: OptimizationSummary,
}

fn solve(options: &Options, optimize: Optimize, change: fn(OptimizationData) -> OptimizationData) -> Solved {
    let (data, constraints) = row();
    let mut data = change(data);
    let problem = &options.map_builder.pose_graph.optimization_problem;
    let summary = optimize(&mut data, &constraints, problem);
    Solved { data, summary }
}

impl Solved {
    fn pose(&self, index: u32) -> Rigid3 {
        self.data.nodes[&node(index)].map_from_node
    }

    /// Metres from the first to the fourth node.
    fn length(&self) -> f64 {
        (self.pose(3).translation.vector - self.pose(0).translation.vector).norm()
    }

    /// How much the turn from the first to the fourth node differs from what local SLAM says.
    fn turn_off_local_slam(&self) -> f64 {
        (self.turn() - 3.0 * 0.02).abs()
    }

    /// Radians from the first to the fourth node.
    fn turn(&self) -> f64 {
        yaw(&(self.pose(0).inverse() * self.pose(3)).rotation)
    }

    /// Metres from where the loop closure wants the last node.
    fn loop_error(&self) -> f64 {
        let wanted = Vector3::new(2.0, 0.4, self.pose(NODES - 1).translation.z);
        (self.pose(NODES - 1).translation.vector - wanted).norm()
    }

    /// How much the speed grows, m/s per node.
    fn acceleration(&self) -> f64 {
        let x = |i| self.pose(i).translation.x;
        (x(3) - x(2)) - (x(2) - x(1))
    }

    fn height(&self) -> f64 {
        self.pose(NODES - 1).translation.z.abs()
    }

    fn mounting(&self) -> f64 {
        let calibration = self.data.sensors[&TRAJECTORY].imu_state.calibration;
        rotation_angle(&Rigid3::from_parts(Vector3::zeros().into(), calibration))
    }
}

/// Poses that are far from everything, so that the path to the solution is long and curved.
fn scrambled(mut data: OptimizationData) -> OptimizationData {
    for (id, node) in &mut data.nodes {
        let i = f64::from(id.index);
        node.map_from_node = pose(3.0 * (2.0 * i).sin(), 2.0 * (3.0 * i).cos(), 2.1 * i);
    }
    data
}

fn plain(data: OptimizationData) -> OptimizationData {
    data
}

/// Where some nodes are after a few steps from a bad start.
fn position_sum(options: &Options, optimize: Optimize) -> f64 {
    let solved = solve(options, optimize, scrambled);
    (0..NODES).map(|i| solved.pose(i).translation.vector.sum()).sum()
}

fn base() -> Options {
    let mut options = Options::for_3d();
    let problem = &mut options.map_builder.pose_graph.optimization_problem;
    for weight in [
        &mut problem.local_slam_pose_translation_weight,
        &mut problem.local_slam_pose_rotation_weight,
        &mut problem.odometry_translation_weight,
        &mut problem.odometry_rotation_weight,
        &mut problem.fixed_frame_pose_translation_weight,
        &mut problem.fixed_frame_pose_rotation_weight,
    ] {
        *weight = 1.0;
    }
    options
}

pub fn table() -> Vec<Effect> {
    let mut table = in_2d_and_3d();
    table.extend(in_3d());
    table
}

fn in_2d_and_3d() -> Vec<Effect> {
    effects! {
        "optimization_problem.huber_scale", "0.01" => "1000", Falls, |o| solve(o, optimize_2d, plain).loop_error();
        "optimization_problem.huber_scale", "0.01" => "1000", Falls, |o| solve(o, optimize_3d, plain).loop_error();
        "local_slam_pose_translation_weight", "1" => "1000", Falls, |o| solve(o, optimize_2d, plain).length();
        "local_slam_pose_translation_weight", "1" => "1000", Falls, |o| solve(o, optimize_3d, plain).length();
        "local_slam_pose_rotation_weight", "1" => "1000", Falls, |o| solve(o, optimize_2d, plain).turn_off_local_slam();
        "local_slam_pose_rotation_weight", "1" => "1000", Falls, |o| solve(o, optimize_3d, plain).turn_off_local_slam();
        "optimization_problem.odometry_translation_weight", "1" => "1000", Rises, |o| solve(o, optimize_2d, with_odometry).length();
        "optimization_problem.odometry_translation_weight", "1" => "1000", Rises, |o| solve(o, optimize_3d, with_odometry).length();
        "optimization_problem.odometry_rotation_weight", "1" => "1000", Rises, |o| solve(o, optimize_2d, with_odometry).turn();
        "optimization_problem.odometry_rotation_weight", "1" => "1000", Rises, |o| solve(o, optimize_3d, with_odometry).turn();
        "fixed_frame_pose_translation_weight", "1" => "1000", Rises, |o| solve(o, optimize_2d, with_fixed_frame).length();
        "fixed_frame_pose_translation_weight", "1" => "1000", Rises, |o| solve(o, optimize_3d, with_fixed_frame).length();
        "fixed_frame_pose_rotation_weight", "1" => "1000", Rises, |o| solve(o, optimize_2d, with_fixed_frame).turn();
        "fixed_frame_pose_rotation_weight", "1" => "1000", Rises, |o| solve(o, optimize_3d, with_fixed_frame).turn();
        "fixed_frame_pose_use_tolerant_loss", "false" => "true", Falls, |o| solve(o, optimize_2d, with_fixed_frame).length(),
            ["fixed_frame_pose_translation_weight=20", "fixed_frame_pose_tolerant_loss_param_a=10000"];
        "fixed_frame_pose_use_tolerant_loss", "false" => "true", Falls, |o| solve(o, optimize_3d, with_fixed_frame).length(),
            ["fixed_frame_pose_translation_weight=20", "fixed_frame_pose_tolerant_loss_param_a=10000"];
        "fixed_frame_pose_tolerant_loss_param_a", "0" => "10000", Falls, |o| solve(o, optimize_2d, with_fixed_frame).length(),
            ["fixed_frame_pose_translation_weight=20", "fixed_frame_pose_use_tolerant_loss=true"];
        "fixed_frame_pose_tolerant_loss_param_b", "0.1" => "10", Changes, |o| solve(o, optimize_2d, with_fixed_frame).length(),
            ["fixed_frame_pose_translation_weight=20", "fixed_frame_pose_use_tolerant_loss=true"];
        "optimization_problem.ceres_solver_options.max_num_iterations", "1" => "30", Rises,
            |o| f64::from(solve(o, optimize_2d, scrambled).summary.iterations);
        "optimization_problem.ceres_solver_options.max_num_iterations", "1" => "30", Rises,
            |o| f64::from(solve(o, optimize_3d, scrambled).summary.iterations);
        "optimization_problem.ceres_solver_options.use_nonmonotonic_steps", "false" => "true", Changes, |o| position_sum(o, optimize_2d),
            ["optimization_problem.ceres_solver_options.max_num_iterations=12"];
        "optimization_problem.ceres_solver_options.use_nonmonotonic_steps", "false" => "true", Changes, |o| position_sum(o, optimize_3d),
            ["optimization_problem.ceres_solver_options.max_num_iterations=12"];
    }
}

fn in_3d() -> Vec<Effect> {
    effects! {
        "acceleration_weight", "0" => "10000", Rises, |o| solve(o, optimize_3d, with_imu).acceleration();
        "optimization_problem.rotation_weight", "0" => "10000", Rises, |o| solve(o, optimize_3d, with_imu).turn();
        "use_online_imu_extrinsics_in_3d", "false" => "true", Rises, |o| solve(o, optimize_3d, with_imu).mounting();
        "fix_z_in_3d", "false" => "true", Falls, |o| solve(o, optimize_3d, plain).height();
    }
}

#[test]
fn options_of_the_optimisation_have_their_effects() {
    check(&base(), &in_2d_and_3d());
    check(&base(), &in_3d());
}

#[test]
fn a_loop_closure_adds_no_information_along_a_degenerate_direction() {
    let solved = |open: Option<Vector3>| {
        let (mut data, mut constraints) = row();
        for constraint in constraints.iter_mut().filter(|c| c.is_loop_closure()) {
            constraint.open = open.map(|direction| OpenShift { direction });
        }
        optimize_2d(&mut data, &constraints, &base().map_builder.pose_graph.optimization_problem);
        data.nodes[&node(NODES - 1)].map_from_node.translation.vector
    };
    let (without, closed) = (row().0.nodes[&node(NODES - 1)].map_from_node.translation.vector, solved(None));
    let [open_along, open_across] = [Vector3::x(), Vector3::y()].map(|direction| solved(Some(direction)));
    assert!((closed.x - without.x).abs() > 0.1 && closed.y - without.y > 0.05, "{closed:?}");
    assert!((open_along.x - without.x).abs() < 0.05 && open_along.y - without.y > 0.05, "{open_along:?}");
    assert!((open_across.x - without.x).abs() > 0.1 && open_across.y - without.y < 0.05, "{open_across:?}");
}
