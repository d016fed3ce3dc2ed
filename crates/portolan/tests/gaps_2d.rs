//! 2D recordings in which scans are missing for a while, or see nothing of the place.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::known;

use std::path::Path;

use known::gap::{Gap, Scans};
use portolan::geometry::nalgebra::Quaternion as Numbers;
use portolan::geometry::{Duration, Quaternion, Rigid3, Time, Vector3};
use portolan::job::{MapRequest, map, unobserved};
use portolan::recording::{RecordingWriter, create, open_all};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// Maps so many seconds of a drive through an office without the scans of eight seconds in the middle. Gives the report, and the
/// largest error of a pose, metres, as seen from the first one.
fn mapped(seconds: f64, scans: Scans, stalls: bool, folder: &Path) -> (serde_json::Value, f64) {
    let options = ScenarioOptions { duration: Some(seconds), ..ScenarioOptions::new(Scene::Office, 3) };
    let drive = Simulation::new(options).unwrap();
    let bag = folder.join("drive.bag");
    let at = |seconds| drive.start_time() + Duration::from_seconds(seconds);
    let mut writer = Gap {
        inner: create(&bag, None).unwrap(),
        between: [at(seconds / 2.0 - 4.0), at(seconds / 2.0 + 4.0)],
        scans,
        stalled: stalls.then(|| [Rigid3::identity(); 2]),
    };
    drive.write_messages(&mut writer).unwrap();
    Box::new(writer).finish().unwrap();
    let recording = open_all(&[bag]).unwrap();
    let mut request = MapRequest::new(folder);
    request.cloud.file = Some("cloud.ply".into());
    map(recording.as_ref(), request, &mut unobserved).unwrap();
    let report = std::fs::read(folder.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    // What was seen after the gap is in the cloud, too.
    let [points, left_out] =
        ["points", "outside_trajectory"].map(|key| report["cloud"]["unwound"][key].as_f64().unwrap());
    assert!(left_out < 0.02 * points, "{}", report["cloud"]);
    let trajectory = std::fs::read_to_string(folder.join("trajectory.tum")).unwrap();
    let poses = trajectory.lines().map(|line| {
        let n: Vec<f64> = line.split(' ').map(|word| word.parse().unwrap()).collect();
        let rotation = Quaternion::from_quaternion(Numbers::new(n[7], n[4], n[5], n[6]));
        (Time::from_unix_seconds(n[0]), Rigid3::from_parts(Vector3::new(n[1], n[2], n[3]).into(), rotation))
    });
    let poses: Vec<_> = poses.collect();
    let steps = poses.windows(2).map(|pair| pair[1].0.seconds_since(pair[0].0));
    let longest_step = steps.fold(0.0, f64::max);
    assert!((scans == Scans::LeftOut) == (longest_step > 1.0), "{longest_step} s without a pose");
    let world_from_map = drive.truth_at(poses[0].0).unwrap() * poses[0].1.inverse();
    let error = |(time, pose): &(Time, Rigid3)| {
        let truth = drive.truth_at(*time)?;
        Some((truth.translation.vector - (world_from_map * pose).translation.vector).norm())
    };
    (report, poses.iter().filter_map(error).fold(0.0, f64::max))
}

#[test]
fn a_part_after_a_gap_is_connected_by_scans_with_and_without_stalled_wheels() {
    for stalls in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let (report, error) = mapped(150.0, Scans::LeftOut, stalls, folder.path());
        let lost = report["lost"].as_array().unwrap();
        println!("{lost:?} {error}");
        assert!(lost.len() == 1 && lost[0]["is_gap_without_scans"] == true, "{lost:?}");
        assert!(lost[0]["is_connected"] == true && lost[0]["is_tied_by_odometry_alone"] == false, "{lost:?}");
        assert!(error < 0.12, "{stalls}: {error}");
    }
}

#[test]
fn scans_of_a_covered_scanner_are_placed_by_odometry_and_not_inserted() {
    let folder = tempfile::tempdir().unwrap();
    let (report, error) = mapped(60.0, Scans::Covered, false, folder.path());
    let issues = report["issues"].as_array().unwrap();
    let occluded = issues.iter().find(|issue| issue["kind"] == "scan_occluded").unwrap();
    let lost = report["lost"].as_array().unwrap();
    println!("{occluded} {lost:?} {error}");
    let count = occluded["count"].as_u64().unwrap();
    let scans = report["scans"].as_u64().unwrap();
    assert!(count * 60 > scans * 7 && count * 60 < scans * 9, "{count} of {scans}");
    assert!(lost.iter().all(|lost| lost["is_connected"] == true), "{lost:?}");
    assert!(error < 0.12, "{error}");
}

#[test]
fn scans_without_a_return_are_placed_by_odometry() {
    let folder = tempfile::tempdir().unwrap();
    let (report, error) = mapped(60.0, Scans::Blind, false, folder.path());
    let issues = report["issues"].as_array().unwrap();
    let blind = issues.iter().find(|issue| issue["kind"] == "no_distance").unwrap();
    let lost = report["lost"].as_array().unwrap();
    println!("{blind} {lost:?} {error}");
    assert!(lost.iter().all(|lost| lost["is_connected"] == true), "{lost:?}");
    assert!(error < 0.12, "{error}");
}
