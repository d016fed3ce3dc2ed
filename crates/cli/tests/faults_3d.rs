//! What goes wrong with recordings in 3D: each fault ends in a map or a named error, and `portolan check` names it.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use std::path::Path;

use common::{Run, portolan, portolan_with_code, simulated_once, survives_damage, text, trajectory_errors};
use portolan_geometry::{Duration, Time};
use portolan_recording::{
    FieldType, Header, Message, PointCloud2, PointField, RecordedMessage, RecordingFormat, create,
};
use portolan_testing::is_fast;

/// A short walk through a small museum, and its truth.
fn museum(more: &[&str]) -> (String, String) {
    let mut arguments = vec!["museum", "--no-gnss", "--size", "24x20", "--storeys", "1", "--people", "2"];
    arguments.extend(["--beams", "180"]);
    if !more.contains(&"--seconds") {
        arguments.extend(["--seconds", "24"]);
    }
    arguments.extend(more);
    simulated_once(&arguments)
}

#[track_caller]
fn mapped(recording: &str, folder: &Path, more: &[&str]) -> (Run, serde_json::Value) {
    let output = text(&folder.join("map"));
    let run = portolan(&[&["map", recording, "-o", &output, "--no-xray"], more].concat());
    assert!(matches!(run.code, Some(0 | 3)), "{:?} {}", run.code, run.stderr);
    let report = std::fs::read(folder.join("map/report.json")).unwrap();
    (run, serde_json::from_slice(&report).unwrap())
}

/// Largest error of a pose, metres.
fn worst(folder: &Path, truth: &str) -> f64 {
    let errors = trajectory_errors(&text(&folder.join("map/trajectory.tum")), truth);
    errors["absolute"]["translation"]["max"].as_f64().unwrap()
}

fn checked(recording: &str) -> String {
    let run = portolan(&["check", recording, "-v"]);
    assert!(matches!(run.code, Some(0 | 1 | 3)), "{:?} {}", run.code, run.stderr);
    run.stdout
}

/// Faults that a map survives: how far off it was when that was measured, at most, metres, and the words of `check`.
#[test]
fn faults_of_sensors_are_survived_and_named() {
    if is_fast() {
        return;
    }
    let cases: [(&str, &[&str], f64, &str); 9] = [
        ("none", &[], 0.0199, ""),
        ("gap in the IMU", &["--fault", "gap:imu:12:13"], 0.0248, "1 gap, 1.0"),
        // A gyroscope that is cut off in every turn misleads: the lidar takes over.
        ("saturation", &["--fault", "saturate:0.3:11"], 0.0271, "the end of its range"),
        ("a lidar that dies", &["--lidars", "2", "--fault", "dies:12"], 0.0088, "falls silent 12."),
        ("empty clouds", &["--fault", "empty:4"], 0.0129, "clouds of zero points"),
        ("points that are no numbers", &["--fault", "nan:4"], 0.0129, "not a number"),
        ("stamps years back", &["--fault", "backward:scan:5:100000000"], 0.0233, "jumps by"),
        ("repeated stamps", &["--fault", "duplicate:imu:7"], 0.0245, "two messages"),
        ("no times of points", &["--no-point-times"], 0.0179, "no time for each point"),
    ];
    for (name, arguments, measured, words) in cases {
        let folder = tempfile::tempdir().unwrap();
        let (recording, truth) = museum(arguments);
        let (run, report) = mapped(&recording, folder.path(), &[]);
        let error = worst(folder.path(), &truth);
        assert!(error <= 1.3 * measured, "{name}: {error} m, measured {measured} m\n{}", run.stderr);
        let lost = report["issues"].as_array().unwrap().iter().any(|issue| issue["severity"] == "error");
        assert_eq!(run.code == Some(3), lost, "{name}: {report}");
        let output = checked(&recording);
        assert!(output.contains(words), "{name}: {words} is not in\n{output}");
        if arguments.contains(&"dies:12") {
            assert!(run.stdout.contains("falls silent 12."), "{}", run.stdout);
        }
    }
}

/// An IMU that contradicts the lidar: the map need not be good, but `check` reports the reason.
#[test]
fn imus_that_contradict_the_lidar_are_named() {
    if is_fast() {
        return;
    }
    for (fault, words) in [("swap-axes", "gravity lies along"), ("no-gravity", "should include gravity")] {
        let output = checked(&museum(&["--fault", fault]).0);
        assert!(output.contains(words), "{fault}: {words} is not in\n{output}");
    }
    // The clouds are compared with the IMU: late stamps of the one are early stamps of the other.
    for (fault, direction) in [("clock:imu:0.05", "earlier"), ("clock:imu:-0.05", "later")] {
        let output = checked(&museum(&["--fault", fault]).0);
        let is_reported = |line: &&str| line.contains("as the rotation of both shows");
        let line = output.lines().find(is_reported).unwrap_or_else(|| panic!("{output}"));
        let found = line.split("about ").nth(1).unwrap().split(' ').next().unwrap().parse::<f64>().unwrap();
        // Measured: 0.049 s, printed to the millisecond.
        assert!((found - 0.05).abs() < 0.0025 && line.contains(direction), "{fault}: {line}");
    }
    let folder = tempfile::tempdir().unwrap();
    mapped(&museum(&["--fault", "swap-axes"]).0, folder.path(), &[]);
}

#[test]
fn damaged_recordings_in_3d_end_in_a_map_or_an_error() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (recording, _) = museum(&["--seconds", "5"]);
    survives_damage(&recording, folder.path(), &[0.001, 0.4, 0.97], 4, 300);
}

/// A cloud of a room of 12 m by 8 m by 3 m, of so many points.
fn room(seconds: f64, points: usize) -> RecordedMessage {
    let mut data = Vec::with_capacity(12 * points);
    for i in 0..points {
        let azimuth = i as f64 * 2.399_963;
        let (s, c) = azimuth.sin_cos();
        let slope = 0.6 * ((i % 1000) as f64 / 500.0 - 1.0);
        let wall = (6.0 / c.abs()).min(4.0 / s.abs());
        let distance = wall.min(1.5 / slope.abs().max(1e-3));
        for value in [c * distance, s * distance, slope * distance] {
            data.extend((value as f32).to_le_bytes());
        }
    }
    let field = |(i, name): (u32, &str)| PointField {
        name: name.to_owned(),
        offset: 4 * i,
        field_type: Some(FieldType::Float32),
        count: 1,
    };
    let stamp = Time::from_ros(1_700_000_000, 0) + Duration::from_seconds(seconds);
    let cloud = PointCloud2 {
        header: Header { stamp, frame_id: "lidar".into() },
        height: 1,
        width: points as u32,
        fields: (0..3).zip(["x", "y", "z"]).map(field).collect(),
        is_bigendian: false,
        point_step: 12,
        row_step: 12 * points as u32,
        data,
        is_dense: true,
    };
    RecordedMessage { topic: "/points".into(), log_time: stamp, message: Message::PointCloud2(cloud) }
}

#[test]
fn clouds_of_no_and_of_two_million_points_are_mapped() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge.bag");
    let mut writer = create(&path, None::<RecordingFormat>).unwrap();
    for i in 0..12 {
        let points = [20_000, 0, 2_000_000][if i % 3 == 2 && i > 6 { 2 } else { i % 2 }];
        writer.write(&room(0.1 * i as f64, points)).unwrap();
    }
    writer.finish().unwrap();
    let recording = text(&path);
    let (_, report) = mapped(&recording, folder.path(), &[]);
    assert!(report["nodes"].as_u64().unwrap() > 0, "{report}");
    let peak = report["memory_bytes"]["peak"].as_u64().unwrap_or(0);
    assert!(peak < 1_500_000_000, "{peak}");
    let output = checked(&recording);
    for words in ["clouds of zero points", "clouds of 2000000 points"] {
        assert!(output.contains(words), "{words} is not in\n{output}");
    }
}

/// The cloud has the points of the recording in each format, thinned if asked for, and the same bytes each time.
#[test]
fn maps_become_clouds_of_every_format() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (recording, _) = museum(&["--seconds", "6"]);
    let count = |name: &str, more: &[&str]| {
        let (run, report) = mapped(&recording, folder.path(), &[&["--cloud", name], more].concat());
        let path = folder.path().join("map").join(name);
        assert!(run.stdout.contains(name), "{}", run.stdout);
        let mut reader = portolan_pointcloud::open(&path).unwrap();
        let (mut batch, mut points) = (portolan_pointcloud::PointCloud::default(), 0);
        let mut far = 0;
        while reader.next_batch(&mut batch).unwrap() {
            points += batch.len() as u64;
            far += (0..batch.len()).filter(|i| batch.position(*i).iter().any(|v| v.abs() > 100.0)).count();
        }
        assert_eq!((points, far), (report["cloud"]["points_in_file"].as_u64().unwrap(), 0), "{name}");
        points
    };
    let all = count("map.ply", &[]);
    assert!(all > 50_000, "{all}");
    for name in ["map.pcd", "map.las", "map.laz", "map.e57", "map.xyz"] {
        assert_eq!(count(name, &[]), all, "{name}");
    }
    let bytes = |threads: &str| {
        let thinned = count("thin.ply", &["--cloud-voxel", "0.2", "--threads", threads]);
        assert!(thinned < all / 4, "{thinned} of {all}");
        std::fs::read(folder.path().join("map/thin.ply")).unwrap()
    };
    assert!(bytes("1") == bytes("2"));
    let wrong = |more: &[&str]| portolan_with_code(2, &[&["map", &recording], more].concat()).stderr;
    assert!(wrong(&["--cloud", "map.doc"]).contains(".laz"));
    assert!(wrong(&["--cloud", "map.ply", "--cloud-voxel", "0"]).contains("voxels must be"));
}
