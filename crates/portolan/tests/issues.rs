//! Faults of recordings and of known maps come out as issues with kinds, and lost data are seen wherever they were lost.
#![allow(clippy::unwrap_used)]

use portolan::geometry::{Duration, Time};
use portolan::issue::{Issue, IssueKind, IssueLog};
use portolan::job::{MapRequest, map, unobserved};
use portolan::mapping::{Mapper, MapperSettings, Space2d};
use portolan::pipeline::{KnownMap, map_recording, prepare};
use portolan::recording::{Header, LaserScan, MemoryRecording, Message, RecordedMessage};
use portolan::sensor::{ImuData, Measurement, SensorId, SensorKind};

const START: f64 = 1_700_000_000.0;

/// Scans of a square room at 10 Hz, with some stamps moved by seconds.
fn room(late: &[(u32, f64)]) -> MemoryRecording {
    let message = |i: u32| {
        let log_time = Time::from_unix_seconds(START + 0.1 * f64::from(i));
        let moved = late.iter().find(|(number, _)| *number == i).map_or(0.0, |(_, seconds)| *seconds);
        let increment = 0.01_f32;
        let wall = |k: u16| {
            let angle = increment * f32::from(k);
            // No two scans are the same.
            let noise = 1e-4 * f32::from(k + 7 * i as u16).sin();
            noise + 3.0 / angle.sin().abs().max(angle.cos().abs())
        };
        let scan = LaserScan {
            header: Header { stamp: log_time + Duration::from_seconds(moved), frame_id: "laser".into() },
            angle_min: 0.0,
            angle_max: 6.27,
            angle_increment: increment,
            time_increment: 0.0,
            scan_time: 0.1,
            range_min: 0.1,
            range_max: 30.0,
            ranges: (0..628).map(wall).collect(),
            intensities: Vec::new(),
        };
        RecordedMessage { topic: "/scan".into(), log_time, message: Message::LaserScan(scan) }
    };
    (0..60).map(message).collect()
}

fn mapped(known_issues: IssueLog, late: &[(u32, f64)]) -> (bool, Vec<Issue>) {
    let recording = room(late);
    let preparation = prepare(&recording, &Default::default(), None).unwrap();
    let known = KnownMap { issues: known_issues, ..KnownMap::<Space2d>::empty(&preparation.options) };
    let mapped = map_recording(
        &recording,
        &Default::default(),
        preparation,
        known,
        MapperSettings::default(),
        &mut |_| true,
    )
    .unwrap();
    (mapped.lost_data(), mapped.issues.list())
}

#[test]
fn losses_of_a_known_map_are_reported() {
    assert!(!mapped(IssueLog::default(), &[]).0);
    let mut issues = IssueLog::default();
    issues.add(IssueKind::UpdateMarker);
    assert!(!mapped(issues.clone(), &[]).0, "nothing is missing after that");
    issues.add(Issue::new(IssueKind::NodeUnplaced).of("known.pbstream"));
    let (lost, list) = mapped(issues, &[]);
    assert!(lost && list.iter().any(|issue| issue.to_string().starts_with("known.pbstream: node")));
}

#[test]
fn losses_in_mapping_are_reported() {
    let scans = SensorId::new(SensorKind::Range, "scan");
    let mut mapper = Mapper::<Space2d>::new(&Default::default(), MapperSettings::default()).unwrap();
    let id = mapper.add_trajectory(&[scans].into(), None).unwrap();
    let stranger = SensorId::new(SensorKind::Imu, "stranger");
    let sample = ImuData {
        time: Time::UNIX_EPOCH,
        linear_acceleration: Default::default(),
        angular_velocity: Default::default(),
    };
    mapper.add(id, &stranger, Measurement::Imu(sample)).unwrap();
    let (_, issues) = mapper.finish().unwrap();
    assert_eq!(issues.count_of(IssueKind::UnknownSensor), 1);
    assert!(issues.lost_data());
}

#[test]
fn the_report_has_kinds_sensors_and_times() {
    let folder = tempfile::tempdir().unwrap();
    let recording = room(&[(20, -0.45), (40, -0.45)]);
    let request = MapRequest::new(folder.path());
    let finished = map(&recording, request, &mut unobserved).unwrap();
    assert!(finished.summary.lost_data);
    let report = std::fs::read(folder.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let issues = report["issues"].as_array().unwrap();
    let late = issues.iter().find(|issue| issue["kind"] == "stamp_backward").unwrap();
    assert_eq!(
        (&late["severity"], &late["sensor"], &late["count"]),
        (&"error".into(), &"/scan".into(), &2.into())
    );
    let seconds = |name: &str| late[name].as_f64().unwrap() - START;
    assert!((seconds("from_s") - 1.55).abs() < 1e-6 && (seconds("to_s") - 3.55).abs() < 1e-6, "{late}");
    let text = "/scan: measurements with an earlier time than the one before were left out";
    assert_eq!(late["text"], text);
    assert_eq!(report["data_lost"], true);
}

#[test]
fn the_report_has_the_choices() {
    let folder = tempfile::tempdir().unwrap();
    let finished = map(&room(&[]), MapRequest::new(folder.path()), &mut unobserved).unwrap();
    assert!(!finished.summary.lost_data);
    let report = std::fs::read(folder.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let choices = report["choices"].as_array().unwrap();
    let texts: Vec<&str> = choices.iter().map(|choice| choice["what"].as_str().unwrap()).collect();
    assert!(texts.iter().any(|what| what.contains("laser")), "no robot's frame is known: {texts:?}");
}
