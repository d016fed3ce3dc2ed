//! Predicted poses of a robot in 3D before its scan is matched.

use portolan::config::Options;
use portolan::geometry::{Rigid3, rotation_angle};
use portolan::mapping::Space3d;
use portolan::sensor::{Measurement, TimedPointCloudData};

use crate::effect::{Effect, check, effects};
use crate::local_3d::{base, roll, scans};
use crate::run::run;
use crate::world::{dense_scan, distance, imu, odometry, on_circle, pose, scan_3d};

/// Level for a second, then the accelerometer alone says that the robot leans; what the last node believes.
fn roll_after_leaning(options: &Options) -> f64 {
    let mut measurements = Vec::new();
    for step in 0..40 {
        let seconds = 0.05 * f64::from(step);
        let mut sample = imu(seconds, if seconds < 1.0 { 0.0 } else { 0.2 }, 0.0);
        sample.angular_velocity.fill(0.0);
        measurements.push(Measurement::Imu(sample));
        if step % 10 == 9 {
            measurements.push(Measurement::Range(scan_3d(&pose(0.0, 0.0, 0.0), seconds)));
        }
    }
    let run = run::<Space3d>(options, measurements);
    roll(&run.map.graph.state().nodes.values().next_back().unwrap().data.gravity_alignment)
}

/// Leaves so little of a scan that it is put where predicted.
fn blind(scan: &mut TimedPointCloudData) {
    scan.points_in_tracking.truncate(1);
    scan.intensities.truncate(1);
    scan.points_in_tracking[0].position = [1.5, 0.0, 1.0].into();
}

/// At rest, then 0.5 m/s ahead, well matched; the last scan sees next to nothing, so that it is put where
/// predicted.
fn predicted_distance(options: &Options) -> f64 {
    let mut options = options.clone();
    for setting in [
        "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_0=30",
        "trajectory_builder_3d.ceres_scan_matcher.occupied_space_weight_1=30",
        "trajectory_builder_3d.ceres_scan_matcher.translation_weight=0.1",
        "trajectory_builder_3d.submaps.range_data_inserter.hit_probability=0.9",
        "trajectory_builder_3d.submaps.range_data_inserter.miss_probability=0.4",
        "trajectory_builder_3d.voxel_filter_size=0.05",
    ] {
        options.set(setting).unwrap();
    }
    let place = |step: u32| pose(0.1 * f64::from(step.saturating_sub(6)), 0.0, 0.0);
    let mut clouds: Vec<_> = (0..9).map(|step| dense_scan(&place(step), 0.2 * f64::from(step))).collect();
    let mut last = scan_3d(&place(9), 1.8);
    blind(&mut last);
    clouds.push(last);
    scans(&options, clouds).last_pose().translation.x
}

/// Places of scans that are put where predicted: with odometry, in a curve at changing speed.
fn error_with_odometry(options: &Options) -> f64 {
    let mut options = options.clone();
    options.set("trajectory_builder_3d.ceres_scan_matcher.translation_weight=1e6").unwrap();
    let place = |seconds: f64| on_circle(0.5 * seconds * seconds);
    let mut measurements = Vec::new();
    for step in 0..=30 {
        let seconds = 0.1 * f64::from(step);
        measurements.push(Measurement::Imu(imu(seconds, 0.0, 0.4 * seconds)));
        measurements.push(Measurement::Odometry(odometry(place(seconds), seconds)));
        if step % 10 == 0 {
            measurements.push(Measurement::Range(scan_3d(&place(seconds), seconds)));
        }
    }
    let run = run::<Space3d>(&options, measurements);
    let (first, last) = (run.results[0].local_from_tracking, run.last_pose());
    ((first.inverse() * last).translation.vector.norm() - distance(&place(0.0), &place(3.0))).abs()
}

/// Along a line, then a scan that sees next to nothing, so that it is put where predicted; meanwhile IMU and
/// odometry contradict each other, the more the wilder.
fn predicted(options: &Options, wild: f64) -> Rigid3 {
    let mut options = options.clone();
    for setting in [
        "trajectory_builder_3d.ceres_scan_matcher.translation_weight=1000",
        "trajectory_builder_3d.motion_filter.max_time_seconds=0.01",
    ] {
        options.set(setting).unwrap();
    }
    let mut measurements = Vec::new();
    for step in 0..=60 {
        let seconds = 0.02 * f64::from(step);
        let is_late = step > 50;
        let mut sample = imu(seconds, 0.0, if is_late { 0.5 * wild } else { 0.0 });
        sample.linear_acceleration.x = if is_late { 1.0 } else { 0.0 };
        measurements.push(Measurement::Imu(sample));
        let truth = pose(0.3 * seconds, 0.0, 0.0);
        let drifting = pose(0.5 * seconds, 0.1 * seconds, -0.2 * wild * seconds);
        measurements.push(Measurement::Odometry(odometry(drifting, seconds)));
        if step % 10 != 0 {
            continue;
        }
        let mut scan = scan_3d(&truth, seconds);
        if step == 60 {
            blind(&mut scan);
        }
        measurements.push(Measurement::Range(scan));
    }
    run::<Space3d>(&options, measurements).last_pose()
}

/// One number for a predicted pose.
fn prediction(options: &Options) -> f64 {
    let pose = predicted(options, 1.0);
    pose.translation.vector.sum() + 10.0 * rotation_angle(&pose)
}

/// The sum of several that are hard to fit.
fn hard_predictions(options: &Options) -> f64 {
    [5.0, 15.0, 25.0, 40.0].map(|wild| predicted(options, wild).translation.vector.sum()).iter().sum()
}

pub fn table() -> Vec<Effect> {
    let mut table = by_velocity();
    table.extend(by_optimisation());
    table
}

fn by_velocity() -> Vec<Effect> {
    effects! {
        "trajectory_builder_3d.pose_extrapolator.constant_velocity.imu_gravity_time_constant", "0.1" => "100", Falls, roll_after_leaning;
        "trajectory_builder_3d.pose_extrapolator.constant_velocity.pose_queue_duration", "0.001" => "1", Falls, predicted_distance;
        "portolan.use_all_odometry", "false" => "true", Falls, error_with_odometry;
        "trajectory_builder_3d.pose_extrapolator.use_imu_based", "false" => "true", Changes, prediction;
    }
}

fn by_optimisation() -> Vec<Effect> {
    effects! {
        "trajectory_builder_3d.pose_extrapolator.imu_based.pose_queue_duration", "0.3" => "5", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.gravity_constant", "9.806" => "8", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.pose_translation_weight", "0.01" => "100", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.pose_rotation_weight", "0.01" => "100", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.imu_acceleration_weight", "0.01" => "100", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.imu_rotation_weight", "0.01" => "100", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.odometry_translation_weight", "0.01" => "100", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.odometry_rotation_weight", "0.01" => "100", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.solver_options.max_num_iterations", "1" => "10", Changes, prediction;
        "trajectory_builder_3d.pose_extrapolator.imu_based.solver_options.use_nonmonotonic_steps", "false" => "true", Changes, hard_predictions,
            ["trajectory_builder_3d.pose_extrapolator.imu_based.odometry_rotation_weight=100", "trajectory_builder_3d.pose_extrapolator.imu_based.imu_rotation_weight=100",
             "trajectory_builder_3d.pose_extrapolator.imu_based.imu_acceleration_weight=100", "trajectory_builder_3d.pose_extrapolator.imu_based.solver_options.max_num_iterations=50"];
    }
}

#[test]
fn options_of_predicting_in_3d_have_their_effects() {
    check(&base(), &by_velocity());
    let mut options = base();
    options.set("trajectory_builder_3d.pose_extrapolator.use_imu_based=true").unwrap();
    check(&options, &by_optimisation());
}
