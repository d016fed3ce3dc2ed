//! Recordings of the real data: half a minute of the walk through a building, from a trajectory with drift and jitter, and
//! the corridor from a map of the reference.
#![allow(clippy::unwrap_used)] // a test

use std::io::BufReader;
use std::path::PathBuf;

use portolan_evaluation::cloud::{read_boxes, surface_errors};
use portolan_evaluation::{
    Alignment, Association, Step, TimedPose, Trajectory, absolute_errors, read_tum, relative_errors,
};
use portolan_geometry::{Duration, Quaternion, Rigid3, Time, nalgebra as na};
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_recording::open;
use portolan_refinement::PointStore;
use portolan_refinement::continuous::{ContinuousOptions, DenseTrajectory, refine_continuous};
use portolan_sensor::Measurement;
use portolan_testing::{is_fast, real_data};

/// Seconds of the walk that are refined.
const SECONDS: f64 = 30.0;

/// The points of a recording.
fn points_of(bag: PathBuf, length: Option<Duration>) -> PointStore {
    let options = IngestOptions { length, ..IngestOptions::default() };
    let mut points = PointStore::new(0.3);
    for measurement in Ingestion::new(open(bag).unwrap().as_ref(), &options).unwrap() {
        if let Measurement::Range(sweep) = measurement.unwrap().1 {
            points.push(&sweep);
        }
    }
    points.sort();
    points
}

struct Walk {
    truth: Trajectory,
    points: PointStore,
}

/// The points of the first seconds, and the truth.
fn walk(seconds: f64) -> Option<Walk> {
    let bag = real_data("lidar3d/walk.bag")?;
    let (truth, _) = read_tum(file("walk.truth.tum")).unwrap();
    let points = points_of(bag, Some(Duration::from_seconds(seconds)));
    Some(Walk { truth, points })
}

fn file(name: &str) -> BufReader<std::fs::File> {
    BufReader::new(std::fs::File::open(real_data(&format!("lidar3d/{name}")).unwrap()).unwrap())
}

fn poses(trajectory: &Trajectory, seconds: f64) -> Vec<(Time, Rigid3)> {
    let start = trajectory.poses()[0].time;
    let early = trajectory.poses().iter().filter(|p| p.time.seconds_since(start) <= seconds);
    early.map(|p| (p.time, p.map_from_tracking)).collect()
}

/// The mean distance of the points from the true surfaces once the trajectory is laid onto the truth, metres.
fn surface_error(walk: &Walk, trajectory: &DenseTrajectory) -> f64 {
    let samples = (0..=(trajectory.duration() / 0.05) as usize).map(|i| {
        let seconds = i as f64 * 0.05;
        let time = trajectory.start() + Duration::from_seconds(seconds);
        TimedPose { time, map_from_tracking: trajectory.pose(seconds) }
    });
    let estimate = Trajectory::new(samples).0;
    let absolute = absolute_errors(&walk.truth, &estimate, Association::default(), Alignment::Se3).unwrap();
    let [x, y, z, qx, qy, qz, qw] = absolute.truth_from_estimate;
    let turn = Quaternion::new_normalize(na::Quaternion::new(qw, qx, qy, qz));
    let truth_from_estimate = Rigid3::from_parts(na::Translation3::new(x, y, z), turn);
    let matrices = trajectory.matrices();
    let offset = walk.points.start().seconds_since(trajectory.start());
    let cloud: Vec<[f64; 3]> = walk
        .points
        .points()
        .iter()
        .step_by(7)
        .filter(|p| (0.0..=trajectory.duration()).contains(&(p.seconds() + offset)))
        .map(|p| matrices.to_world(p.seconds() + offset, p.in_tracking))
        .map(|p| (truth_from_estimate * na::Point3::from(p)).coords.into())
        .collect();
    let boxes = read_boxes(file("walk.surfaces.csv")).unwrap();
    surface_errors(&cloud, &boxes).unwrap().mean
}

#[test]
fn half_a_minute_of_the_walk_becomes_as_sharp_as_the_truth() {
    if is_fast() {
        return;
    }
    let Some(walk) = walk(SECONDS) else { return };
    let (input, _) = read_tum(file("walk.input.tum")).unwrap();
    let poses = poses(&input, SECONDS);
    let options = ContinuousOptions::default();
    let refined = refine_continuous(&walk.points, &poses, &options, &mut |_| true).unwrap();
    assert!(refined.report.warnings.is_empty(), "{:?}", refined.report.warnings);
    let corrected = poses.iter().map(|(time, pose)| TimedPose {
        time: *time,
        map_from_tracking: refined.trajectory.corrected(*time, pose),
    });
    let estimate = Trajectory::new(corrected).0;

    let absolute = absolute_errors(&walk.truth, &estimate, Association::default(), Alignment::Se3).unwrap();
    assert!(absolute.translation.rmse < 0.010, "{absolute}");
    assert!(absolute.rotation_degrees.rmse < 0.15, "{absolute}");
    let relative = relative_errors(&walk.truth, &estimate, Association::default(), Step::Time(1.0)).unwrap();
    assert!(relative.translation.rmse < 0.015 && relative.rotation_degrees.rmse < 0.2, "{relative}");
    let surfaces = surface_error(&walk, &refined.trajectory);
    assert!(surfaces < 0.0125, "{surfaces}");
}

#[test]
fn the_truth_does_not_become_worse() {
    if is_fast() {
        return;
    }
    let Some(walk) = walk(0.7 * SECONDS) else { return };
    let poses = poses(&walk.truth, 0.7 * SECONDS);
    let before = surface_error(&walk, &DenseTrajectory::new(&poses).unwrap());
    let options = ContinuousOptions::default();
    let refined = refine_continuous(&walk.points, &poses, &options, &mut |_| true).unwrap();
    let after = surface_error(&walk, &refined.trajectory);
    assert!(after < 1.01 * before, "{before} -> {after}");
    assert!(refined.report.warnings.is_empty(), "{:?}", refined.report.warnings);
}

#[test]
fn a_map_that_is_only_inexact_raises_no_suspicion() {
    if is_fast() {
        return;
    }
    // The reference's map of a corridor: off by 0.1 m, ten poses a second, wrong in the same way at every corner.
    let (Some(bag), Some(_)) =
        (real_data("lidar3d/corridor_imu.bag"), real_data("maps/reference/corridor_imu.tum"))
    else {
        return;
    };
    let (input, _) = read_tum(file("../maps/reference/corridor_imu.tum")).unwrap();
    let points = points_of(bag, None);
    let options = ContinuousOptions::default();
    let refined = refine_continuous(&points, &poses(&input, f64::INFINITY), &options, &mut |_| true).unwrap();
    assert!(refined.report.warnings.is_empty(), "{:?}", refined.report.warnings);
    assert!(refined.report.largest_translation > 0.1);
}
