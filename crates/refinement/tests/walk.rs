//! The walk through a building of the shared data: half a minute of it, from a trajectory with drift and jitter.
#![allow(clippy::unwrap_used)] // a test

use std::io::BufReader;
use std::path::PathBuf;

use portolan_evaluation::cloud::{read_boxes, surface_errors};
use portolan_evaluation::{
    Alignment, Association, Step, TimedPose, Trajectory, absolute_errors, read_tum, relative_errors,
};
use portolan_geometry::{Duration, Quaternion, Rigid3, nalgebra as na};
use portolan_recording::{IngestOptions, Ingestion, open};
use portolan_refinement::PointStore;
use portolan_refinement::continuous::{ContinuousOptions, refine_continuous};
use portolan_sensor::Measurement;

/// Seconds of the walk that are refined.
const SECONDS: f64 = 30.0;

#[allow(clippy::print_stderr)] // what is skipped must be seen
fn shared(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("PORTOLAN_SHARED").map_or_else(
        || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")),
        PathBuf::from,
    );
    let path = root.join("data/lidar3d").join(name);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is missing", path.display());
    eprintln!("skipped: {} is missing", path.display());
    None
}

#[test]
fn half_a_minute_of_the_walk_becomes_as_sharp_as_the_truth() {
    let Some(bag) = shared("walk.bag") else { return };
    let file = |name: &str| BufReader::new(std::fs::File::open(shared(name).unwrap()).unwrap());
    let (truth, _) = read_tum(file("walk.truth.tum")).unwrap();
    let (input, _) = read_tum(file("walk.input.tum")).unwrap();
    let start = input.poses()[0].time;
    let poses: Vec<_> = input
        .poses()
        .iter()
        .filter(|p| p.time.seconds_since(start) <= SECONDS)
        .map(|p| (p.time, p.map_from_tracking))
        .collect();
    let options = IngestOptions { length: Some(Duration::from_seconds(SECONDS)), ..IngestOptions::default() };
    let mut points = PointStore::new(0.3);
    for measurement in Ingestion::new(open(bag).unwrap().as_ref(), &options).unwrap() {
        if let Measurement::Range(sweep) = measurement.unwrap().1 {
            points.push(&sweep);
        }
    }
    points.sort();
    let refined =
        refine_continuous(&points, &poses, &ContinuousOptions::default(), &mut |_| true).unwrap().trajectory;
    let corrected = poses
        .iter()
        .map(|(time, pose)| TimedPose { time: *time, map_from_tracking: refined.corrected(*time, pose) });
    let estimate = Trajectory::new(corrected).0;

    let absolute = absolute_errors(&truth, &estimate, Association::default(), Alignment::Se3).unwrap();
    assert!(absolute.translation.rmse < 0.010, "{absolute}");
    assert!(absolute.rotation_degrees.rmse < 0.15, "{absolute}");
    let relative = relative_errors(&truth, &estimate, Association::default(), Step::Time(1.0)).unwrap();
    assert!(relative.translation.rmse < 0.015 && relative.rotation_degrees.rmse < 0.2, "{relative}");

    let [x, y, z, qx, qy, qz, qw] = absolute.truth_from_estimate;
    let turn = Quaternion::new_normalize(na::Quaternion::new(qw, qx, qy, qz));
    let truth_from_estimate = Rigid3::from_parts(na::Translation3::new(x, y, z), turn);
    let matrices = refined.matrices();
    let offset = points.start().seconds_since(refined.start());
    let cloud: Vec<[f64; 3]> = points
        .points()
        .iter()
        .step_by(7)
        .filter(|p| (0.0..=refined.duration()).contains(&(p.seconds() + offset)))
        .map(|p| matrices.to_world(p.seconds() + offset, p.in_tracking))
        .map(|p| (truth_from_estimate * na::Point3::from(p)).coords.into())
        .collect();
    let boxes = read_boxes(file("walk.surfaces.csv")).unwrap();
    let surfaces = surface_errors(&cloud, &boxes).unwrap();
    assert!(surfaces.mean < 0.0125, "{surfaces}");
}
