//! The optimisation problem of vectors.md §10, built from the factors of this crate: all residuals of a
//! nodes_2d pose graph with known costs and result.

#![allow(clippy::unwrap_used, clippy::panic)]

use portolan_geometry::{
    Quaternion, Rigid2, Rigid3, Vector3, embed_3d, project_2d, rotation_from_roll_pitch_yaw,
};
use portolan_solver::factors::{Landmark2d, Se2Between};
use portolan_solver::{Loss, Problem, SolverOptions, Summary, VariableId};

const HUBER: Loss = Loss::Huber(10.0);

struct Built {
    problem: Problem,
    submaps: [VariableId; 2],
    nodes: Vec<VariableId>,
    landmark: VariableId,
    fixed_frame: VariableId,
}

fn gravity(i: usize) -> Quaternion {
    rotation_from_roll_pitch_yaw(0.02 * i as f64, -0.01 * i as f64, 0.0)
}

fn local(i: usize) -> Rigid2 {
    let i = i as f64;
    Rigid2::new(0.5 * i, 0.02 * i * i, 0.05 * i)
}

fn global(i: usize) -> Rigid2 {
    let (pose, i) = (local(i), i as f64);
    Rigid2::new(pose.translation.x + 0.01 * i, pose.translation.y - 0.02 * i, pose.angle + 0.003 * i)
}

/// Interpolation between poses at equal intervals from `start` on.
fn lookup(start: f64, interval: f64, pose: impl Fn(f64) -> Rigid3, time: f64) -> Rigid3 {
    let index = ((time - start) / interval).floor();
    let (first, second) = (pose(index), pose(index + 1.0));
    let factor = (time - start) / interval - index;
    let translation = first.translation.vector.lerp(&second.translation.vector, factor);
    Rigid3::from_parts(translation.into(), first.rotation.slerp(&second.rotation, factor))
}

fn odometry(time: f64) -> Rigid3 {
    lookup(-0.25, 0.5, |i| embed_3d(&Rigid2::new(0.253 * i, 0.005 * i * i, 0.026 * i)), time)
}

fn fixed_frame(time: f64) -> Rigid3 {
    lookup(0.0, 2.0, |i| Rigid3::translation(10.0 + i, 20.0 + 0.1 * i * i, 0.0), time)
}

fn between(variables: [VariableId; 2], measurement: Rigid2, weights: (f64, f64)) -> Se2Between {
    Se2Between { variables, measurement, translation_weight: weights.0, rotation_weight: weights.1 }
}

fn build() -> Built {
    let mut problem = Problem::new();
    let submap_poses = [Rigid2::identity(), Rigid2::new(2.0, 0.32, 0.2)];
    let submaps = submap_poses.map(|pose| problem.add_se2(&pose));
    problem.set_constant(submaps[0]);
    let nodes: Vec<VariableId> = (0..8).map(|i| problem.add_se2(&global(i))).collect();
    for (i, node) in nodes.iter().enumerate() {
        let submap = usize::from(i >= 4);
        let measurement = submap_poses[submap].inverse() * local(i);
        problem
            .add_factor(between([submaps[submap], *node], measurement, (500.0, 1600.0)), Loss::None)
            .unwrap();
    }
    for (submap, node, pose) in [(0, 7, Rigid2::new(3.6, 1.05, 0.37)), (1, 1, Rigid2::new(-1.5, 0.05, -0.16))]
    {
        problem.add_factor(between([submaps[submap], nodes[node]], pose, (11000.0, 1e5)), HUBER).unwrap();
    }
    let landmark = add_landmark(&mut problem, &nodes);
    for i in 0..7 {
        let pair = [nodes[i], nodes[i + 1]];
        let local_slam = local(i).inverse() * local(i + 1);
        problem.add_factor(between(pair, local_slam, (1e5, 1e5)), Loss::None).unwrap();
        let (a, b) = (odometry(i as f64), odometry((i + 1) as f64));
        let aligned = Rigid3::from_parts(Vector3::zeros().into(), gravity(i))
            * (a.inverse() * b)
            * Rigid3::from_parts(Vector3::zeros().into(), gravity(i + 1)).inverse();
        problem.add_factor(between(pair, project_2d(&aligned), (1e5, 1e5)), Loss::None).unwrap();
    }
    let first = fixed_frame(0.0);
    let origin = embed_3d(&global(0)) * first.inverse();
    let fixed = problem.add_se2(&project_2d(&origin));
    for (i, node) in nodes.iter().enumerate() {
        let measurement = project_2d(&fixed_frame(i as f64));
        problem.add_factor(between([fixed, *node], measurement, (10.0, 100.0)), Loss::None).unwrap();
    }
    Built { problem, submaps, nodes, landmark, fixed_frame: fixed }
}

fn add_landmark(problem: &mut Problem, nodes: &[VariableId]) -> VariableId {
    let seen = |x, y, z, roll, yaw| {
        Rigid3::from_parts(Vector3::new(x, y, z).into(), rotation_from_roll_pitch_yaw(roll, 0.0, yaw))
    };
    let sightings = [(1.5, seen(1.0, 0.5, 0.2, 0.0, 0.3)), (5.2, seen(-0.9, 0.3, 0.1, 0.02, 0.12))];
    let mut landmark = None;
    for (time, tracking_from_landmark) in sightings {
        let previous = f64::floor(time) as usize;
        let mut factor = Landmark2d {
            variables: [nodes[previous], nodes[previous + 1], nodes[0]],
            interpolation_factor: time - previous as f64,
            gravity_alignments: [gravity(previous), gravity(previous + 1)],
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

fn solve(problem: &mut Problem) -> Summary {
    problem.solve(&SolverOptions::default()).unwrap()
}

#[test]
fn costs_and_poses_are_those_of_the_vector() {
    let mut built = build();
    let problem = &mut built.problem;
    assert_eq!((problem.factor_count(), problem.residual_count()), (34, 108));
    let summary = solve(problem);
    assert!((summary.initial_cost / 48275524.7 - 1.0).abs() < 1e-8, "{summary:?}");
    assert!((summary.final_cost / 1468790.716 - 1.0).abs() < 1e-9, "{summary:?}");
    let nodes_2d = [
        (built.submaps[1], Rigid2::new(2.064268479, 0.324246134, 0.227239634)),
        (built.nodes[0], Rigid2::new(0.088460305, 0.004829034, 0.016341281)),
        (built.nodes[3], Rigid2::new(1.595496135, 0.214361456, 0.168719655)),
        (built.nodes[7], Rigid2::new(3.599139015, 1.049816530, 0.369975090)),
        (built.fixed_frame, Rigid2::new(-5.827353050, -21.914009367, 0.190170985)),
    ];
    for (id, expected) in nodes_2d {
        let difference = expected.inverse() * problem.se2(id);
        assert!(
            difference.translation.norm() < 1e-8 && difference.angle.abs() < 1e-8,
            "{:?}",
            problem.se2(id)
        );
    }
    let landmark = problem.se3(built.landmark);
    assert!(
        (landmark.translation.vector - Vector3::new(1.786477317, 0.651751334, 0.220336502)).norm() < 1e-8
    );
    let q = landmark.rotation;
    assert!((q.w - 0.980508556).abs() + (q.i - 0.017384698).abs() + (q.j + 0.009647361).abs() < 1e-8);
}
