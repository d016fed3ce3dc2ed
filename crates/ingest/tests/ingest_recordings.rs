//! Real recordings as measurements.

#![allow(clippy::unwrap_used, clippy::panic)] // failures of tests are panics

use portolan_geometry::{Dimension, Time, rotation_angle};
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_recording::{Message, RecordedMessage, Recording, open};
use portolan_sensor::{Measurement, SensorId};
use portolan_testing::real_data;

fn messages(recording: &dyn Recording) -> Vec<RecordedMessage> {
    let mut reader = recording.read(&|_| true).unwrap();
    std::iter::from_fn(|| reader.next_message().unwrap()).collect()
}

fn measurements(recording: &dyn Recording) -> (Vec<(SensorId, Measurement)>, Ingestion) {
    let mut ingestion = Ingestion::new(recording, &IngestOptions::default()).unwrap();
    let found: Vec<_> = ingestion.by_ref().map(Result::unwrap).collect();
    (found, ingestion)
}

/// The messages are the same and stand in the same order, except that those of one time may stand in any
/// order (ingestion gives them in order of topic).
fn assert_same(name: &str, a: &[RecordedMessage], b: &[RecordedMessage], except_static: bool) {
    let sorted = |messages: &[RecordedMessage]| {
        let mut messages = messages.to_vec();
        messages.sort_by_key(|m| (m.log_time, m.topic.clone()));
        messages
    };
    let (a, b) = (sorted(a), sorted(b));
    assert_eq!(a.len(), b.len(), "{name}");
    for (i, (a, b)) in a.iter().zip(&b).enumerate() {
        assert_eq!((&a.topic, a.log_time), (&b.topic, b.log_time), "{name}: message {i}");
        if !(except_static && matches!(a.message, Message::Tf(_))) {
            assert!(a.message == b.message, "{name}: message {i} on {}", a.topic);
        }
    }
}

#[test]
fn three_forms_of_aces_hold_the_same_messages() {
    let (Some(log), Some(bag), Some(mcap)) = (
        real_data("lidar2d/aces/aces.clf.bz2"),
        real_data("lidar2d/aces/aces.bag"),
        real_data("lidar2d/aces/aces_ros2"),
    ) else {
        return;
    };
    let (first, _) = measurements(&*open(&log).unwrap());
    for other in [&bag, &mcap] {
        assert!(measurements(&*open(other).unwrap()).0 == first, "{}", other.display());
    }
    let log = messages(&*open(log).unwrap());
    assert_same("aces.bag", &log, &messages(&*open(bag).unwrap()), false);
    assert_same("aces_ros2", &log, &messages(&*open(mcap).unwrap()), false);
}

#[test]
fn both_forms_of_fr079_hold_the_same_messages() {
    let (Some(log), Some(bag)) =
        (real_data("lidar2d/fr079/fr079.clf.bz2"), real_data("lidar2d/fr079/fr079.bag"))
    else {
        return;
    };
    // The log knows that the scanner sits 4 cm behind the middle of the robot; the bag does not.
    assert_same("fr079.bag", &messages(&*open(log).unwrap()), &messages(&*open(bag).unwrap()), true);
}

#[test]
fn a_robot_in_2d_is_understood() {
    let Some(path) = real_data("lidar2d/aces/aces.clf.bz2") else { return };
    let (found, ingestion) = measurements(&*open(path).unwrap());
    let plan = ingestion.plan();
    assert_eq!((plan.dimension, plan.tracking_frame.as_str()), (Dimension::TwoD, "base_link"));
    let names: Vec<String> = ingestion.sensors().iter().map(|s| s.id.to_string()).collect();
    assert_eq!(names, ["odom", "scan"]);
    assert_eq!(found.len(), 2 * 7374);
    let statistics = &plan.range[0].statistics;
    assert_eq!(statistics.readings, 180);
    assert!((statistics.rate - 5.4).abs() < 2.5, "{statistics:?}");
    assert_eq!(statistics.saturation_range, Some(50.0));
    assert!(ingestion.issues().iter().all(|r| !r.lost_data()), "{:?}", ingestion.issues());
}

#[test]
fn the_last_second_is_processed() {
    let Some(path) = real_data("lidar3d/corridor_imu.bag") else { return };
    let recording = open(path).unwrap();
    let (_, last) = recording.time_range().unwrap();
    let (found, ingestion) = measurements(&*recording);
    let plan = ingestion.plan();
    assert_eq!((plan.dimension, plan.tracking_frame.as_str()), (Dimension::ThreeD, "imu_link"));
    assert!(plan.imu.is_some() && plan.odometry.is_none());
    let last_scan = found.iter().rev().find(|m| matches!(m.1, Measurement::Range(_))).unwrap().1.time();
    assert!(last.seconds_since(last_scan) < 0.2);
    let Measurement::Range(first) = &found.iter().find(|m| matches!(m.1, Measurement::Range(_))).unwrap().1
    else {
        panic!()
    };
    // The stamp is that of the end of the sweep, and the scanner sits at (0.05, 0, 0.25).
    assert!((first.time.seconds_since(Time::from_ros(1_500_000_000, 100_000_000))).abs() < 1e-3);
    assert!(
        (first.origin_in_tracking.x - 0.05).abs() < 1e-6 && (first.origin_in_tracking.z - 0.25).abs() < 1e-6
    );
    assert!(first.points_in_tracking.iter().all(|p| p.time <= 0.0 && p.time > -0.11));
    let statistics = ingestion.statistics();
    assert!((statistics.imu.unwrap().rate - 200.0).abs() < 1.0);
    assert!((statistics.range[0].1.sweep_duration - 0.1).abs() < 0.01, "{:?}", statistics.range);
}

#[test]
fn stamps_at_the_start_of_a_sweep_become_those_of_its_end() {
    let Some(path) = real_data("lidar3d/walk.bag") else { return };
    let (found, ingestion) = measurements(&*open(path).unwrap());
    assert_eq!(ingestion.plan().tracking_frame, "lidar");
    assert_eq!(found.len(), 1016);
    let Measurement::Range(first) = &found[0].1 else { panic!() };
    let delay = first.time.seconds_since(Time::from_ros(1_600_000_000, 0));
    assert!(delay > 0.05 && delay < 0.11, "{delay}");
    let points: usize = found
        .iter()
        .map(|(_, m)| if let Measurement::Range(r) = m { r.points_in_tracking.len() } else { 0 })
        .sum();
    assert!(points > 2_900_000, "{points}");
}

#[test]
fn clouds_without_times_are_instants() {
    let Some(path) = real_data("lidar3d/kitti_0001.bag") else { return };
    let mut ingestion = Ingestion::new(&*open(path).unwrap(), &IngestOptions::default()).unwrap();
    let (_, Measurement::Range(first)) = ingestion.next().unwrap().unwrap() else { panic!() };
    assert!(first.points_in_tracking.len() > 100_000);
    assert!(!ingestion.statistics().range[0].1.has_point_times());
    assert_eq!(ingestion.plan().dimension, Dimension::ThreeD);
}

#[test]
fn odometry_may_be_in_transforms() {
    let Some(path) = real_data("ros_bags/evo_tf_example.bag") else { return };
    // It has transforms only: no sensor to map with; the error names them.
    let error = Ingestion::new(&*open(path).unwrap(), &IngestOptions::default()).err().unwrap().to_string();
    assert!(error.contains("/tf"), "{error}");
    let Some(path) = real_data("ros_bags/scan_tools_demo.bag") else { return };
    let (found, ingestion) = measurements(&*open(path).unwrap());
    assert!(
        found.iter().filter(|m| matches!(m.1, Measurement::Range(_))).count() > 200,
        "{:?}",
        ingestion.issues()
    );
}

#[test]
fn dead_reckoning_of_coreslam_agrees_with_its_scans() {
    let Some(path) = real_data("lidar2d/coreslam/exp1.dat") else { return };
    let (found, ingestion) = measurements(&*open(path).unwrap());
    assert!(ingestion.plan().odometry.as_ref().is_some_and(|odometry| odometry.topic().is_some()));
    let poses: Vec<_> = found
        .iter()
        .filter_map(|(_, m)| if let Measurement::Odometry(o) = m { Some(o.odom_from_tracking) } else { None })
        .collect();
    let path: f64 = poses.windows(2).map(|w| (w[0].inverse() * w[1]).translation.vector.norm()).sum();
    assert!((40.0..50.0).contains(&path), "{path}");
    assert!(poses.windows(2).all(|w| rotation_angle(&(w[0].inverse() * w[1])) < 0.5));
}
