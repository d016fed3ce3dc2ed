//! Poses while measurements come in, from drivers of one's own: no recording, no ROS, no configuration file.
//!
//! `cargo run --release -p portolan --example 02_local_slam_live`

use std::error::Error;
use std::io::Write;
use std::time::Duration;

use portolan::geometry::{self, Dimension, Point3f};
use portolan::mapping::{Mapper, MapperSettings, Space2d};
use portolan::recording::{LaserScan, Message, Odometry, Recording};
use portolan::sensor::{Measurement, OdometryData, SensorId, SensorKind, TimedPoint, TimedPointCloudData};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;
use portolan::{Lidar, Sensors, settings_for};

/// What `cargo run` and the test of the examples call.
pub fn main() -> Result<(), Box<dyn Error>> {
    let options = ScenarioOptions { duration: Some(15.0), ..ScenarioOptions::new(Scene::Office, 1) };
    let simulation = Simulation::new(options)?;
    let lidar = Lidar {
        angular_resolution_radians: 1.0_f64.to_radians(),
        median_range_metres: 3.0,
        max_range_metres: 12.0,
        scans_hz: 10.0,
    };
    let sensors = Sensors { has_odometry: true, ..Sensors::new(Dimension::TwoD, lidar, "base_link") };
    // A measurement never waits for the pose graph, which works in threads of its own.
    let live = MapperSettings { max_wait: Duration::ZERO, ..MapperSettings::default() };
    let mut mapper = Mapper::<Space2d>::new(&settings_for(&sensors), live)?;
    let scanner = SensorId::new(SensorKind::Range, "scanner");
    let wheels = SensorId::new(SensorKind::Odometry, "wheels");
    let trajectory = mapper.add_trajectory(&[scanner.clone(), wheels.clone()].into(), None)?;

    // The simulation stands for drivers.
    let mut drivers = simulation.read(&|_| true)?;
    let (mut scans, mut last) = (0, None);
    while let Some(message) = drivers.next_message()? {
        let measured = match &message.message {
            Message::LaserScan(scan) => Some((&scanner, range(scan))),
            Message::Odometry(message) => odometry(message).map(|pose| (&wheels, pose)),
            _ => None,
        };
        let Some((sensor, measurement)) = measured else { continue };
        let matched = mapper.add(trajectory, sensor, measurement)?;
        scans += matched.len();
        last = matched.last().map(|scan| (scan.time, scan.local_from_tracking)).or(last);
    }
    mapper.finish_trajectory(trajectory)?;
    let (time, pose) = last.ok_or("not a single scan was matched")?;
    let mut out = std::io::stdout();
    writeln!(out, "{scans} scans; at {:.1} s: {:?}", time.unix_seconds(), pose.translation.vector)?;
    // The map with its loop closures; `portolan::mapfile::write_map` saves it.
    let (map, _) = mapper.finish()?;
    Ok(writeln!(out, "{} nodes in the map", map.node_poses(trajectory).len())?)
}

/// Points in the tracking frame, each with its time before the last one, seconds.
fn range(scan: &LaserScan) -> Measurement {
    // Where this scanner sits on the robot, metres.
    let origin_in_tracking = Point3f::new(0.12, 0.0, 0.2);
    let duration = scan.time_increment * scan.ranges.len().saturating_sub(1) as f32;
    let point = |(i, range): (usize, &f32)| {
        let (sin, cos) = (scan.angle_min + i as f32 * scan.angle_increment).sin_cos();
        let position = origin_in_tracking + geometry::Vector3f::new(range * cos, range * sin, 0.0);
        let is_return = (scan.range_min..=scan.range_max).contains(range);
        is_return.then_some(TimedPoint { position, time: i as f32 * scan.time_increment - duration })
    };
    let points_in_tracking = scan.ranges.iter().enumerate().filter_map(point).collect();
    let time = scan.header.stamp + geometry::Duration::from_seconds(f64::from(duration));
    let intensities = Vec::new();
    Measurement::Range(TimedPointCloudData { time, origin_in_tracking, points_in_tracking, intensities })
}

/// None if it is no valid pose.
fn odometry(message: &Odometry) -> Option<Measurement> {
    let pose = &message.pose;
    let odom_from_tracking = geometry::pose_from_xyz_quaternion(pose.position, pose.orientation_xyzw)?;
    Some(Measurement::Odometry(OdometryData { time: message.header.stamp, odom_from_tracking }))
}
