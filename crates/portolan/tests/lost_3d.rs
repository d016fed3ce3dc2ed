//! 3D recordings in whose middle the scanner is carried elsewhere.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use portolan::geometry::nalgebra::Quaternion as Numbers;
use portolan::geometry::{Duration, Quaternion, Rigid3, Time, Vector3};
use portolan::job::{MapRequest, map, unobserved};
use portolan::recording::{create, open_all};
use portolan::simulator::{Scenario3dOptions, Simulation3d};
use portolan::worlds::three_d::Scene3d;
use portolan_testing::{is_fast, left_out};

/// A walk through a museum; another day, another path through the same building.
fn walk(building: u64, day: u64, seconds: f64, start_time: Option<Time>) -> Simulation3d {
    let mut options = Scenario3dOptions::new(Scene3d::Museum, day, 1);
    options.building_seed = Some(building);
    options.duration = Some(seconds);
    if let Some(start_time) = start_time {
        options.start_time = start_time;
    }
    for lidar in &mut options.lidars {
        lidar.beams.columns = 450;
    }
    Simulation3d::new(options).unwrap()
}

/// Maps two walks, one right after the other. Gives what is reported of the one loss, and the whole trajectory.
fn mapped(walks: [&Simulation3d; 2], folder: &Path) -> (serde_json::Value, Vec<(Time, Rigid3)>) {
    let paths = ["first.bag", "second.bag"].map(|name| folder.join(name));
    for (walk, path) in walks.into_iter().zip(&paths) {
        let mut writer = create(path, None).unwrap();
        walk.write_messages(&mut *writer).unwrap();
        writer.finish().unwrap();
    }
    let recording = open_all(&paths).unwrap();
    let finished = map(recording.as_ref(), MapRequest::new(folder), &mut unobserved).unwrap();
    let report = std::fs::read(folder.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(report["lost"].as_array().unwrap().len(), 1, "{}", report["lost"]);
    let lost = report["lost"][0].clone();
    assert_eq!(finished.summary.lost_data, lost["is_connected"] == false);
    let trajectory = std::fs::read_to_string(folder.join("trajectory.tum")).unwrap();
    let pose = |line: &str| {
        let n: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        let rotation = Quaternion::from_quaternion(Numbers::new(n[7], n[4], n[5], n[6]));
        let place = Vector3::new(n[1], n[2], n[3]);
        (Time::from_unix_seconds(n[0]), Rigid3::from_parts(place.into(), rotation))
    };
    let trajectory: Vec<_> = trajectory.lines().map(pose).collect();
    (lost, trajectory)
}

#[test]
fn a_carried_scanner_is_relocalised_by_loop_closures() {
    if is_fast() {
        return left_out("a walk that goes on elsewhere in 3D");
    }
    let folder = tempfile::tempdir().unwrap();
    let first = walk(1, 1, 40.0, None);
    let carried_at = first.start_time() + Duration::from_seconds(40.1);
    let second = walk(1, 2, 40.0, Some(carried_at));
    let (lost, trajectory) = mapped([&first, &second], folder.path());
    assert!(trajectory.len() > 780, "{}", trajectory.len());
    assert_eq!(lost["is_connected"], true);
    let since = lost["from"].as_f64().unwrap() - carried_at.unix_seconds();
    assert!((0.0..0.3).contains(&since), "{since}");
    // Relative to the first pose the whole path is correct.
    let world_from_map = first.truth_at(trajectory[0].0).unwrap() * trajectory[0].1.inverse();
    let error = |(time, pose): &(Time, Rigid3)| {
        let walk = if *time < carried_at { &first } else { &second };
        let truth = walk.truth_at(*time)?;
        Some((truth.translation.vector - (world_from_map * pose).translation.vector).norm())
    };
    let worst = trajectory.iter().filter_map(error).fold(0.0, f64::max);
    assert!(worst < 0.2, "{worst}");
}

#[test]
fn scans_of_another_building_remain_a_separate_piece() {
    if is_fast() {
        return left_out("a walk that goes on in another building");
    }
    let folder = tempfile::tempdir().unwrap();
    let first = walk(1, 1, 20.0, None);
    let second = walk(2, 1, 20.0, Some(first.start_time() + Duration::from_seconds(20.1)));
    let (lost, trajectory) = mapped([&first, &second], folder.path());
    assert!(trajectory.len() > 380, "{}", trajectory.len());
    assert_eq!(lost["is_connected"], false);
}
