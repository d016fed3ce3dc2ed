//! Wheels and IMU against the truth.
#![allow(clippy::unwrap_used)] // helpers of tests fail as tests do

use portolan_geometry::nalgebra as na;
use portolan_geometry::{
    Rigid2, Rigid3, Time, Vector3, project_2d, quaternion_from_angle_axis, rotation_from_roll_pitch_yaw,
};
use portolan_recording::{Imu, Message, Odometry, Recording};
use portolan_simulator::sensors::{ImuOptions, OdometryOptions};
use portolan_simulator::{ScenarioOptions, Simulation};

fn messages<T>(simulation: &Simulation, topic: &str, take: impl Fn(Message) -> Option<T>) -> Vec<T> {
    let mut reader = simulation.read(&|info| &*info.topic == topic).unwrap();
    let mut taken = Vec::new();
    while let Some(recorded) = reader.next_message().unwrap() {
        taken.extend(take(recorded.message));
    }
    taken
}

fn imu_messages(simulation: &Simulation) -> Vec<Imu> {
    messages(simulation, "/imu", |m| if let Message::Imu(imu) = m { Some(imu) } else { None })
}

fn odometry_messages(simulation: &Simulation) -> Vec<Odometry> {
    messages(simulation, "/odom", |m| if let Message::Odometry(odometry) = m { Some(odometry) } else { None })
}

fn pose_2d(odometry: &Odometry) -> Rigid2 {
    let [x, y, _] = odometry.pose.position;
    let [_, _, z, w] = odometry.pose.orientation_xyzw;
    Rigid2::new(x, y, 2.0 * z.atan2(w))
}

fn truth(simulation: &Simulation, time: Time) -> Rigid2 {
    project_2d(&simulation.truth_at(time).unwrap())
}

/// Dead reckoning with the trapezoidal rule from the true state at the start.
fn integrate(samples: &[Imu], start: Rigid3, base_from_imu: &Rigid3) -> Rigid3 {
    let world_from_imu = start * base_from_imu;
    let mut rotation = world_from_imu.rotation;
    let (mut position, mut velocity) = (world_from_imu.translation.vector, Vector3::zeros());
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    for pair in samples.windows(2) {
        let dt = pair[1].header.stamp.seconds_since(pair[0].header.stamp);
        let omega = 0.5 * (Vector3::from(pair[0].angular_velocity) + Vector3::from(pair[1].angular_velocity));
        let next = rotation * quaternion_from_angle_axis(&(omega * dt));
        let before = rotation * Vector3::from(pair[0].linear_acceleration) + gravity;
        let after = next * Vector3::from(pair[1].linear_acceleration) + gravity;
        position += velocity * dt + (before / 3.0 + after / 6.0) * dt * dt;
        velocity += 0.5 * (before + after) * dt;
        rotation = next;
    }
    Rigid3::from_parts(na::Translation3::from(position), rotation) * base_from_imu.inverse()
}

#[test]
fn a_perfect_imu_integrates_to_the_truth() {
    let tilted = Rigid3::from_parts(
        na::Translation3::new(0.3, -0.2, 0.5),
        rotation_from_roll_pitch_yaw(0.4, -0.3, 1.1),
    );
    for base_from_imu in [Rigid3::identity(), tilted] {
        let imu = ImuOptions { rate: 200.0, base_from_imu, ..ImuOptions::default() }.without_noise();
        let options = ScenarioOptions { duration: Some(60.0), imu: Some(imu), ..ScenarioOptions::default() };
        let simulation = Simulation::new(options).unwrap();
        let samples = imu_messages(&simulation);
        assert_eq!(samples.len(), 12_001);
        let start = simulation.truth_at(simulation.start_time()).unwrap();
        let end = integrate(&samples, start, &base_from_imu);
        let last = samples.last().unwrap().header.stamp;
        let error = end.inverse() * simulation.truth_at(last).unwrap();
        assert!(error.translation.vector.norm() < 0.01 && error.rotation.angle() < 1e-4, "{error}");
        let walked = simulation.walk().state_2d(60.0).travelled;
        assert!(walked > 20.0);
    }
}

#[test]
fn imu_noise_and_bias_have_the_requested_size() {
    let imu = ImuOptions { rate: 100.0, ..ImuOptions::default() };
    let noise_deviation = imu.accelerometer_noise * 10.0;
    let mut biases = Vec::new();
    for seed in 0..30 {
        let options = ScenarioOptions {
            seed,
            duration: Some(20.0),
            rest: 30.0,
            imu: Some(imu.clone()),
            ..ScenarioOptions::default()
        };
        let samples = imu_messages(&Simulation::new(options).unwrap());
        let forces: Vec<f64> = samples.iter().map(|s| s.linear_acceleration[0]).collect();
        let mean = forces.iter().sum::<f64>() / forces.len() as f64;
        let variance = forces.iter().map(|f| (f - mean).powi(2)).sum::<f64>() / forces.len() as f64;
        assert!((variance.sqrt() / noise_deviation - 1.0).abs() < 0.1);
        let up = samples.iter().map(|s| s.linear_acceleration[2]).sum::<f64>() / samples.len() as f64;
        assert!((up - 9.81).abs() < 0.2);
        assert_eq!(samples[0].orientation_covariance[0], -1.0);
        biases.push(mean);
    }
    let deviation = (biases.iter().map(|b| b * b).sum::<f64>() / biases.len() as f64).sqrt();
    assert!((0.5..2.0).contains(&(deviation / imu.accelerometer_bias)), "{deviation}");
}

#[test]
fn perfect_wheels_follow_the_truth() {
    let options = ScenarioOptions { duration: Some(120.0), ..ScenarioOptions::default() }.without_noise();
    let simulation = Simulation::new(options).unwrap();
    let start = truth(&simulation, simulation.start_time());
    let odometry = odometry_messages(&simulation);
    assert_eq!(odometry.len(), 6001);
    for message in odometry.iter().step_by(50) {
        let error = (start * pose_2d(message)).inverse() * truth(&simulation, message.header.stamp);
        assert!(error.translation.norm() < 0.01 && error.normalized_angle().abs() < 1e-6);
        let state = simulation.motion_at(message.header.stamp).unwrap();
        assert!((message.linear_velocity[0] - state.velocity_in_map.norm()).abs() < 0.02);
    }
}

/// Largest error of odometry over 10 m of path, as a fraction, and per radian turned, on average.
fn drift(options: &OdometryOptions, seed: u64) -> (f64, f64) {
    let scenario = ScenarioOptions {
        seed,
        duration: Some(200.0),
        odometry: Some(options.clone()),
        ..ScenarioOptions::default()
    };
    let simulation = Simulation::new(scenario).unwrap();
    let odometry = odometry_messages(&simulation);
    let (mut translation, mut rotation, mut count) = (0.0, 0.0, 0.0);
    for (i, from) in odometry.iter().enumerate().step_by(500) {
        let travelled = |m: &Odometry| {
            let seconds = m.header.stamp.seconds_since(simulation.start_time());
            simulation.walk().state_2d(seconds).travelled
        };
        let Some(to) = odometry.iter().skip(i).find(|to| travelled(to) - travelled(from) >= 10.0) else {
            break;
        };
        let measured = pose_2d(from).inverse() * pose_2d(to);
        let exact = truth(&simulation, from.header.stamp).inverse() * truth(&simulation, to.header.stamp);
        let error = exact.inverse() * measured;
        translation += error.translation.norm() / 10.0;
        rotation += error.normalized_angle().abs() / 10.0;
        count += 1.0;
    }
    (translation / count, rotation / count)
}

#[test]
fn wheel_errors_are_plausible() {
    let usual = OdometryOptions::default();
    let mean = |options: &OdometryOptions| {
        let all: Vec<(f64, f64)> = (0..6).map(|seed| drift(options, seed)).collect();
        (all.iter().map(|d| d.0).sum::<f64>() / 6.0, all.iter().map(|d| d.1).sum::<f64>() / 6.0)
    };
    let (translation, rotation) = mean(&usual);
    // A few per cent and a few degrees in 10 m, as real wheels.
    assert!((0.01..0.12).contains(&translation), "{translation}");
    assert!((0.003..0.04).contains(&rotation), "{rotation} rad/m");
    let bad = OdometryOptions { slips_per_minute: 20.0, wheel_size_error: 0.03, ..usual };
    let (worse_translation, worse_rotation) = mean(&bad);
    assert!(worse_translation > 1.5 * translation && worse_rotation > 1.5 * rotation);
}
