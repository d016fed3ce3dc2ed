//! The odometry as a whole: synthetic sweeps of rooms and corridors.
#![allow(clippy::unwrap_used)]

use portolan_geometry::{Duration, Point3f, Rigid3, Time, Vector3, to_f32};
use portolan_lidar_odometry::{
    Fallback, Issue, LidarOdometry, OdometrySettings, Phase, RegisteredSweep, Sweep, SweepError, SweepPoint,
};
use portolan_motion::DegenerateMotion;
use portolan_sensor::{ImuData, PointCloud};

fn at(seconds: f64) -> Time {
    Time::from_ticks(0) + Duration::from_seconds(seconds)
}

/// What a lidar of 32 beams and a noise of 1 cm sees from a pose in a room with these half lengths.
fn sweep(end: f64, pose: &Rigid3, half: Vector3) -> Sweep {
    let (place, room_from_scanner) = (pose.translation.vector, pose.rotation);
    let point = |i: i32| {
        let (azimuth, elevation) = (f64::from(i / 32) * 0.0105, f64::from(i % 32 - 16) * 0.035 + 0.01);
        let level = elevation.cos();
        let ray =
            room_from_scanner * Vector3::new(level * azimuth.cos(), level * azimuth.sin(), elevation.sin());
        let to_wall = |axis: usize| (half[axis].copysign(ray[axis]) - place[axis]) / ray[axis];
        let range = to_wall(0).min(to_wall(1)).min(to_wall(2));
        let noise = 0.01 * (f64::from(i) * 12.9898 + 78.233 * end).sin();
        let hit = Point3f::from((place + ray * (range + noise)).cast::<f32>());
        SweepPoint { time: 0.0, position: to_f32(&pose.inverse()) * hit, intensity: 0.0 }
    };
    Sweep {
        end: at(end),
        points: (0..32 * 600).map(point).filter(|p| p.position.coords.norm() < 60.0).collect(),
    }
}

fn room() -> Vector3 {
    Vector3::new(5.0, 4.0, 1.5)
}

/// Along a curve: 0.5 m/s, 0.2 rad/s.
fn truth(t: f64) -> Rigid3 {
    let angle = 0.2 * t;
    Rigid3::new(Vector3::new(2.5 * angle.sin(), 2.5 - 2.5 * angle.cos(), 0.0), Vector3::z() * angle)
}

/// Samples of a tenth of a second until `end`.
fn imu(end: f64) -> Vec<ImuData> {
    let sample = |j: i32| ImuData {
        time: at(end - 0.1 + 0.005 * f64::from(j)),
        linear_acceleration: Vector3::new(0.0, 0.1, 9.81),
        angular_velocity: Vector3::new(0.0, 0.0, 0.2),
    };
    (0..20).map(sample).collect()
}

/// Three seconds along the curve, and how far off it was at most, metres and radians.
fn follow(odometry: &mut LidarOdometry, with_imu: bool) -> (Vec<RegisteredSweep>, f64, f64) {
    let (mut registered, mut worst) = (Vec::new(), (0.0_f64, 0.0_f64));
    for i in 1..=30 {
        let end = 0.1 * f64::from(i);
        let samples = if with_imu { imu(end) } else { Vec::new() };
        registered.extend(odometry.register(&sweep(end, &truth(end), room()), &samples).unwrap());
    }
    for result in &registered {
        let t = result.sweep.end.seconds_since(at(0.0));
        // The local map begins where the first sweep ended; its heading is the gyroscope's.
        let expected = truth(0.1).inverse() * truth(t);
        let first = registered[0].local_from_tracking;
        let error = expected.inverse() * first.inverse() * result.local_from_tracking;
        worst = (worst.0.max(error.translation.vector.norm()), worst.1.max(error.rotation.angle()));
    }
    (registered, worst.0, worst.1)
}

#[test]
fn rotations_remain_normalized_over_many_maps() {
    let mut settings = OdometrySettings::default();
    // A map with every other sweep: as many as in a quarter of an hour.
    settings.local_map.keyframes_per_half = 1;
    settings.loss.sweeps = 1;
    let mut odometry = LidarOdometry::new(settings);
    let (registered, ..) = follow(&mut odometry, true);
    let last = registered.last().unwrap();
    let lengths = [last.local_from_tracking.rotation, last.gravity_from_tracking, last.local_from_gravity()]
        .map(|rotation| rotation.quaternion().norm());
    assert!(lengths.iter().all(|length| (length - 1.0).abs() < 1e-13), "{lengths:?}");
}

#[test]
fn a_curve_is_followed_with_and_without_an_imu() {
    for with_imu in [true, false] {
        let mut odometry = LidarOdometry::new(OdometrySettings::default());
        let (registered, metres, radians) = follow(&mut odometry, with_imu);
        assert!(metres < 0.03 && radians < 0.01, "{with_imu}: {metres} m, {radians} rad");
        assert_eq!((registered.len(), odometry.has_imu()), (30, Some(with_imu)));
        assert!(registered[0].keyframe.is_some() && odometry.issues().iter().next().is_none());
    }
}

#[test]
fn phases_follow_each_other() {
    let mut odometry = LidarOdometry::new(OdometrySettings::default());
    let mut phases = vec![odometry.phase()];
    for i in 1..=30 {
        let end = 0.1 * f64::from(i);
        imu(end).iter().for_each(|sample| odometry.add_imu(sample));
        odometry.push(sweep(end, &truth(end), room())).unwrap();
        while odometry.advance(None).is_some() {
            phases.push(odometry.phase());
        }
        phases.push(odometry.phase());
        phases.dedup();
    }
    assert_eq!(phases, [Phase::WaitingForGravity, Phase::WarmUp, Phase::Tracking]);
}

#[test]
fn a_single_sweep_is_registered_when_no_other_comes() {
    let mut odometry = LidarOdometry::new(OdometrySettings::default());
    odometry.push(sweep(0.1, &truth(0.1), room())).unwrap();
    assert!(odometry.advance(None).is_none());
    odometry.end();
    let only = odometry.advance(None).unwrap();
    assert!(only.keyframe.is_some() && only.local_from_tracking.translation.vector.norm() < 1e-9);
    assert_eq!(odometry.local_maps().count(), 1);
}

#[test]
fn empty_sweeps_and_sweeps_from_the_past_are_refused() {
    let mut odometry = LidarOdometry::new(OdometrySettings::default());
    follow(&mut odometry, false);
    let nothing = Sweep { end: at(3.1), points: Vec::new() };
    assert_eq!(odometry.register(&nothing, &[]).unwrap_err(), SweepError::Empty);
    assert_eq!(odometry.register(&sweep(2.0, &truth(2.0), room()), &[]).unwrap_err(), SweepError::TooOld);
    let counted: Vec<(Issue, u64)> = odometry.issues().iter().collect();
    assert_eq!(counted, [(Issue::EmptySweep, 1), (Issue::SweepTooOld, 1)]);
}

#[test]
fn along_a_corridor_translation_is_degenerate() {
    let mut odometry = LidarOdometry::new(OdometrySettings::default());
    let corridor = Vector3::new(1000.0, 2.2, 1.7);
    let mut last = None;
    for i in 1..=30 {
        let end = 0.1 * f64::from(i);
        last = odometry.register(&sweep(end, &Rigid3::identity(), corridor), &[]).unwrap().pop();
    }
    let degenerate = last.unwrap().observability.degenerate;
    assert_eq!((degenerate.translations.len(), degenerate.rotations.len()), (1, 0));
    assert!(degenerate.translations[0].x.abs() > 0.99);
    let intervals = odometry.degenerate_intervals();
    assert!(intervals.iter().all(|i| i.motion == DegenerateMotion::Along) && !intervals.is_empty());
}

struct Elsewhere(u32);

impl Fallback for Elsewhere {
    fn locate(&mut self, deskewed: &PointCloud, _: &Rigid3) -> Option<Rigid3> {
        self.0 += 1;
        (!deskewed.is_empty()).then(|| Rigid3::translation(7.0, 0.0, 0.0))
    }

    fn error(&self) -> f64 {
        0.2
    }
}

#[test]
fn the_fallback_map_locates_sweeps_that_fit_no_plane() {
    let mut odometry = LidarOdometry::new(OdometrySettings::default());
    follow(&mut odometry, false);
    // Far from everything.
    let points = (0..1000).map(|i| {
        let position = Point3f::new(100.0 + i as f32, (i * 7 % 13) as f32, (i * 5 % 11) as f32);
        SweepPoint { time: 0.0, position, intensity: 0.0 }
    });
    odometry.push(Sweep { end: at(3.1), points: points.collect() }).unwrap();
    // It is held back, for the lidar may be elsewhere, until no more sweeps come.
    odometry.end();
    let mut elsewhere = Elsewhere(0);
    let registered = odometry.advance(Some(&mut elsewhere)).unwrap();
    assert_eq!((elsewhere.0, registered.local_from_tracking.translation.x), (1, 7.0));
    assert_eq!(odometry.issues().of(Issue::NoPlaneFits), 1);
}

#[test]
fn complete_maps_come_with_their_last_key_frame() {
    let mut settings = OdometrySettings::default();
    (settings.local_map.keyframes_per_half, settings.keyframes.max_distance) = (5, 0.0);
    let (registered, ..) = follow(&mut LidarOdometry::new(settings), false);
    let is_complete = |r: &RegisteredSweep| r.keyframe.as_ref().is_some_and(|k| k.completed_map.is_some());
    let complete: Vec<usize> =
        registered.iter().enumerate().filter(|(_, r)| is_complete(r)).map(|(i, _)| i + 1).collect();
    assert_eq!(complete, [10, 15, 20, 25, 30]);
}

/// A hall that is wider, longer and higher than the room, seen from beside its middle.
fn hall() -> Vector3 {
    Vector3::new(14.0, 7.0, 2.6)
}

/// Three seconds in the room, then three in the hall, as if the lidar had been carried there, covered.
fn carried(odometry: &mut LidarOdometry, with_imu: bool) -> Vec<RegisteredSweep> {
    let elsewhere = Rigid3::new(Vector3::new(6.0, -3.0, 0.4), Vector3::z() * 1.1);
    let mut registered = Vec::new();
    for i in 1..=60 {
        let end = 0.1 * f64::from(i);
        let seen = match i {
            ..=30 => sweep(end, &truth(end), room()),
            _ => sweep(end, &(elsewhere * truth(end - 3.0)), hall()),
        };
        let samples = if with_imu { imu(end) } else { Vec::new() };
        registered.extend(odometry.register(&seen, &samples).unwrap());
    }
    registered
}

#[test]
fn a_lidar_that_was_carried_elsewhere_begins_a_new_piece_of_map() {
    for with_imu in [true, false] {
        let mut odometry = LidarOdometry::new(OdometrySettings::default());
        let registered = carried(&mut odometry, with_imu);
        // No sweep is lost, and none comes twice.
        let ends: Vec<Time> = registered.iter().map(|r| r.sweep.end).collect();
        assert_eq!(ends, (1..=60).map(|i| at(0.1 * f64::from(i))).collect::<Vec<_>>(), "{with_imu}");
        let begun: Vec<usize> = (0..60).filter(|i| registered[*i].new_piece.is_some()).collect();
        assert_eq!(begun, [30], "{with_imu}");
        let piece = registered[30].new_piece.as_ref().unwrap();
        let last = registered[29].local_from_tracking;
        let error = piece.old_from_new.translation.vector - last.translation.vector;
        assert!(piece.since == at(3.1) && error.norm() < 1e-9 && piece.maps.len() == 1, "{piece:?}");
        assert!(registered[30].keyframe.is_some());
        for (i, result) in registered.iter().enumerate().skip(31) {
            let expected = truth(0.1).inverse() * truth(0.1 * (i + 1) as f64 - 3.0);
            let moved = registered[30].local_from_tracking.inverse() * result.local_from_tracking;
            let error = (expected.inverse() * moved).translation.vector.norm();
            assert!(error < 0.04, "{with_imu}, {i}: {error}");
        }
        assert_eq!(odometry.issues().of(Issue::ContradictsMap), 11);
    }
}

/// A sweep of a lidar with a sheet over it, another one each time.
fn covered(end: f64) -> Sweep {
    let points = (0..2000).map(|i| {
        let (turn, rise) = (2.4 * f64::from(i), (0.61 * f64::from(i)).sin());
        let range = 0.3 + 0.15 * (7.3 * f64::from(i) + 31.0 * end).sin();
        let beam = Vector3::new(turn.cos(), turn.sin(), 0.5 * rise).normalize() * range;
        SweepPoint { time: 0.0, position: beam.cast::<f32>().into(), intensity: 0.0 }
    });
    Sweep { end: at(end), points: points.collect() }
}

#[test]
fn sweeps_of_a_covered_lidar_are_dropped() {
    for with_imu in [true, false] {
        let mut odometry = LidarOdometry::new(OdometrySettings::default());
        let mut registered = Vec::new();
        for i in 1..=60 {
            let end = 0.1 * f64::from(i);
            let seen = match i {
                31..=40 => covered(end),
                _ => sweep(end, &truth(end), room()),
            };
            let samples = if with_imu { imu(end) } else { Vec::new() };
            registered.extend(odometry.register(&seen, &samples).unwrap());
        }
        odometry.end();
        registered.extend(std::iter::from_fn(|| odometry.advance(None)));
        assert_eq!((registered.len(), odometry.issues().of(Issue::PlaceHidden)), (50, 10), "{with_imu}");
        assert!(registered.iter().all(|r| r.new_piece.is_none()), "{with_imu}");
        let [first, last] = [&registered[0], &registered[49]];
        let moved = first.local_from_tracking.inverse() * last.local_from_tracking;
        let error = (truth(0.1).inverse() * truth(6.0)).inverse() * moved;
        assert!(error.translation.vector.norm() < 0.05, "{with_imu}: {error}");
    }
}

#[test]
fn a_small_room_begins_a_new_piece_after_some_seconds() {
    let mut odometry = LidarOdometry::new(OdometrySettings::default());
    follow(&mut odometry, false);
    let mut registered = Vec::new();
    for i in 31..=120 {
        let closet = sweep(0.1 * f64::from(i), &Rigid3::identity(), 0.2 * room());
        registered.extend(odometry.register(&closet, &[]).unwrap());
    }
    assert_eq!(odometry.issues().of(Issue::PlaceHidden), 51);
    assert!(registered.iter().any(|r| r.new_piece.is_some()));
}

#[test]
fn a_recording_that_ends_with_suspect_sweeps_keeps_them_all() {
    let mut odometry = LidarOdometry::new(OdometrySettings::default());
    let mut registered = follow(&mut odometry, false).0;
    for i in 31..=34 {
        let end = 0.1 * f64::from(i);
        odometry.push(sweep(end, &Rigid3::translation(6.0, -3.0, 0.4), hall())).unwrap();
        assert!(odometry.advance(None).is_none());
    }
    odometry.end();
    registered.extend(std::iter::from_fn(|| odometry.advance(None)));
    assert_eq!(registered.len(), 34);
    assert!(registered[30..].iter().all(|r| r.keyframe.is_none() && r.new_piece.is_none()));
}

#[test]
fn a_pushed_lidar_is_located_in_its_map() {
    let mut odometry = LidarOdometry::new(OdometrySettings::default());
    let registered = follow(&mut odometry, false).0;
    // As far as a push takes it within 0.1 s.
    let pushed = truth(3.0) * Rigid3::new(Vector3::new(0.14, -0.05, 0.0), Vector3::z() * 0.7);
    for end in [3.1, 3.2] {
        let found = odometry.register(&sweep(end, &pushed, room()), &[]).unwrap().pop().unwrap();
        let moved = registered[29].local_from_tracking.inverse() * found.local_from_tracking;
        let error = (truth(3.0).inverse() * pushed).inverse() * moved;
        assert!(error.translation.vector.norm() < 0.04 && found.new_piece.is_none(), "{end}: {error}");
    }
}
