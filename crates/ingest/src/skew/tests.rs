use portolan_geometry::{Duration, Rigid3, Vector3, nalgebra::Point3, quaternion_from_angle_axis};

use super::*;
use crate::beam_elevation::Raise;

/// Boxes from a corner to the opposite one, metres: a hall and the objects in it.
const HALL: [[f64; 3]; 2] = [[-9.0, -6.0, 0.0], [14.0, 7.0, 4.0]];
const THINGS: [[[f64; 3]; 2]; 5] = [
    [[-3.0, 3.0, 0.0], [-1.5, 4.5, 2.5]],
    [[4.0, -4.5, 0.0], [5.0, -3.0, 3.0]],
    [[7.0, 3.0, 0.0], [8.5, 4.0, 1.2]],
    [[-6.0, -4.0, 0.0], [-5.0, -2.5, 4.0]],
    [[1.5, 4.5, 0.0], [2.0, 5.0, 4.0]],
];
const RINGS: usize = 16;
const COLUMNS: usize = 450;
const PERIOD: f64 = 0.1;

/// Distance along a ray to the first side of a box that is entered, or left if the ray begins inside.
fn distance(corners: &[[f64; 3]; 2], from: &Vector3, direction: &Vector3, is_inside: bool) -> Option<f64> {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for k in 0..3 {
        let (a, b) = ((corners[0][k] - from[k]) / direction[k], (corners[1][k] - from[k]) / direction[k]);
        (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
    }
    if is_inside { Some(leave) } else { (enter < leave && enter > 0.0).then_some(enter) }
}

/// A lidar moves through the hall and rotates.
fn pose(seconds: f64) -> Rigid3 {
    let place =
        Vector3::new(-2.0 + 1.3 * seconds, 0.6 * (0.9 * seconds).sin(), 1.4 + 0.03 * (12.0 * seconds).sin());
    let turn = Vector3::new(
        0.02 * (11.0 * seconds).sin(),
        0.02 * (9.0 * seconds).cos(),
        0.7 * (1.3 * seconds).sin(),
    );
    Rigid3::from_parts(place.into(), quaternion_from_angle_axis(&turn))
}

/// A sweep of a head that begins at the left and turns clockwise, with a fraction of the motion in it. Points
/// are ordered by ring from ahead, as many drivers write them. Each comes with the fraction of the turn at
/// which it was measured.
fn sweep(index: usize, factor: f64, motion: impl Fn(f64) -> Rigid3) -> (Vec<Point3f>, Vec<f32>) {
    let middle = (index as f64 + 0.5) * PERIOD;
    let mut points = Vec::new();
    for ring in 0..RINGS {
        let elevation = (-15.0 + 2.0 * ring as f64).to_radians();
        for column in 0..COLUMNS {
            let azimuth = column as f64 / COLUMNS as f64 * std::f64::consts::TAU;
            let share = ((std::f64::consts::FRAC_PI_2 - azimuth) / std::f64::consts::TAU).rem_euclid(1.0);
            let seen_from = motion(middle + factor * (share - 0.5) * PERIOD);
            let beam = Vector3::new(
                azimuth.cos() * elevation.cos(),
                azimuth.sin() * elevation.cos(),
                elevation.sin(),
            );
            let (from, direction) = (seen_from.translation.vector, seen_from.rotation * beam);
            let things = THINGS.iter().filter_map(|thing| distance(thing, &from, &direction, false));
            let hall = distance(&HALL, &from, &direction, true);
            let nearest = things.chain(hall).fold(f64::INFINITY, f64::min);
            // Noise of a centimetre that is different at each point.
            let noise = 0.01 * ((index * 7919 + ring * 104_729 + column * 1_299_709) as f64 * 0.618).sin();
            points.push((Point3::from(beam * (nearest + noise)).cast::<f32>(), share as f32));
        }
    }
    points.into_iter().unzip()
}

fn at(index: usize) -> Time {
    Time::from_unix_seconds(1e9) + Duration::from_seconds(PERIOD * index as f64)
}

fn estimated(factor: f64, has_times: bool, motion: impl Fn(f64) -> Rigid3 + Copy) -> Option<Skew> {
    let mut estimator = SkewEstimator::default();
    for index in 0..MAX_BATCHES * SWEEPS_OF_A_BATCH {
        let (points, shares) = sweep(index, factor, motion);
        estimator.add(at(index), &points, has_times.then_some(&shares));
        if estimator.is_done() {
            break;
        }
    }
    estimator.skew()
}

#[test]
fn raw_clouds_and_the_start_of_sweeps_are_recognised() {
    let skew = estimated(1.0, false, pose).unwrap();
    assert_eq!(skew.state(), SkewState::Raw, "{skew:?}");
    assert!(skew.is_clockwise && (skew.begin_radians.to_degrees() - 90.0).abs() <= 10.0, "{skew:?}");
    let skew = estimated(1.0, true, pose).unwrap();
    assert_eq!(skew.state(), SkewState::Raw, "{skew:?}");
}

#[test]
fn deskewed_clouds_are_recognised_with_and_without_times() {
    for has_times in [false, true] {
        let skew = estimated(0.0, has_times, pose).unwrap();
        assert_eq!(skew.state(), SkewState::Removed, "{has_times}: {skew:?}");
    }
}

#[test]
fn partly_deskewed_clouds_are_recognised() {
    let skew = estimated(0.5, true, pose).unwrap();
    assert!((skew.rotation.factor - 0.5).abs() < 0.1, "{skew:?}");
    assert!(skew.state() == SkewState::Partial, "{skew:?}");
}

#[test]
fn clouds_of_every_other_sweep_are_recognised_by_the_motion_in_their_points() {
    // Half of the motion between clouds is in the points.
    let skew = estimated(0.5, false, pose).unwrap();
    assert_eq!((skew.state(), skew.turn_in_intervals), (SkewState::Raw, 0.5), "{skew:?}");
    assert!(skew.is_clockwise && (skew.begin_radians.to_degrees() - 90.0).abs() <= 10.0, "{skew:?}");
    assert_eq!(estimated(1.0, false, pose).unwrap().turn_in_intervals, 1.0);
}

#[test]
fn wrong_times_are_detected_and_right_ones_are_kept() {
    for (sense, duty, expected) in
        [(1.0, 1.0, None), (1.0, 1.5, Some(1.0 / 1.5)), (1.0, 0.5, Some(2.0)), (-1.0, 1.0, Some(-1.0))]
    {
        let mut estimator = SkewEstimator::default();
        for index in 0..2 * SWEEPS_OF_A_BATCH {
            let (points, mut shares) = sweep(index, 1.0, pose);
            shares.iter_mut().for_each(|share| *share = 0.5 + sense * (*share - 0.5));
            estimator.add(at(index), &points, Some(&shares));
        }
        let skew = estimator.skew().unwrap().of_part(duty);
        for spins in [false, true] {
            let right = estimator.right_times(&skew, duty, spins).map(|right| (right.times, right.is_clear));
            let expected = expected.map(|scale| (Times::Scaled(scale), true));
            assert_eq!(right, expected, "{sense} {duty} {spins}: {skew:?}");
        }
    }
}

/// How the times of the points (fractions of the sweep) are changed.
type Spoiler = Box<dyn Fn(&mut [f32])>;

/// The fraction of another point of the sweep.
fn of_another(shares: &mut [f32]) {
    for index in 0..shares.len() {
        shares.swap(index, index * 7919 % shares.len());
    }
}

#[test]
fn times_of_other_points_and_sweeps_are_distinguished_from_azimuth_times() {
    let elsewhere = |shift: f32| {
        move |shares: &mut [f32]| {
            shares.iter_mut().for_each(|share| *share = (*share + shift).rem_euclid(1.0));
        }
    };
    let spoilers: [Spoiler; 4] =
        [Box::new(elsewhere(0.5)), Box::new(elsewhere(0.25)), Box::new(elsewhere(0.1)), Box::new(of_another)];
    for (case, spoil) in spoilers.iter().enumerate() {
        let mut estimator = SkewEstimator::default();
        for index in 0..2 * SWEEPS_OF_A_BATCH {
            let (points, mut shares) = sweep(index, 1.0, pose);
            spoil(&mut shares);
            estimator.add(at(index), &points, Some(&shares));
        }
        let skew = estimator.skew().unwrap();
        let right = estimator.right_times(&skew, 1.0, true);
        let Some(RightTimes { times: Times::ByAzimuth(turn), is_clear: true, .. }) = right else {
            panic!("{case}: {right:?}, {skew:?}")
        };
        let degrees = turn.begin_radians.to_degrees();
        assert!(turn.is_clockwise && (degrees - 90.0).abs() <= 10.0, "{case}: {turn:?}");
        // A lidar that does not spin has no times by azimuth.
        let right = estimator.right_times(&skew, 1.0, false);
        assert!(!matches!(right, Some(RightTimes { times: Times::ByAzimuth(_), .. })), "{case}: {right:?}");
    }
}

#[test]
fn beams_that_point_too_low_are_found_and_right_ones_are_left() {
    for (error, factor, has_times) in [(0.008, 1.0, true), (0.0, 1.0, true), (0.0, 0.0, false)] {
        let mut estimator = SkewEstimator::default();
        for index in 0..MAX_BATCHES * SWEEPS_OF_A_BATCH {
            let (points, shares) = sweep(index, factor, pose);
            let lowered: Vec<Point3f> = points.iter().map(|p| Raise::new(-error).point(p)).collect();
            estimator.add(at(index), &lowered, has_times.then_some(&shares));
            if estimator.is_done() {
                break;
            }
        }
        let offset = estimator.skew().unwrap().elevation.unwrap();
        assert_eq!(offset.is_clear(), error != 0.0, "{error} {factor}: {offset:?}");
        // Sixteen rings on a floor: neighbouring ones are taken for one surface, and a part of the error stays.
        let found = offset.radians / error;
        assert!(error == 0.0 || (0.5..1.1).contains(&found), "{error} {factor}: {offset:?}");
    }
}

#[test]
fn skew_is_unknown_at_rest() {
    assert_eq!(estimated(1.0, false, |_| pose(0.0)), None);
    assert_eq!(estimated(0.0, true, |_| pose(0.0)), None);
}

#[test]
fn clouds_of_any_kind_are_handled() {
    let wild = vec![Point3f::new(f32::NAN, 1.0, f32::INFINITY); 50];
    let line: Vec<Point3f> = (0..5000).map(|i| Point3f::new(1.0 + i as f32 * 0.01, 0.0, 0.0)).collect();
    for points in [vec![], vec![Point3f::origin(); 3], wild, line, vec![Point3f::new(5.0, 5.0, 5.0); 3000]] {
        for shares in [None, Some(vec![0.5; points.len()]), Some(vec![f32::NAN; points.len()])] {
            let mut estimator = SkewEstimator::default();
            for index in 0..3 * SWEEPS_OF_A_BATCH {
                estimator.add(at(index), &points, shares.as_deref());
            }
            let state = estimator.skew().map_or(SkewState::Unknown, |skew| skew.state());
            assert_eq!(state, SkewState::Unknown);
        }
    }
}
