use std::sync::Arc;

use portolan_geometry::{Point3f, Rigid3, Vector3, quaternion_from_angle_axis};
use portolan_issue::IssueKind;
use portolan_sensor::{SensorKind, TimedPoint};

use super::*;

/// Distance from `o` along `d` to a cube of 30 m around the origin and 100 balls of 0.5 m 10 m away.
fn cast(o: &Vector3, d: &Vector3) -> f64 {
    let wall = (0..3).map(|a| (15f64.copysign(d[a]) - o[a]) / d[a]).fold(f64::INFINITY, f64::min);
    (0..100).fold(wall, |nearest, i| {
        // Spread evenly over a sphere.
        let z: f64 = 1.0 - 2.0 * (f64::from(i) + 0.5) / 100.0;
        let (angle, radius) = (2.399963 * f64::from(i), (1.0 - z * z).sqrt());
        let to_center = Vector3::new(10.0 * radius * angle.cos(), 10.0 * radius * angle.sin(), 10.0 * z) - o;
        let along = to_center.dot(d);
        let apart = to_center.norm_squared() - along * along;
        if along > 0.0 && apart < 0.25 { nearest.min(along - (0.25 - apart).sqrt()) } else { nearest }
    })
}

/// Two scanners of 16 beams at right angles, all points at one time.
fn scan(local_from_tracking: &Rigid3, time: Time) -> TimedPointCloudData {
    let mut points = Vec::new();
    for turned in [false, true] {
        for i in 0..16 * 250 {
            let elevation = f64::from(i % 16 - 8) * 2f64.to_radians() + 0.01;
            let azimuth = f64::from(i / 16) / 250.0 * std::f64::consts::TAU + 0.003;
            let (s, c) = elevation.sin_cos();
            let ray = Vector3::new(c * azimuth.cos(), c * azimuth.sin(), s);
            let ray = if turned { Vector3::new(ray.x, -ray.z, ray.y) } else { ray };
            let range = cast(&local_from_tracking.translation.vector, &(local_from_tracking.rotation * ray));
            let position = Point3f::from((ray * range).cast::<f32>());
            points.push(TimedPoint { position, time: 0.0 });
        }
    }
    TimedPointCloudData {
        time,
        origin_in_tracking: Point3f::origin(),
        points_in_tracking: points,
        intensities: Vec::new(),
    }
}

/// Standing still, then along a corkscrew.
fn truth(t: f64) -> Rigid3 {
    let t = (t - 1.5).max(0.0);
    let translation = Vector3::new((4.0 * t).sin(), 1.0 - (4.0 * t).cos(), t);
    let turn = Vector3::new(1.0, -1.0, 2.0).normalize() * (0.3 * t);
    Rigid3::from_parts(translation.into(), quaternion_from_angle_axis(&turn))
}

fn options() -> TrajectoryBuilder3dOptions {
    let mut options = TrajectoryBuilder3dOptions {
        min_range: 0.5,
        max_range: 50.0,
        voxel_filter_size: 0.2,
        ..Default::default()
    };
    for filter in [
        &mut options.high_resolution_adaptive_voxel_filter,
        &mut options.low_resolution_adaptive_voxel_filter,
    ] {
        (filter.max_length, filter.min_num_points, filter.max_range) = (0.7, 200, 50.0);
    }
    let matcher = &mut options.ceres_scan_matcher;
    (matcher.occupied_space_weight_0, matcher.occupied_space_weight_1) = (5.0, 20.0);
    (matcher.translation_weight, matcher.rotation_weight) = (0.1, 0.3);
    matcher.ceres_solver_options.max_num_iterations = 20;
    let filter = &mut options.motion_filter;
    (filter.max_time_seconds, filter.max_distance_meters, filter.max_angle_radians) = (0.2, 0.02, 0.001);
    (options.submaps.high_resolution, options.submaps.low_resolution) = (0.2, 0.5);
    options.submaps.range_data_inserter.num_free_space_voxels = 0;
    options
}

fn run(with_imu: bool) -> (f64, usize, LocalSlam3d) {
    run_with(with_imu, &options(), None)
}

fn run_with(
    with_imu: bool,
    options: &TrajectoryBuilder3dOptions,
    plane_voxel_size: Option<f64>,
) -> (f64, usize, LocalSlam3d) {
    let sensor = SensorId { id: Arc::from("points"), kind: SensorKind::Range };
    let settings = LocalSlam3dSettings { use_all_odometry: true, plane_voxel_size, ..Default::default() };
    let mut slam = LocalSlam3d::new(options, std::slice::from_ref(&sensor), settings).unwrap();
    let (mut worst, mut matched) = (0.0f64, 0);
    let mut check = |results: Vec<MatchingResult<Space3d>>| {
        for result in results {
            let error = truth(result.time.ticks() as f64 * 1e-7).inverse() * result.local_from_tracking;
            worst = worst.max(error.translation.vector.norm()).max(error.rotation.angle());
            matched += 1;
        }
    };
    for i in 0..30 {
        // Slow enough for a prediction with constant velocity.
        let t = if i < 5 { 0.3 * f64::from(i) } else { 1.5 + 0.04 * f64::from(i - 5) };
        let time = Time::from_ticks((t * 1e7).round() as i64);
        if with_imu {
            let linear_acceleration = truth(t).rotation.inverse() * Vector3::new(0.0, 0.0, 9.81);
            let moving = if t > 1.5 { 0.3 } else { 0.0 };
            let angular_velocity = Vector3::new(1.0, -1.0, 2.0).normalize() * moving;
            slam.add_imu_data(&ImuData { time, linear_acceleration, angular_velocity });
        }
        check(slam.add_range_data(&sensor, scan(&truth(t), time)));
    }
    check(slam.flush());
    (worst, matched, slam)
}

#[test]
fn a_corkscrew_in_a_cube_is_followed() {
    let (worst, matched, mut slam) = run(true);
    assert!(worst < 0.1 && matched == 30, "{worst} {matched} {:?}", slam.issues());
    let finished = slam.finish();
    let submap = finished[0].finished.as_ref().unwrap();
    assert!(submap.insertion_finished && submap.num_range_data > 20);
    assert!(submap.rotational_histogram.iter().sum::<f32>() > 0.0);
    assert!(submap.high_resolution_grid.num_cells() > 1000);
}

#[test]
fn lidar_measures_the_rotation_without_an_imu() {
    let (worst, matched, slam) = run(false);
    assert!(worst < 0.1 && matched == 30, "{worst} {matched} {:?}", slam.issues());
}

#[test]
fn the_imu_based_extrapolator_follows_the_corkscrew_too() {
    let mut options = options();
    options.pose_extrapolator.use_imu_based = true;
    for gravity in [9.81, 0.0] {
        options.pose_extrapolator.imu_based.gravity_constant = gravity;
        let (worst, matched, slam) = run_with(true, &options, None);
        assert!(worst < 0.1 && matched == 30, "{worst} {matched} {:?}", slam.issues());
    }
}

#[test]
fn planes_are_followed_with_and_without_an_imu() {
    for with_imu in [true, false] {
        let (worst, matched, slam) = run_with(with_imu, &options(), Some(1.0));
        assert!(worst < 0.05 && matched == 30, "{with_imu} {worst} {matched} {:?}", slam.issues());
    }
}

#[test]
fn contradicting_options_and_empty_scans_are_refused() {
    let settings = LocalSlam3dSettings { use_all_odometry: true, ..Default::default() };
    let mut wrong = options();
    wrong.submaps.range_data_inserter.hit_probability = 0.4;
    assert!(LocalSlam3d::new(&wrong, &[], settings).is_err());
    let sensor = SensorId { id: Arc::from("points"), kind: SensorKind::Range };
    let mut slam = LocalSlam3d::new(&options(), std::slice::from_ref(&sensor), settings).unwrap();
    let time = Time::from_ticks(0);
    let empty = TimedPointCloudData {
        time,
        origin_in_tracking: Point3f::origin(),
        points_in_tracking: Vec::new(),
        intensities: vec![],
    };
    assert!(slam.add_range_data(&sensor, empty).is_empty());
    assert_eq!(slam.issues().count_of(IssueKind::ScanWithoutPoints), 1);
}
