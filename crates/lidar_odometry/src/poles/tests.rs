use std::f32::consts::TAU;

use portolan_geometry::{Duration, Rigid3, Time};

use super::*;
use crate::testing::Lcg;
use crate::{
    MotionPrior, PlaneMap, Registration, RegistrationSettings, SegmentCorrection, Sigmas, TrajectorySegment,
};

const TRUNKS: [[f32; 2]; 12] = [
    [6.0, 2.0],
    [-3.0, 7.0],
    [-8.0, -4.0],
    [5.0, -6.0],
    [9.0, 5.0],
    [-7.0, 3.0],
    [2.0, -9.0],
    [-4.0, -7.0],
    [11.0, -3.0],
    [3.0, 6.0],
    [-10.0, 1.0],
    [8.0, -8.0],
];

/// Points of a scanner at `place`: the side of trunks that faces it, ground around it that its beams hit
/// at the same distances everywhere, and a wall at y = 9 if wanted.
fn seen_from(place: &Point3f, with_wall: bool, lcg: &mut Lcg) -> Vec<TimedPoint> {
    let mut hits = Vec::new();
    for [x, y] in TRUNKS {
        let bearing = (place.y - y).atan2(place.x - x);
        for i in 0..40 {
            let angle = bearing + lcg.symmetric(1.2);
            let height = -0.9 + 0.5 * (i % 6) as f32;
            hits.push(Point3f::new(x + 0.2 * angle.cos(), y + 0.2 * angle.sin(), height));
        }
    }
    for i in 0..6000 {
        let ring = 2.0 + 0.2 * (i % 20) as f32;
        let (sin, cos) = (TAU * i as f32 / 6000.0).sin_cos();
        hits.push(Point3f::new(place.x + ring * cos, place.y + ring * sin, -1.0 + lcg.symmetric(0.01)));
    }
    if with_wall {
        let wall = |i: usize, lcg: &mut Lcg| Point3f::new(lcg.symmetric(6.0), 9.0, 0.4 * (i % 5) as f32);
        hits.extend((0..600).map(|i| wall(i, lcg)));
    }
    hits.iter().map(|hit| TimedPoint { time: 0.0, position: Point3f::from(hit - place) }).collect()
}

/// As if the scanner was at the origin.
fn standing() -> TrajectorySegment {
    let start = Time::from_ticks(0);
    TrajectorySegment::new(start, start + Duration::from_seconds(0.1), |_| Rigid3::identity())
}

fn poles_of(sweep: &[TimedPoint]) -> Vec<PolePoint> {
    let to_end = standing().deskewing(&SegmentCorrection::default());
    PolePoint::of_sweep(sweep.iter().copied(), &to_end, &Quaternion::identity(), &PoleSettings::default())
}

#[test]
fn trunks_and_walls_are_poles_and_ground_is_not() {
    let poles = poles_of(&seen_from(&Point3f::origin(), true, &mut Lcg::new(1)));
    let (walls, trunks): (Vec<_>, Vec<_>) = poles.iter().partition(|p| p.point.position.y > 8.5);
    let is_by_a_trunk = |p: &&&PolePoint| {
        TRUNKS.iter().any(|[x, y]| (p.point.position.x - x).hypot(p.point.position.y - y) < 0.21)
    };
    assert!(poles.iter().all(|p| p.point.position.z > -0.8) && trunks.iter().all(|p| is_by_a_trunk(&p)));
    assert!(trunks.len() > 120 && trunks.iter().all(|p| p.wall_direction.is_none()), "{trunks:?}");
    let in_walls = walls.iter().filter(|p| p.wall_direction.is_some_and(|wall| wall.x.abs() > 0.99)).count();
    assert!(walls.len() > 100 && in_walls > walls.len() * 9 / 10, "{in_walls} of {}", walls.len());
}

#[test]
fn the_number_of_pole_points_of_a_sweep_is_limited() {
    let forest = (0..40_000).map(|i| Point3f::new((i % 40) as f32, (i / 40 % 40) as f32, (i / 1600) as f32));
    let sweep: Vec<TimedPoint> = forest.map(|position| TimedPoint { time: 0.0, position }).collect();
    assert_eq!(poles_of(&sweep).len(), PoleSettings::default().max_points);
    assert_eq!(poles_of(&[]), []);
    let nowhere = Point3f::new(f32::NAN, f32::INFINITY, -1e30);
    assert_eq!(poles_of(&[TimedPoint { time: 0.0, position: nowhere }; 9]), []);
}

#[test]
fn poles_register_motion_among_trees_that_rings_on_the_ground_hide() {
    let mut lcg = Lcg::new(2);
    let (first, went) = (seen_from(&Point3f::origin(), true, &mut lcg), Point3f::new(0.15, 0.05, 0.0));
    let mut planes = PlaneMap::new(1.0);
    first.iter().for_each(|p| planes.insert(&p.position));
    let map = PoleMap::new(poles_of(&first).iter().map(|p| p.point.position), &PoleSettings::default());
    let second = seen_from(&went, true, &mut lcg);
    let points = poles_of(&second);
    let prior = MotionPrior {
        start: Sigmas { translation: 0.01, rotation: 0.01 },
        growth: Sigmas { translation: 0.3, rotation: 0.05 },
        compensates_attenuation: false,
    };
    let ground: Vec<TimedPoint> = second.iter().filter(|p| p.position.z < -0.8).step_by(6).copied().collect();
    let registration = Registration::new(RegistrationSettings::default());
    let off = |poles| {
        let found = registration.register_sweep(&planes, &ground, &standing(), &prior, 0.3, poles).unwrap();
        (found.pose.translation.vector - went.coords.cast::<f64>()).norm()
    };
    let (by_poles, by_ground) = (off(Some((&map, &points[..]))), off(None));
    assert!(by_poles < 0.03 && by_ground > 0.1, "{by_poles} {by_ground}");
}
