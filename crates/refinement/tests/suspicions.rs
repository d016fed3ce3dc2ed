//! Wrong inputs are distinguished from inexact ones, and reported.
#![allow(clippy::unwrap_used)] // tests

mod synthetic;

use portolan_geometry::{Duration, Point3f, Rigid3, Time, Vector3};
use portolan_refinement::continuous::{ContinuousOptions, RefineReport, refine_continuous};
use portolan_refinement::{PointStore, RefineError};
use portolan_sensor::{TimedPoint, TimedPointCloudData};
use portolan_testing::is_fast;
use synthetic::{Lidar, circles, disturbed, furnished, poses, scan, scan_with};

type Poses = Vec<(Time, Rigid3)>;

fn report(points: &PointStore, input: &Poses) -> RefineReport {
    refine_continuous(points, input, &ContinuousOptions::default(), &mut |_| true).unwrap().report
}

fn later(input: &Poses, seconds: f64) -> Poses {
    input.iter().map(|(time, pose)| (*time + Duration::from_seconds(seconds), *pose)).collect()
}

/// The number after the option that a warning names.
fn offset_named(text: &str) -> f64 {
    let number = text.split("--time-offset ").nth(1).unwrap();
    number.split(')').next().unwrap().parse().unwrap()
}

#[test]
fn a_wrong_time_base_is_named_with_the_offset_that_fits() {
    if is_fast() {
        return;
    }
    let truth = poses(circles, 20.0);
    let points = scan(&furnished(), circles, 20.0, 60);
    let right = report(&points, &truth);
    assert!(right.warnings.is_empty(), "{:?}", right.warnings);
    for seconds in [0.6, -1.4] {
        let message = report(&points, &later(&truth, seconds)).warnings.join("\n");
        assert!(message.contains("wrong time base"), "{seconds}: {message}");
        assert!((offset_named(&message) + seconds).abs() < 0.03, "{seconds}: {message}");
    }
}

#[test]
fn a_clock_far_off_is_named_too() {
    let truth = poses(circles, 20.0);
    let points = scan(&furnished(), circles, 20.0, 60);
    let shorter: Poses = truth[100..].to_vec();
    let options = ContinuousOptions::default();
    let error = refine_continuous(&points, &later(&shorter, 5000.0), &options, &mut |_| true).unwrap_err();
    let message = error.to_string();
    assert!(matches!(error, RefineError::NoOverlap { .. }) && message.contains("fit together"), "{message}");
    let named: f64 = message.split("(-").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((named - 5000.0).abs() < 0.03, "{message}");
}

#[test]
fn the_trajectory_of_another_recording_is_suspected() {
    if is_fast() {
        return;
    }
    let points = scan(&furnished(), circles, 20.0, 60);
    let other: Poses = poses(
        |s| {
            let turn = Vector3::new(0.1 * (2.1 * s).sin(), 0.0, 1.1 * (0.9 * s).sin());
            Rigid3::new(Vector3::new(0.9 * s, 2.0 * (0.8 * s).cos(), 1.2), turn)
        },
        20.0,
    );
    let message = report(&points, &other).warnings.join("\n");
    assert!(message.contains("another recording"), "{message}");
}

#[test]
fn a_short_trajectory_and_empty_sweeps_are_counted() {
    let truth = poses(circles, 12.0);
    let mut points = scan(&furnished(), circles, 20.0, 60);
    let empty = |points_in_tracking| TimedPointCloudData {
        time: Time::from_unix_seconds(1003.0),
        origin_in_tracking: Point3f::origin(),
        points_in_tracking,
        intensities: Vec::new(),
    };
    points.push(&empty(Vec::new()));
    let nan = TimedPoint { position: Point3f::new(f32::NAN, 0.0, 1.0), time: 0.0 };
    points.push(&empty(vec![nan; 5]));
    points.sort();
    let message = report(&points, &truth);
    let text = message.warnings.join("\n");
    assert!(text.contains("shorter than the recording") && text.contains("ends 8.0 s earlier"), "{text}");
    assert!(text.contains("1 of 202 sweeps"), "{text}");
    assert_eq!(message.left_out.not_finite, 5);
}

#[test]
fn invalid_poses_are_refused() {
    let points = scan(&furnished(), circles, 3.0, 60);
    let mut input = poses(circles, 3.0);
    input[17].1.translation.vector.x = f64::NAN;
    let options = ContinuousOptions::default();
    let refused = |input: &Poses| refine_continuous(&points, input, &options, &mut |_| true).unwrap_err();
    assert_eq!(refused(&input), RefineError::BadPose(17));
    let mut input = poses(circles, 3.0);
    input.swap(30, 31);
    assert_eq!(refused(&input), RefineError::BadPose(31));
}

#[test]
fn a_wrong_lidar_mounting_is_suspected() {
    if is_fast() {
        return;
    }
    let mount = Rigid3::new(Vector3::new(-0.2, 0.1, 0.3), Vector3::new(0.0, 0.6, 0.0));
    let wrong = Rigid3::new(Vector3::new(0.03, 0.0, 0.02), Vector3::new(0.0, 0.0, 0.03));
    let lidars = |assumed_mounting| {
        let second = Lidar { name: "second", tracking_from_lidar: mount, assumed_mounting, delay: 0.0 };
        [Lidar { name: "first", ..Lidar::known() }, second]
    };
    let truth = poses(circles, 15.0);
    let input = disturbed(&truth, 0.1, 0.003);
    let good = report(&scan_with(&lidars(mount), &furnished(), circles, 15.0, 60), &input);
    assert!(good.warnings.is_empty(), "{:?}", good.warnings);
    let bad = report(&scan_with(&lidars(mount * wrong), &furnished(), circles, 15.0, 60), &input);
    let message = bad.warnings.join("\n");
    assert!(message.contains("wrong extrinsics") && message.contains("second"), "{message}");
}

#[test]
fn extrinsics_to_the_tracking_frame_are_suspected() {
    // The motion of the input is exact, but of a frame that is turned against the one the points are in.
    let truth = poses(circles, 20.0);
    let points = scan(&furnished(), circles, 20.0, 60);
    let turned = Rigid3::new(Vector3::new(0.0, 0.0, 0.0), Vector3::new(0.0, 0.0, 0.05));
    let input: Poses = truth.iter().map(|(time, pose)| (*time, pose * turned)).collect();
    let message = report(&points, &input).warnings.join("\n");
    assert!(message.contains("wrong extrinsics") && message.contains("deg"), "{message}");
}
