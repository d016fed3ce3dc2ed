//! Places and clocks of several lidars, and of the IMU, are found.
#![allow(clippy::unwrap_used)] // tests

mod synthetic;

use portolan_geometry::{Duration, Rigid3, Time, Vector3, nalgebra as na};
use portolan_refinement::MotionSensors;
use portolan_refinement::continuous::{ContinuousOptions, Gauge, refine_continuous, refine_continuous_with};
use portolan_sensor::{FixedFramePoseData, ImuData, OdometryData};
use portolan_testing::is_fast;
use synthetic::{
    Lidar, Random, circles, disturbed, errors, furnished, poses, room, scan, scan_with, straight,
};

fn mounted(assumed_mounting: Rigid3, delay: f64) -> [Lidar; 2] {
    let first = Lidar { name: "first", ..Lidar::known() };
    [first, Lidar { name: "second", tracking_from_lidar: mount(), assumed_mounting, delay }]
}

fn mount() -> Rigid3 {
    Rigid3::new(Vector3::new(-0.2, 0.1, 0.3), Vector3::new(0.0, 0.9, 0.0))
}

#[test]
fn a_wrong_place_and_clock_of_a_lidar_are_found() {
    if is_fast() {
        return;
    }
    // Two centimetres, one degree, twenty milliseconds.
    let wrong = Rigid3::new(Vector3::new(0.015, -0.01, 0.01), Vector3::new(0.010, -0.008, 0.012));
    let truth = poses(circles, 20.0);
    let points = scan_with(&mounted(wrong * mount(), 0.02), &furnished(), circles, 20.0, 90);
    let options = ContinuousOptions { calibrate_lidars: true, ..ContinuousOptions::default() };
    let input = disturbed(&truth, 0.2, 0.005);
    let refined = refine_continuous(&points, &input, &options, &mut |_| true).unwrap();
    assert!(refined.report.calibrated && refined.report.mountings.len() == 1);
    let found = refined.correction(1);
    let rest = found.tracking_from_assumed * wrong;
    // At the lidar itself, about which it turned.
    let place = mount().translation.vector;
    let shift = (rest * na::Point3::from(place)).coords - place;
    let mounting = &refined.report.mountings[0];
    assert!(shift.norm() < 0.004, "{shift} {mounting:?}");
    assert!(rest.rotation.angle() < 0.002, "{} {mounting:?}", rest.rotation.angle());
    assert!((found.delay - 0.02).abs() < 0.002, "{mounting:?}");
    assert!(mounting.undetermined.is_empty(), "{mounting:?}");
    let errors_in_deviations = shift.iter().zip(mounting.translation_deviation).map(|(e, d)| (e / d).abs());
    assert!(errors_in_deviations.fold(0.0, f64::max) < 8.0, "{shift} {mounting:?}");
    assert!((found.delay - 0.02).abs() < 8.0 * mounting.delay_deviation, "{mounting:?}");
    let after: Vec<_> =
        input.iter().map(|(time, pose)| (*time, refined.trajectory.corrected(*time, pose))).collect();
    assert!(errors(&truth, &after).0 < 0.004);
}

#[test]
fn parameters_that_the_motion_does_not_constrain_are_named() {
    // In a corridor the position of the second lidar along it is unobservable.
    let walls = room([-100.0, -1.0, 0.0], [200.0, 1.2, 2.6]);
    let points = scan_with(&mounted(mount(), 0.0), &walls, straight, 8.0, 60);
    let options = ContinuousOptions { calibrate_lidars: true, ..ContinuousOptions::default() };
    let refined = refine_continuous(&points, &poses(straight, 8.0), &options, &mut |_| true).unwrap();
    let mounting = &refined.report.mountings[0];
    assert!(mounting.undetermined.contains(&"translation along x"), "{mounting:?}");
    assert!(refined.report.warnings.iter().any(|w| w.contains("does not determine")));
    assert!(mounting.translation[0].abs() < 0.05 && mounting.translation[1].abs() < 0.01, "{mounting:?}");
}

/// An IMU that is turned against the tracking frame, sits elsewhere and is late.
fn imu(seconds: f64, turn: Vector3, lever: Vector3, delay: f64) -> MotionSensors {
    let mut sensors = MotionSensors::default();
    let mut random = Random::new(9);
    let tracking_from_imu = Rigid3::new(Vector3::zeros(), turn).rotation;
    let bias = Vector3::new(0.004, -0.006, 0.003);
    for i in 0..(seconds * 200.0) as usize {
        let s = i as f64 / 200.0;
        let step = 1e-3;
        let place = |s: f64| (circles(s) * na::Point3::from(lever)).coords;
        let acceleration = (place(s + step) - 2.0 * place(s) + place(s - step)) / (step * step);
        let rotation = circles(s).rotation;
        let turned = circles(s - step).rotation.inverse() * circles(s + step).rotation;
        let rate = turned.scaled_axis() / (2.0 * step);
        let force = rotation.inverse() * (acceleration + Vector3::new(0.0, 0.0, 9.81));
        let mut noise = |size: f64| Vector3::from_fn(|_, _| size * random.normal());
        sensors.push_imu(&ImuData {
            time: Time::from_unix_seconds(1000.0) + Duration::from_seconds(s - delay),
            linear_acceleration: tracking_from_imu.inverse() * force + noise(0.05),
            angular_velocity: tracking_from_imu.inverse() * rate + bias + noise(0.002),
        });
    }
    sensors
}

#[test]
fn turn_place_and_clock_of_the_imu_are_found() {
    if is_fast() {
        return;
    }
    let (turn, lever, delay) = (Vector3::new(0.01, -0.02, 0.015), Vector3::new(0.10, -0.05, 0.08), 0.02);
    let truth = poses(circles, 30.0);
    let points = scan(&furnished(), circles, 30.0, 90);
    let sensors = imu(30.0, turn, lever, delay);
    let options = ContinuousOptions::default();
    let input = disturbed(&truth, 0.2, 0.005);
    let refined = refine_continuous_with(&points, &sensors, &input, &options, &mut |_| true).unwrap();
    let found = refined.report.imu.as_ref().unwrap();
    assert!((Vector3::from(found.rotation) - turn).norm() < 0.003, "{found:?}");
    assert!((found.delay - delay).abs() < 0.003, "{found:?}");
    assert!((Vector3::from(found.translation) - lever).norm() < 0.04, "{found:?}");
    assert!(
        refined.report.warnings.iter().any(|w| w.contains("IMU seems to be")),
        "{:?}",
        refined.report.warnings
    );
    // The result is as good as without it.
    let after: Vec<_> =
        input.iter().map(|(time, pose)| (*time, refined.trajectory.corrected(*time, pose))).collect();
    assert!(errors(&truth, &after).0 < 0.005);
}

#[test]
fn gravity_levels_and_fixes_place_the_result() {
    if is_fast() {
        return;
    }
    let truth = poses(circles, 15.0);
    let points = scan(&furnished(), circles, 15.0, 60);
    let mut sensors = imu(15.0, Vector3::zeros(), Vector3::zeros(), 0.0);
    let fixed_from_world = Rigid3::new(Vector3::new(40.0, -20.0, 3.0), Vector3::new(0.0, 0.0, 2.0));
    let mut random = Random::new(4);
    for i in 0..15 {
        let s = f64::from(i) + 0.5;
        let noise = Vector3::from_fn(|_, _| 0.02 * random.normal());
        let place = (fixed_from_world * circles(s)).translation.vector + noise;
        let pose = Rigid3::translation(place.x, place.y, place.z);
        let time = Time::from_unix_seconds(1000.0) + Duration::from_seconds(s);
        sensors.push_fix(&FixedFramePoseData { time, fixed_from_tracking: Some(pose) });
        let odometry = OdometryData { time, odom_from_tracking: circles(s) };
        sensors.push_odometry(&odometry);
    }
    // The input is tilted by 3 degrees.
    let tilt = Rigid3::new(Vector3::zeros(), Vector3::new(0.05, -0.02, 0.0));
    let input: Vec<_> = truth.iter().map(|(time, pose)| (*time, tilt * pose)).collect();
    let refine = |gauge| {
        let options = ContinuousOptions { gauge, ..ContinuousOptions::default() };
        refine_continuous_with(&points, &sensors, &input, &options, &mut |_| true).unwrap()
    };
    let level = refine(Gauge::Gravity);
    let bias = Vector3::from(level.report.other_sensors.gyroscope_bias.unwrap());
    assert!((bias - Vector3::new(0.004, -0.006, 0.003)).norm() < 0.0003, "{bias} {:?}", level.report.imu);
    let level = level.trajectory;
    let up = level.pose(7.0).rotation * (truth[350].1.rotation.inverse() * Vector3::z());
    assert!(up.z > 0.9999, "{up}");
    assert!((level.pose(0.0).translation.vector - input[0].1.translation.vector).norm() < 1e-9);
    let placed = refine(Gauge::Fixes).trajectory;
    for s in [1.0, 7.0, 14.0] {
        let wanted = (fixed_from_world * circles(s)).translation.vector;
        let error = (placed.pose(s).translation.vector - wanted).norm();
        assert!(error < 0.05, "{error}");
    }
    let options = ContinuousOptions { gauge: Gauge::Fixes, ..ContinuousOptions::default() };
    assert!(refine_continuous(&points, &input, &options, &mut |_| true).is_err());
}
