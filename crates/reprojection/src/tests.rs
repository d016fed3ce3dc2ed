#![allow(clippy::unwrap_used)] // tests fail so
use portolan_geometry::{
    Duration, Point3f, Rigid3, Time, Vector3, nalgebra as na, quaternion_from_angle_axis,
};
use portolan_sensor::{TimedPoint, TimedPointCloudData};

use super::*;

const ALL: RangeLimits = RangeLimits { min_range: 0.5, max_range: 50.0 };

fn at(seconds: f64) -> Time {
    Time::from_ros(1_700_000_000, 0) + Duration::from_seconds(seconds)
}

/// Walking along a curve, bobbing twice a second.
fn walk(t: f64) -> Rigid3 {
    let place = Vector3::new(1.2 * t, (0.3 * t).sin(), 0.03 * (12.0 * t).sin());
    let turn = Vector3::new(0.03 * (6.0 * t).sin(), 0.02 * (12.0 * t).cos(), 0.5 * t);
    Rigid3::from_parts(na::Translation3::from(place), quaternion_from_angle_axis(&turn))
}

fn poses(skip: std::ops::Range<usize>) -> Vec<(Time, Rigid3)> {
    let seconds = |i: usize| 0.1 * i as f64;
    (0..100).filter(|i| !skip.contains(i)).map(|i| (at(seconds(i)), walk(seconds(i)))).collect()
}

/// A sweep of 0.1 s whose points all measure one point of the map.
fn sweep(end: f64, seen: na::Point3<f64>) -> TimedPointCloudData {
    let point = |i: i32| {
        let time = -0.001 * f64::from(100 - i);
        let position: Point3f = na::convert(walk(end + time).inverse() * seen);
        TimedPoint { position, time: time as f32 }
    };
    TimedPointCloudData {
        time: at(end),
        origin_in_tracking: Point3f::origin(),
        points_in_tracking: (0..=100).map(point).collect(),
        intensities: (0..=100u8).map(f32::from).collect(),
    }
}

fn distances(points: &[MapPoint], seen: na::Point3<f64>) -> f64 {
    points.iter().map(|p| (na::Point3::from(p.position) - seen).norm()).fold(0.0, f64::max)
}

#[test]
fn a_place_seen_while_walking_is_one_place() {
    let seen = na::Point3::new(3.0, 8.0, 1.0);
    let motion = SmoothMotion::new(poses(0..0));
    let mut reprojector = Reprojector::new(&motion, ALL);
    let mut largest = 0.0_f64;
    for end in [2.0, 4.03, 6.05, 9.9] {
        let points = reprojector.place(&sweep(end, seen)).to_vec();
        assert_eq!(points.len(), 101);
        assert_eq!((points[7].intensity, points[100].time), (7.0, at(end).unix_seconds()));
        largest = largest.max(distances(&points, seen));
    }
    // Linear interpolation between the poses would be off by 30 mm.
    assert!(largest < 0.012, "{largest}");
}

#[test]
fn points_without_a_pose_are_left_out_and_counted() {
    let seen = na::Point3::new(3.0, 8.0, 1.0);
    let motion = SmoothMotion::new(poses(40..60));
    let mut reprojector = Reprojector::new(&motion, ALL);
    for (end, kept) in
        [(0.05, 51), (3.9, 101), (3.95, 51), (5.0, 0), (6.0, 1), (6.1, 101), (9.95, 51), (20.0, 0)]
    {
        assert_eq!(reprojector.place(&sweep(end, seen)).len(), kept, "{end}");
    }
    let near = na::Point3::from(walk(1.0).translation.vector);
    assert_eq!(reprojector.place(&sweep(1.0, near)).len(), 0);
    let Reprojected { points, outside_trajectory, outside_range, .. } = reprojector.reprojected();
    assert_eq!((points, outside_range), (356, 101));
    assert_eq!(points + outside_range + outside_trajectory, 9 * 101);
}

#[test]
fn sweeps_of_any_length_are_placed() {
    let motion = SmoothMotion::new(poses(0..0));
    let mut long = sweep(9.0, na::Point3::new(3.0, 8.0, 1.0));
    long.points_in_tracking[0].time = -1e9;
    long.points_in_tracking[1].time = f32::MIN;
    let mut reprojector = Reprojector::new(&motion, ALL);
    assert_eq!(reprojector.place(&long).len(), 99);
    long.points_in_tracking.clear();
    assert_eq!(reprojector.place(&long).len(), 0);
    assert_eq!(Reprojector::new(&SmoothMotion::new(Vec::new()), ALL).place(&long).len(), 0);
}
