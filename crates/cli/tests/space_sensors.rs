//! Sensors besides lidar and IMU in space: two lidars with their own clocks, wheels, satellites, landmarks.
#![allow(clippy::unwrap_used)]

mod common;

use std::path::Path;

use common::{portolan_with_code, text};

/// Simulates, maps with these settings, and gives the summary of the map and the error against the truth, metres.
fn mapped(folder: &Path, scene: &[&str], settings: &[&str]) -> (serde_json::Value, f64) {
    let [recording, output] = ["walk.mcap", "map"].map(|name| text(&folder.join(name)));
    let simulation = ["-o", &recording, "--beams", "180", "--lidars", "2", "--seed", "3", "-q"];
    portolan_with_code(0, &[&["simulate"], scene, &simulation].concat());
    let map = ["map", &recording, "-o", &output, "-q", "--no-xray"];
    portolan_with_code(0, &[&map, settings].concat());
    let info = portolan_with_code(0, &["info", "--json", &format!("{output}/map.pbstream")]);
    let info = serde_json::from_str::<serde_json::Value>(&info.stdout).unwrap()[0].take();
    let truth = text(&folder.join("walk.truth.tum"));
    let trajectory = format!("{output}/trajectory.tum");
    let errors = portolan_with_code(0, &["evaluate", "trajectory", &trajectory, &truth, "--json"]);
    let errors: serde_json::Value = serde_json::from_str(&errors.stdout).unwrap();
    (info, errors["absolute"]["translation"]["rmse"].as_f64().unwrap())
}

#[test]
fn wheels_and_satellites_tie_a_map_outdoors() {
    let folder = tempfile::tempdir().unwrap();
    let scene = ["park", "--size", "40x40", "--seconds", "20"];
    let (info, error) = mapped(folder.path(), &scene, &["--gnss"]);
    let trajectory = &info["trajectories"][0];
    for (kind, least) in [("odometry_data", 500), ("fixed_frame_pose_data", 50), ("imu_data", 3000)] {
        assert!(trajectory["sensor_data"][kind].as_u64().unwrap() > least, "{kind}: {trajectory}");
    }
    assert_eq!(trajectory["has_fixed_frame"], true);
    let lidars = trajectory["sensors"].as_array().unwrap().iter().filter(|s| s["kind"] == "RANGE");
    assert_eq!(lidars.count(), 2);
    assert!(error < 0.1, "{error}");
}

#[test]
fn landmarks_become_part_of_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let scene = ["museum", "--size", "24x20", "--storeys", "1", "--seconds", "20", "--landmarks"];
    let (info, error) = mapped(folder.path(), &scene, &[]);
    assert!(info["landmarks"].as_u64().unwrap() > 0, "{info}");
    assert!(info["trajectories"][0]["sensor_data"]["landmark_data"].as_u64().unwrap() > 0, "{info}");
    assert!(error < 0.1, "{error}");
}
