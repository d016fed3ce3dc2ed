//! The optimisation problem of vectors.md §11, built from the factors of this crate: a pose graph in 3D
//! with IMU, gravity, calibration, landmark and fixed frame, with known costs and result.

#![allow(clippy::unwrap_used, clippy::panic)]

use portolan_geometry::{
    Quaternion, Rigid3, Vector3, quaternion_from_angle_axis, rotation_from_roll_pitch_yaw, yaw,
};
use portolan_solver::factors::{ImuAcceleration, ImuRotation, Landmark3d, Se3Between};
use portolan_solver::{Loss, Problem, RotationFreedom, SolverOptions, TranslationFreedom, VariableId};

const HUBER: Loss = Loss::Huber(10.0);

fn pose(x: f64, y: f64, z: f64, roll: f64, pitch: f64, yaw: f64) -> Rigid3 {
    Rigid3::from_parts(Vector3::new(x, y, z).into(), rotation_from_roll_pitch_yaw(roll, pitch, yaw))
}

fn local(i: usize) -> Rigid3 {
    let i = i as f64;
    pose(0.5 * i, 0.02 * i * i, 0.01 * i, 0.01 * i, -0.005 * i, 0.05 * i)
}

fn global(i: usize) -> Rigid3 {
    let k = i as f64;
    let turned = local(i).rotation * rotation_from_roll_pitch_yaw(0.0, 0.002 * k, 0.003 * k);
    let moved = local(i).translation.vector + Vector3::new(0.01 * k, -0.02 * k, 0.005 * k);
    Rigid3::from_parts(moved.into(), turned)
}

fn fixed_frame(time: f64) -> Rigid3 {
    let at = |i: f64| Vector3::new(10.0 + i, 20.0 + 0.1 * i * i, 3.0);
    let index = (time / 2.0).floor();
    let (a, b) = (at(index), at(index + 1.0));
    Rigid3::from_parts(a.lerp(&b, time / 2.0 - index).into(), Quaternion::identity())
}

/// IMU samples: ticks of 100 ns, specific force, angular velocity.
fn imu() -> Vec<(i64, Vector3, Vector3)> {
    let sample = |i: i64| {
        let force = Vector3::new(0.05 * ((i % 5) - 2) as f64, 0.03 * ((i % 3) - 1) as f64, 9.75);
        let turn = Vector3::new(0.01, -0.005, 0.05 + 0.002 * ((i % 4) as f64 - 1.5));
        (1_000_000 * i - 500_000, force, turn)
    };
    (0..=80).map(sample).collect()
}

/// Change of velocity and rotation between two times (slam3d §8).
fn integrate(imu: &[(i64, Vector3, Vector3)], start: i64, end: i64) -> (Vector3, Quaternion) {
    let mut index = imu.partition_point(|s| s.0 <= start) - 1;
    let (mut velocity, mut rotation) = (Vector3::zeros(), Quaternion::identity());
    let mut time = start;
    while time < end {
        let next = imu.get(index + 1).map_or(end, |s| s.0.min(end));
        let seconds = (next - time) as f64 * 1e-7;
        rotation *= quaternion_from_angle_axis(&(imu[index].2 * seconds));
        velocity += rotation * (imu[index].1 * seconds);
        (time, index) = (next, index + 1);
    }
    (velocity, rotation)
}

struct Built {
    problem: Problem,
    submaps: [VariableId; 2],
    nodes: Vec<VariableId>,
    landmark: VariableId,
    fixed_frame: VariableId,
    gravity: VariableId,
    calibration: VariableId,
}

fn between(variables: [VariableId; 2], measurement: Rigid3, weights: (f64, f64)) -> Se3Between {
    Se3Between { variables, measurement, translation_weight: weights.0, rotation_weight: weights.1 }
}

fn build() -> Built {
    let mut problem = Problem::new();
    let first = problem.add_se3_with(&local(0), TranslationFreedom::Constant, RotationFreedom::ConstantYaw);
    let submaps = [first, problem.add_se3(&local(4))];
    let nodes: Vec<VariableId> = (0..8).map(|i| problem.add_se3(&global(i))).collect();
    for (i, node) in nodes.iter().enumerate() {
        let submap = usize::from(i >= 4);
        let measurement = local(4 * submap).inverse() * local(i);
        problem
            .add_factor(between([submaps[submap], *node], measurement, (500.0, 1600.0)), Loss::None)
            .unwrap();
    }
    for (submap, node, measurement) in [
        (0, 7, pose(3.6, 1.05, 0.05, 0.05, -0.03, 0.37)),
        (1, 1, pose(-1.5, 0.05, -0.03, -0.03, 0.01, -0.16)),
    ] {
        problem
            .add_factor(between([submaps[submap], nodes[node]], measurement, (11000.0, 1e5)), HUBER)
            .unwrap();
    }
    let landmark = add_landmark(&mut problem, &nodes);
    let gravity = problem.add_nonnegative(9.8);
    let calibration = problem.add_rotation(&Quaternion::identity(), RotationFreedom::Free);
    add_imu(&mut problem, &nodes, gravity, calibration);
    let origin = global(0) * fixed_frame(0.0).inverse();
    let heading = rotation_from_roll_pitch_yaw(0.0, 0.0, yaw(&origin.rotation));
    let origin = Rigid3::from_parts(origin.translation, heading);
    let fixed = problem.add_se3_with(&origin, TranslationFreedom::Free, RotationFreedom::YawOnly);
    for (i, node) in nodes.iter().enumerate() {
        let factor = between([fixed, *node], fixed_frame(i as f64), (10.0, 100.0));
        problem.add_factor(factor, Loss::None).unwrap();
    }
    Built { problem, submaps, nodes, landmark, fixed_frame: fixed, gravity, calibration }
}

fn add_landmark(problem: &mut Problem, nodes: &[VariableId]) -> VariableId {
    let sightings = [(1.5, pose(1.0, 0.5, 0.2, 0.0, 0.0, 0.3)), (5.2, pose(-0.9, 0.3, 0.1, 0.02, 0.0, 0.12))];
    let mut landmark = None;
    for (time, tracking_from_landmark) in sightings {
        let previous = f64::floor(time) as usize;
        let mut factor = Landmark3d {
            variables: [nodes[previous], nodes[previous + 1], nodes[0]],
            interpolation_factor: time - previous as f64,
            tracking_from_landmark,
            translation_weight: 1e3,
            rotation_weight: 1e2,
        };
        let tracking = factor.interpolated_tracking_pose(&global(previous), &global(previous + 1));
        let id = *landmark.get_or_insert_with(|| problem.add_se3(&(tracking * tracking_from_landmark)));
        factor.variables[2] = id;
        problem.add_factor(factor, HUBER).unwrap();
    }
    landmark.unwrap()
}

fn add_imu(problem: &mut Problem, nodes: &[VariableId], gravity: VariableId, calibration: VariableId) {
    let imu = imu();
    let tick = |i: usize| 10_000_000 * i as i64;
    for i in 0..7 {
        let (_, rotation) = integrate(&imu, tick(i), tick(i + 1));
        let factor = ImuRotation {
            variables: [nodes[i], nodes[i + 1], calibration],
            first_from_second: rotation,
            weight: 16000.0,
        };
        problem.add_factor(factor, Loss::None).unwrap();
        if i == 6 {
            break;
        }
        let centre = |k: usize| tick(k) + 5_000_000;
        let (_, to_centre) = integrate(&imu, tick(i), centre(i));
        let (velocity, _) = integrate(&imu, centre(i), centre(i + 1));
        let factor = ImuAcceleration {
            variables: [nodes[i], nodes[i + 1], nodes[i + 2], gravity, calibration],
            delta_velocity_in_second: (rotation.inverse() * to_centre) * velocity,
            first_duration: 1.0,
            second_duration: 1.0,
            weight: 110.0 / 2.0,
        };
        problem.add_factor(factor, Loss::None).unwrap();
    }
}

fn close(actual: &Quaternion, expected: [f64; 4]) -> f64 {
    let [w, x, y, z] = expected;
    [actual.w - w, actual.i - x, actual.j - y, actual.k - z].iter().fold(0.0, |max, d| d.abs().max(max))
}

#[test]
fn costs_and_poses_are_those_of_the_vector() {
    let mut built = build();
    let problem = &mut built.problem;
    assert_eq!((problem.factor_count(), problem.residual_count()), (33, 159));
    // The vector counts the constant translation of submap 0 as well.
    assert_eq!(problem.degrees_of_freedom(), 73 - 3);
    let summary = problem.solve(&SolverOptions::default()).unwrap();
    let node = problem.se3(built.nodes[7]);
    assert!((summary.initial_cost / 69411.943 - 1.0).abs() < 1e-7, "{summary:?}");
    assert!((summary.final_cost / 4988.901 - 1.0).abs() < 1e-6, "{summary:?}");
    let first = problem.se3(built.submaps[0]);
    assert_eq!(first.translation.vector, Vector3::zeros());
    assert!(close(&first.rotation, [0.999629035, -0.013630614, 0.023578126, 0.000267175]) < 1e-8);
    let expected = [
        (built.submaps[1], Vector3::new(2.046393825, 0.333715251, -0.052778932)),
        (built.nodes[0], Vector3::new(0.002174969, 0.004064344, -0.000377809)),
        (built.nodes[7], Vector3::new(3.596980745, 1.050517658, -0.148334878)),
        (built.landmark, Vector3::new(1.737029836, 0.646228177, 0.104451238)),
        (built.fixed_frame, Vector3::new(-5.983688368, -21.892908016, -3.057857475)),
    ];
    for (id, translation) in expected {
        let difference = problem.se3(id).translation.vector - translation;
        assert!(difference.norm() < 1e-8, "{difference}");
    }
    assert!(close(&node.rotation, [0.982648372, 0.018274530, 0.015545009, 0.183920011]) < 1e-8);
    let fixed = problem.se3(built.fixed_frame).rotation;
    assert!(close(&fixed, [0.995693490, 0.0, 0.0, 0.092706382]) < 1e-8);
    assert!((problem.scalar(built.gravity) - 9.752691732).abs() < 1e-8);
    let calibration = problem.rotation(built.calibration);
    assert!(close(&calibration, [0.997368503, -0.007254329, -0.019720569, 0.069386904]) < 1e-8);
}
