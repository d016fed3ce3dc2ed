//! Sensors besides lidar and IMU in 3D: two lidars with their own clocks, wheels, satellites, landmarks.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{portolan_with_code, simulated_once, text, trajectory_errors};
use portolan_testing::is_fast;

/// Simulates, maps with these settings, and gives the summary of the map and the error against the truth, metres.
fn mapped(scene: &[&str], settings: &[&str]) -> (serde_json::Value, f64) {
    let (recording, truth) =
        simulated_once(&[scene, &["--beams", "180", "--lidars", "2", "--seed", "3"]].concat());
    let folder = tempfile::tempdir().unwrap();
    let output = text(folder.path());
    let map = ["map", &recording, "-o", &output, "-q", "--no-xray"];
    portolan_with_code(0, &[&map, settings].concat());
    let info = portolan_with_code(0, &["info", "--json", &format!("{output}/map.pbstream")]);
    let info = serde_json::from_str::<serde_json::Value>(&info.stdout).unwrap()[0].take();
    let errors = trajectory_errors(&format!("{output}/trajectory.tum"), &truth);
    (info, errors["absolute"]["translation"]["rmse"].as_f64().unwrap())
}

#[test]
fn wheels_and_satellites_constrain_a_map_outdoors() {
    if is_fast() {
        return;
    }
    let scene = ["park", "--size", "40x40", "--seconds", "20"];
    let (info, error) = mapped(&scene, &["--gnss"]);
    let trajectory = &info["trajectories"][0];
    for (kind, least) in [("odometry_data", 500), ("fixed_frame_pose_data", 50), ("imu_data", 3000)] {
        assert!(trajectory["sensor_data"][kind].as_u64().unwrap() > least, "{kind}: {trajectory}");
    }
    assert_eq!(trajectory["has_fixed_frame"], true);
    let lidars = trajectory["sensors"].as_array().unwrap().iter().filter(|s| s["kind"] == "RANGE");
    assert_eq!(lidars.count(), 2);
    // Measured: 0.0050 m.
    assert!(error <= 0.0062, "{error}");
}

#[test]
fn landmarks_become_part_of_the_map() {
    if is_fast() {
        return;
    }
    let scene = ["museum", "--size", "24x20", "--storeys", "1", "--seconds", "20", "--landmarks"];
    let (info, error) = mapped(&scene, &[]);
    assert!(info["landmarks"].as_u64().unwrap() > 0, "{info}");
    assert!(info["trajectories"][0]["sensor_data"]["landmark_data"].as_u64().unwrap() > 0, "{info}");
    // Measured: 0.0028 m.
    assert!(error <= 0.0036, "{error}");
}
