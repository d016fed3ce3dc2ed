use super::*;
use crate::MotionSource;
use crate::testing::Lcg;
use portolan_geometry::Vector3;
use portolan_geometry::{Duration, Time, to_f32};

/// Hits on the walls of a room, 8 m long, 5 m wide and 3 m high, with some noise.
fn room(lcg: &mut Lcg, with_ends: bool, noise: f32) -> Vec<Point3f> {
    let mut points = Vec::new();
    for _ in 0..3000 {
        let (u, v) = (lcg.symmetric(4.0), lcg.symmetric(2.5));
        let mut n = || lcg.symmetric(noise);
        points.push(Point3f::new(u, v, -1.0 + n()));
        points.push(Point3f::new(u, v, 2.0 + n()));
        points.push(Point3f::new(u, 2.5 + n(), 0.5 + 0.6 * v));
        points.push(Point3f::new(u, -2.5 + n(), 0.5 + 0.6 * v));
        if with_ends {
            points.push(Point3f::new(4.0 + n(), v, 0.5 + 0.37 * u));
            points.push(Point3f::new(-4.0 + n(), v, 0.5 + 0.37 * u));
        }
    }
    points
}

fn planes(points: &[Point3f]) -> PlaneMap {
    let mut map = PlaneMap::new(1.0);
    points.iter().for_each(|p| map.insert(p));
    map
}

fn seen_from(points: &[Point3f], pose: &Rigid3) -> Vec<Point3f> {
    points.iter().step_by(7).map(|p| to_f32(&pose.inverse()) * p).collect()
}

#[test]
fn a_scan_is_registered_to_millimetres() {
    let mut lcg = Lcg::new(5);
    let map = planes(&room(&mut lcg, true, 0.03));
    let expected = Rigid3::new(Vector3::new(0.4, -0.3, 0.1), Vector3::new(0.03, -0.02, 0.5));
    let scan = seen_from(&room(&mut lcg, true, 0.03), &expected);
    let initial = Rigid3::new(Vector3::new(0.25, -0.2, 0.0), Vector3::new(0.0, 0.0, 0.45));
    let prior = PosePrior { pose: initial, sigmas: Sigmas { translation: 0.1, rotation: 0.1 } };
    let registration = Registration::new(RegistrationSettings::default());
    let found = registration.register_scan(&map, &scan, &prior.pose, &prior, 0.3).unwrap();
    let error = expected.inverse() * found.pose;
    assert!(error.translation.vector.norm() < 0.003, "{error}");
    assert!(error.rotation.angle() < 0.001, "{error}");
    assert!(found.degenerate.is_empty() && found.matched_fraction > 0.9 && found.rms < 0.03, "{found:?}");
}

#[test]
fn along_a_bare_corridor_the_prior_decides() {
    let mut lcg = Lcg::new(6);
    let map = planes(&room(&mut lcg, false, 0.02));
    let expected = Rigid3::translation(0.3, 0.1, 0.0);
    let scan = seen_from(&room(&mut lcg, false, 0.02), &expected);
    let initial = Rigid3::translation(0.2, 0.0, 0.05);
    let prior = PosePrior { pose: initial, sigmas: Sigmas { translation: 0.1, rotation: 0.1 } };
    let registration = Registration::new(RegistrationSettings::default());
    let found = registration.register_scan(&map, &scan, &prior.pose, &prior, 0.3).unwrap();
    assert_eq!(found.degenerate.translations.len(), 1);
    assert!(found.degenerate.translations[0].x.abs() > 0.99 && found.degenerate.rotations.is_empty());
    let translation = found.pose.translation.vector;
    assert!((translation.y - 0.1).abs() < 0.005 && translation.z.abs() < 0.005, "{translation}");
    assert!((translation.x - 0.2).abs() < 0.03, "{translation}");
}

#[test]
fn a_scan_far_from_all_planes_is_not_matched() {
    let map = planes(&room(&mut Lcg::new(7), true, 0.01));
    let far = Rigid3::translation(100.0, 0.0, 0.0);
    let prior = PosePrior { pose: far, sigmas: Sigmas { translation: 0.1, rotation: 0.1 } };
    let registration = Registration::new(RegistrationSettings::default());
    let points = [Point3f::origin(); 100];
    assert_eq!(registration.register_scan(&map, &points, &prior.pose, &prior, 0.3), None);
    assert_eq!(registration.register_scan(&map, &[], &prior.pose, &prior, 0.3), None);
}

#[test]
fn hits_spread_along_their_beam_do_not_constrain_translations() {
    // A lidar that moved unnoticed over uneven ground: every beam hit it at several ranges.
    let mut lcg = Lcg::new(8);
    let mut sweep = |count: usize| -> Vec<Point3f> {
        let mut points = Vec::new();
        for i in 0..count {
            let azimuth = (i % 360) as f32 * std::f32::consts::TAU / 360.0;
            for elevation in [-15.0_f32, -13.0, -11.0, -9.0, -7.0, -5.0] {
                let slope = elevation.to_radians().tan();
                let range = -1.8 / slope * (1.0 + lcg.symmetric(0.12));
                let noise = lcg.symmetric(0.01);
                points.push(Point3f::new(
                    range * azimuth.cos(),
                    range * azimuth.sin(),
                    range * slope + noise,
                ));
            }
        }
        points
    };
    let mut map = PlaneMap::new(1.0);
    sweep(7200).iter().for_each(|p| map.insert_seen_from(p, &Point3f::origin()));
    let scan = sweep(360);
    let pose = Rigid3::identity();
    let prior = PosePrior { pose, sigmas: Sigmas { translation: 0.05, rotation: 0.01 } };
    let registration = Registration::new(RegistrationSettings::default());
    let found = registration.register_scan(&map, &scan, &prior.pose, &prior, 0.3).unwrap();
    let level = found.degenerate.translations.iter().filter(|d| d.z.abs() < 0.3).count();
    assert_eq!(level, 2, "{:?}", found.degenerate);
}

#[test]
fn rotation_about_the_axis_of_a_long_tunnel_is_not_degenerate() {
    // Far points are near the axis: errors of their normals give no spurious information about a rotation
    // about it.
    let mut lcg = Lcg::new(9);
    let mut points = Vec::new();
    for _ in 0..40_000 {
        let (u, v) = (lcg.symmetric(60.0), lcg.symmetric(2.5));
        let mut n = || lcg.symmetric(0.02);
        points.push(Point3f::new(u, v, -1.0 + n()));
        points.push(Point3f::new(u, 2.5 + n(), 0.5 + 0.6 * v));
        points.push(Point3f::new(u, -2.5 + n(), 0.5 + 0.6 * v));
    }
    let map = planes(&points);
    let pose = Rigid3::identity();
    let prior = PosePrior { pose, sigmas: Sigmas { translation: 0.05, rotation: 0.05 } };
    let registration = Registration::new(RegistrationSettings::default());
    let found =
        registration.register_scan(&map, &seen_from(&points, &pose), &prior.pose, &prior, 0.3).unwrap();
    assert!(
        found.degenerate.rotations.is_empty() && found.degenerate.translations.len() == 1,
        "{:?}",
        found.degenerate
    );
}

#[test]
fn a_sweep_with_wrong_start_and_velocity_is_registered() {
    let mut lcg = Lcg::new(10);
    let map = planes(&room(&mut lcg, true, 0.02));
    // The segment moves with 1 m/s and rotates with 1 rad/s; the prediction starts 1 cm beside it and is
    // slower.
    let pose_at =
        |speed: f64, t: f64, beside: f64| Rigid3::new(Vector3::new(speed * t, beside, 0.0), Vector3::z() * t);
    let (start, seconds) = (Time::from_ticks(0), 0.1);
    let end = start + Duration::from_seconds(seconds);
    let mut segment = TrajectorySegment::new(start, end, |t| pose_at(0.6, t.seconds_since(start), 0.01));
    (segment.gyroscope_sigma, segment.source) = (Some(0.0), MotionSource::Standing);
    let fixed = room(&mut lcg, true, 0.02);
    let points: Vec<TimedPoint> = fixed
        .iter()
        .step_by(7)
        .enumerate()
        .map(|(i, p)| {
            let t = seconds * (i * 7) as f64 / fixed.len() as f64;
            TimedPoint { time: (t - seconds) as f32, position: to_f32(&pose_at(1.0, t, 0.0).inverse()) * p }
        })
        .collect();
    let prior = MotionPrior {
        start: Sigmas { translation: 0.02, rotation: 0.005 },
        growth: Sigmas { translation: 0.05, rotation: 0.01 },
        compensates_attenuation: false,
    };
    let registration = Registration::new(RegistrationSettings::default());
    let found = registration.register_sweep(&map, &points, &segment, &prior, 0.3, None).unwrap();
    let error = pose_at(1.0, seconds, 0.0).inverse() * found.pose;
    assert!(error.translation.vector.norm() < 0.004, "{error}");
    assert!((found.correction.start.y + 0.01).abs() < 0.003, "{:?}", found.correction);
    assert!((found.correction.growth.x - 0.04).abs() < 0.006, "{:?}", found.correction);
}
