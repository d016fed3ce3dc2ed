use portolan_geometry::{Time, Vector3};
use portolan_sensor::{FixedFramePoseData, ImuData, LandmarkObservation};

use super::*;
use crate::{ConstraintTag, SensorPolicy, SubmapId};

const TRAJECTORY: TrajectoryId = TrajectoryId(0);

fn pose(x: f64, y: f64, z: f64, roll: f64, pitch: f64, yaw: f64) -> Rigid3 {
    Rigid3::from_parts(Vector3::new(x, y, z).into(), rotation_from_roll_pitch_yaw(roll, pitch, yaw))
}

fn local(i: u32) -> Rigid3 {
    let i = f64::from(i);
    pose(0.5 * i, 0.02 * i * i, 0.01 * i, 0.01 * i, -0.005 * i, 0.05 * i)
}

fn global(i: u32) -> Rigid3 {
    let k = f64::from(i);
    let turned = local(i).rotation * rotation_from_roll_pitch_yaw(0.0, 0.002 * k, 0.003 * k);
    let moved = local(i).translation.vector + Vector3::new(0.01 * k, -0.02 * k, 0.005 * k);
    Rigid3::from_parts(moved.into(), turned)
}

fn seconds(s: f64) -> Time {
    Time::from_ticks((s * 1e7).round() as i64)
}

/// The problem of the golden vectors (§11).
fn golden() -> (OptimizationData, Vec<Constraint>) {
    let mut data = OptimizationData::default();
    let mut constraints = Vec::new();
    let mut relate = |submap: u32, node: u32, submap_from_node: Rigid3, loop_closure: bool| {
        let weights = if loop_closure { (11000.0, 1e5) } else { (500.0, 1600.0) };
        constraints.push(Constraint {
            submap_id: SubmapId::new(TRAJECTORY, submap),
            node_id: NodeId::new(TRAJECTORY, node),
            submap_from_node,
            translation_weight: weights.0,
            rotation_weight: weights.1,
            tag: if loop_closure { ConstraintTag::InterSubmap } else { ConstraintTag::IntraSubmap },
            open: None,
            score: None,
        });
    };
    for i in 0..8 {
        let gravity_alignment = rotation_from_roll_pitch_yaw(0.02 * f64::from(i), -0.01 * f64::from(i), 0.0);
        let node = OptimizationNode {
            time: seconds(f64::from(i)),
            local_from_node: local(i),
            map_from_node: global(i),
            gravity_alignment,
        };
        data.nodes.insert(NodeId::new(TRAJECTORY, i), node);
        let submap = u32::from(i >= 4);
        relate(submap, i, local(4 * submap).inverse() * local(i), false);
    }
    relate(0, 7, pose(3.6, 1.05, 0.05, 0.05, -0.03, 0.37), true);
    relate(1, 1, pose(-1.5, 0.05, -0.03, -0.03, 0.01, -0.16), true);
    data.submaps.insert(SubmapId::new(TRAJECTORY, 0), local(0));
    data.submaps.insert(SubmapId::new(TRAJECTORY, 1), local(4));
    let sensors = data.sensors_mut(TRAJECTORY);
    for i in 0..=80i64 {
        let time = Time::from_ticks(1_000_000 * i - 500_000);
        let linear_acceleration =
            Vector3::new(0.05 * ((i % 5) - 2) as f64, 0.03 * ((i % 3) - 1) as f64, 9.75);
        let angular_velocity = Vector3::new(0.01, -0.005, 0.05 + 0.002 * ((i % 4) as f64 - 1.5));
        sensors.imu.insert(time, ImuData { time, linear_acceleration, angular_velocity });
    }
    for i in 0..=4 {
        let (time, k) = (seconds(2.0 * f64::from(i)), f64::from(i));
        let fixed_from_tracking = Some(Rigid3::translation(10.0 + k, 20.0 + 0.1 * k * k, 3.0));
        sensors.fixed_frame.insert(time, FixedFramePoseData { time, fixed_from_tracking });
    }
    let landmark = data.landmarks.entry("a".to_owned()).or_default();
    for (time, tracking_from_landmark) in
        [(1.5, pose(1.0, 0.5, 0.2, 0.0, 0.0, 0.3)), (5.2, pose(-0.9, 0.3, 0.1, 0.02, 0.0, 0.12))]
    {
        landmark.sightings.push(LandmarkSighting {
            trajectory_id: TRAJECTORY,
            time: seconds(time),
            observation: LandmarkObservation {
                id: "a".into(),
                tracking_from_landmark,
                translation_weight: 1e3,
                rotation_weight: 1e2,
            },
        });
    }
    (data, constraints)
}

#[test]
fn the_golden_problem_is_solved() {
    let (mut data, constraints) = golden();
    let summary = optimize_3d(&mut data, &constraints, &OptimizationProblemOptions::default());
    assert!((summary.initial_cost / 69411.943 - 1.0).abs() < 1e-7, "{summary:?}");
    assert!((summary.final_cost / 4988.901 - 1.0).abs() < 1e-6, "{summary:?}");
    let near =
        |pose: &Rigid3, expected: [f64; 3]| (pose.translation.vector - Vector3::from(expected)).norm() < 1e-7;
    assert!(near(&data.submaps[&SubmapId::new(TRAJECTORY, 1)], [2.046393825, 0.333715251, -0.052778932]));
    let node = &data.nodes[&NodeId::new(TRAJECTORY, 7)].map_from_node;
    assert!(near(node, [3.596980745, 1.050517658, -0.148334878]));
    let landmark = data.landmarks["a"].map_from_landmark.unwrap();
    assert!(near(&landmark, [1.737029836, 0.646228177, 0.104451238]));
    let origin = data.fixed_frame_origins[&TRAJECTORY].unwrap();
    assert!(near(&origin, [-5.983688368, -21.892908016, -3.057857475]));
    let imu = data.sensors[&TRAJECTORY].imu_state;
    assert!((imu.gravity_constant - 9.752691732).abs() < 1e-7);
    assert!((imu.calibration.k - 0.069386904).abs() < 1e-7);
    // The result is the start of the next optimisation.
    let again = optimize_3d(&mut data, &constraints, &OptimizationProblemOptions::default());
    assert!((again.initial_cost / summary.final_cost - 1.0).abs() < 1e-9);
}

#[test]
fn without_an_imu_local_slam_ties_the_nodes() {
    let (mut data, mut constraints) = golden();
    constraints.retain(|c| !c.is_loop_closure());
    data.landmarks.clear();
    data.sensors.clear();
    let summary = optimize_3d(&mut data, &constraints, &OptimizationProblemOptions::default());
    assert!(summary.final_cost < 1e-6 * summary.initial_cost, "{summary:?}");
    let relative = |id: u32| {
        let first = data.nodes[&NodeId::new(TRAJECTORY, 0)].map_from_node;
        first.inverse() * data.nodes[&NodeId::new(TRAJECTORY, id)].map_from_node
    };
    let error = (local(0).inverse() * local(7)).inverse() * relative(7);
    assert!(error.translation.vector.norm() < 1e-3 && error.rotation.angle() < 1e-3, "{error}");
}

#[test]
fn fixed_heights_do_not_change() {
    let (mut data, constraints) = golden();
    let options = OptimizationProblemOptions { fix_z_in_3d: true, ..Default::default() };
    let summary = optimize_3d(&mut data, &constraints, &options);
    assert!(summary.final_cost < summary.initial_cost);
    for (id, node) in &data.nodes {
        let expected = global(id.index).translation.z;
        assert!((node.map_from_node.translation.z - expected).abs() < 1e-12);
    }
    assert_eq!(data.sensors[&TRAJECTORY].imu_state, ImuState::default());
}

#[test]
fn frozen_trajectories_do_not_move() {
    let (mut data, constraints) = golden();
    data.frozen.insert(TRAJECTORY);
    let before = data.clone();
    optimize_3d(&mut data, &constraints, &OptimizationProblemOptions::default());
    assert_eq!(data.nodes, before.nodes);
    assert_eq!(data.submaps, before.submaps);
}

/// A straight drive with fixes whose heights are off by metres, with and without the prior on the start.
#[test]
fn fixes_along_a_straight_path_do_not_roll_the_map() {
    let roll_of = |corrects: bool| {
        let mut data = OptimizationData {
            sensor_policy: SensorPolicy {
                weighs_fixes_by_scatter: corrects,
                has_robust_fixes: corrects,
                holds_start_level: corrects,
                ..Default::default()
            },
            max_iterations_override: Some(200),
            ..Default::default()
        };
        let mut constraints = Vec::new();
        for i in 0..40 {
            // Nearly straight: a lane is changed.
            let place = Vector3::new(5.0 * f64::from(i), if i < 20 { 0.0 } else { 3.0 }, 0.0);
            let local = Rigid3::from_parts(place.into(), Quaternion::identity());
            let node = OptimizationNode {
                time: seconds(f64::from(i)),
                local_from_node: local,
                map_from_node: local,
                gravity_alignment: Quaternion::identity(),
            };
            data.nodes.insert(NodeId::new(TRAJECTORY, i), node);
            constraints.push(Constraint {
                submap_id: SubmapId::new(TRAJECTORY, 0),
                node_id: NodeId::new(TRAJECTORY, i),
                submap_from_node: local,
                translation_weight: 500.0,
                rotation_weight: 1600.0,
                tag: ConstraintTag::IntraSubmap,
                open: None,
                score: None,
            });
            // Heights differ between the lanes because of signals reflected by houses.
            let height = if i < 20 { -0.6 } else { 0.6 } + 0.3 * f64::from(i % 3);
            let fixed_from_tracking = Some(Rigid3::translation(place.x, place.y, height));
            let fix = FixedFramePoseData { time: seconds(f64::from(i)), fixed_from_tracking };
            data.sensors_mut(TRAJECTORY).fixed_frame.insert(fix.time, fix);
        }
        data.submaps.insert(SubmapId::new(TRAJECTORY, 0), Rigid3::identity());
        let options = OptimizationProblemOptions {
            fixed_frame_pose_translation_weight: 1.0,
            fixed_frame_pose_rotation_weight: 0.0,
            ..Default::default()
        };
        optimize_3d(&mut data, &constraints, &options);
        let up = data.nodes[&NodeId::new(TRAJECTORY, 30)].map_from_node.rotation * Vector3::z();
        up.y.abs().asin().to_degrees()
    };
    let (free, held) = (roll_of(false), roll_of(true));
    assert!(free > 10.0 && held < 3.0, "without {free} deg, with {held} deg");
}
