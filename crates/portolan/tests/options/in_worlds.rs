//! What options do to whole runs through small worlds, where not just anything may change.

use portolan::config::Options;
use portolan::geometry::{Point3f, Rigid3, Vector3};
use portolan::mapping::Space3d;
use portolan::sensor::{FixedFramePoseData, Measurement, TimedPoint, TimedPointCloudData};

use crate::local_3d::base;
use crate::run::{Run, run};
use crate::world::{at, imu, odometry, on_circle, scan_3d};

/// Half of the width and of the height of a tunnel along x, metres.
const TUNNEL: [f64; 2] = [2.0, 1.5];
/// Farther than this nothing is seen in it, metres.
const SIGHT: f64 = 5.0;

/// Seen from `x` in a bare tunnel whose walls are now brighter, now darker.
fn scan_in_tunnel(x: f64, seconds: f64) -> TimedPointCloudData {
    let (mut points, mut intensities) = (Vec::new(), Vec::new());
    for i in 0..300 * 40 {
        let azimuth = std::f64::consts::TAU * (f64::from(i / 40) + 0.5) / 300.0;
        let (sin, cos) = (0.04 * (f64::from(i % 40) - 19.5)).sin_cos();
        let beam = Vector3::new(cos * azimuth.cos(), cos * azimuth.sin(), sin);
        let length = (TUNNEL[0] / beam.y.abs()).min(TUNNEL[1] / beam.z.abs());
        if length < SIGHT {
            let bright = std::f64::consts::TAU * (x + beam.x * length) / 3.0;
            points.push(TimedPoint { position: Point3f::from((beam * length).cast::<f32>()), time: 0.0 });
            intensities.push((20.0 + 15.0 * bright.sin()) as f32);
        }
    }
    TimedPointCloudData {
        time: at(seconds),
        origin_in_tracking: Point3f::origin(),
        points_in_tracking: points,
        intensities,
    }
}

/// How far along the tunnel local SLAM believes to be after 1.5 m.
fn mapped_tunnel_length(options: &Options) -> f64 {
    let mut measurements = vec![Measurement::Imu(imu(-0.01, 0.0, 0.0))];
    for step in 0..35 {
        let seconds = 0.1 * f64::from(step);
        measurements.push(Measurement::Imu(imu(seconds + 0.001, 0.0, 0.0)));
        let x = 0.06 * f64::from((step - 9).max(0));
        measurements.push(Measurement::Range(scan_in_tunnel(x, seconds)));
    }
    let run: Run<Space3d> = run(options, measurements);
    run.last_pose().translation.x
}

#[test]
fn brightness_constrains_motion_in_a_bare_tunnel() {
    let mut options = base();
    for setting in [
        "trajectory_builder_3d.submaps.num_range_data=40",
        "trajectory_builder_3d.submaps.high_resolution=0.2",
        "trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1",
        "trajectory_builder_3d.submaps.range_data_inserter.intensity_threshold=40",
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.intensity_threshold=40",
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.weight=20",
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.huber_scale=100",
    ] {
        options.set(setting).unwrap();
    }
    let without = mapped_tunnel_length(&options);
    options.set("use_intensities=true").unwrap();
    let with = mapped_tunnel_length(&options);
    // Means over cells of 0.2 m lag behind.
    assert!((1.0..1.7).contains(&with) && without < 0.2, "1.5 m: {with} m with, {without} m without");
    // Walls that are all implausibly bright give no information.
    let threshold =
        "trajectory_builder_3d.ceres_scan_matcher.intensity_cost_function_options_0.intensity_threshold=4";
    options.set(threshold).unwrap();
    let blinded = mapped_tunnel_length(&options);
    assert!(blinded < 0.2, "{blinded}");
}

/// By how much optimisation lifts nodes at most, on a level circle of which satellites say that it climbs by
/// 0.4 m/s.
fn lifted(options: &Options) -> f64 {
    let mut measurements = vec![Measurement::Imu(imu(0.0, 0.0, 0.4))];
    for step in 1..=60 {
        let seconds = 0.1 * f64::from(step);
        measurements.push(Measurement::Imu(imu(seconds, 0.0, 0.4)));
        measurements.push(Measurement::Odometry(odometry(on_circle(seconds), seconds)));
        if step % 5 == 0 {
            let climbing = Rigid3::translation(0.0, 0.0, 0.4 * seconds) * on_circle(seconds);
            measurements.push(Measurement::FixedFramePose(FixedFramePoseData {
                time: at(seconds),
                fixed_from_tracking: Some(climbing),
            }));
            measurements.push(Measurement::Range(scan_3d(&on_circle(seconds), seconds)));
        }
    }
    let run: Run<Space3d> = run(options, measurements);
    let nodes = run.map.graph.state().nodes.values();
    let height = |pose: &Rigid3| pose.translation.z;
    let lifted = nodes.map(|n| (height(&n.map_from_tracking) - height(&n.data.local_from_tracking)).abs());
    lifted.fold(0.0, f64::max)
}

#[test]
fn a_map_of_one_level_remains_level_despite_satellite_heights() {
    let mut options = base();
    for setting in [
        "optimization_problem.fixed_frame_pose_translation_weight=1e6",
        "optimization_problem.fixed_frame_pose_use_tolerant_loss=false",
    ] {
        options.set(setting).unwrap();
    }
    let free = lifted(&options);
    options.set("fix_z_in_3d=true").unwrap();
    let fixed = lifted(&options);
    assert!(free > 0.3 && fixed < 1e-6, "free: {free} m, fixed: {fixed} m");
}
