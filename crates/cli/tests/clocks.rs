//! `portolan check` names offsets between the clocks of lidar and IMU, where turns are gentle and nothing is straight.
#![allow(clippy::unwrap_used, clippy::panic)]

mod common;

use std::path::Path;

use common::{portolan, portolan_with_code, text};

/// What `check` says of the clocks of lidars and IMU in a recording.
fn told(recording: &str) -> Vec<String> {
    let run = portolan(&["check", recording, "-q"]);
    assert!(matches!(run.code, Some(0 | 1 | 3)), "{:?} {}", run.code, run.stderr);
    let lines =
        run.stdout.lines().filter(|line| line.contains("/points") && line.contains("stamps are about"));
    lines.map(str::to_owned).collect()
}

fn simulated(folder: &Path, arguments: &[&str]) -> String {
    let path = text(&folder.join("walk.mcap"));
    let usual = ["-o", &path, "-q", "--no-gnss", "--seconds", "30", "--beams", "200"];
    portolan_with_code(0, &[&["simulate"], arguments, &usual].concat());
    path
}

#[test]
fn offsets_are_found_among_trees_and_with_two_lidars() {
    for (offset, lidars, direction) in [(0.05, "1", "earlier"), (-0.02, "2", "later")] {
        let folder = tempfile::tempdir().unwrap();
        let fault = format!("clock:imu:{offset}");
        let path = simulated(folder.path(), &["park", "--lidars", lidars, "--fault", &fault]);
        let told = told(&path);
        assert_eq!(told.len(), lidars.parse::<usize>().unwrap(), "{told:?}");
        for line in told {
            let found = line.split("about ").nth(1).unwrap().split(' ').next().unwrap();
            let error = found.parse::<f64>().unwrap() - f64::abs(offset);
            assert!(error.abs() < 0.006 && line.contains(direction), "{offset}: {line}");
        }
    }
}

#[test]
fn clocks_that_agree_are_not_accused() {
    for world in ["park", "tunnel"] {
        let folder = tempfile::tempdir().unwrap();
        let told = told(&simulated(folder.path(), &[world]));
        assert!(told.is_empty(), "{world}: {told:?}");
    }
    if let Some(path) = common::shared("data/lidar3d/corridor_imu.bag") {
        assert!(told(&path).is_empty());
    }
}

#[test]
fn an_offset_that_is_known_is_taken_away() {
    let folder = tempfile::tempdir().unwrap();
    let path = simulated(folder.path(), &["museum", "--fault", "clock:imu:0.05"]);
    let truth = text(&folder.path().join("walk.truth.tum"));
    let heading_error = |more: &[&str]| {
        let output = text(&folder.path().join("map"));
        portolan_with_code(0, &[&["map", &path, "-o", &output, "-q", "--no-xray"], more].concat());
        let trajectory = format!("{output}/trajectory.tum");
        let run = portolan_with_code(0, &["evaluate", "trajectory", &trajectory, &truth, "--json"]);
        let errors: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        errors["absolute"]["rotation_degrees"]["rmse"].as_f64().unwrap()
    };
    let (as_it_is, moved) = (heading_error(&[]), heading_error(&["--time-offset", "/imu=-0.05"]));
    assert!(moved < 0.5 * as_it_is, "{moved} {as_it_is}");
}
