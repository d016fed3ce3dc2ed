use super::super::mounting::find_mounting;
use super::*;
use portolan_geometry::quaternion_from_angle_axis;
use portolan_sensor::ImuData;

/// Steps, and rest for half of the time.
fn rate(t: f64) -> Vector3 {
    if (12.0..32.0).contains(&t) {
        return Vector3::zeros();
    }
    Vector3::new(0.1 * (4.4 * t).cos(), 0.13 * (8.8 * t).sin(), 0.05 * (0.7 * t).cos())
}

fn at(seconds: f64) -> Time {
    Time::UNIX_EPOCH + Duration::from_seconds(seconds)
}

/// A gyroscope that is stamped `late`, biased, and mounted a degree off.
fn gyroscope(late: f64) -> Gyroscope {
    gyroscope_that(late, |rate| rate)
}

/// The same with other axes or units: `measured` changes each rate.
fn gyroscope_that(late: f64, measured: impl Fn(Vector3) -> Vector3) -> Gyroscope {
    let mut gyroscope = Gyroscope::default();
    let mounting = quaternion_from_angle_axis(&Vector3::new(0.01, -0.01, 0.015));
    for i in 0..8000 {
        let t = 0.005 * f64::from(i);
        gyroscope.add(&ImuData {
            time: at(t + late),
            linear_acceleration: Vector3::z(),
            angular_velocity: mounting * measured(rate(t)) + Vector3::new(0.005, -0.004, 0.002),
        });
    }
    gyroscope
}

/// Sweeps whose rotations are wrong by about `noise`, and some by much more.
fn sweeps(noise: f64) -> Vec<TrackedSweep> {
    let mut rotation = Quaternion::identity();
    let mut state = 7_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 23) - 1.0
    };
    let mut of_sweep = |i: i32| {
        let begin = 0.1 * f64::from(i);
        for k in 0..20 {
            rotation *= quaternion_from_angle_axis(&(rate(begin + 0.005 * (f64::from(k) + 0.5)) * 0.005));
        }
        let size = if i % 25 == 0 { 50.0 * noise } else { noise };
        let error = Vector3::new(random(), random(), random()) * size;
        TrackedSweep {
            time: at(begin + 0.1),
            rotation: rotation * quaternion_from_angle_axis(&error),
            covariance: Matrix3::from_diagonal_element(noise * noise),
            segment: 0,
        }
    };
    (0..380).map(&mut of_sweep).collect()
}

#[test]
fn offsets_are_found_in_spite_of_bias_mounting_and_wrong_matches() {
    let sweeps = sweeps(5e-4);
    for late in [0.0, 0.02, -0.05, 0.2] {
        let found = find_lag(&sweeps, &gyroscope(late)).unwrap();
        assert!((found.seconds - late).abs() < 0.003, "{late}: {found:?}");
        assert!(found.sigma < 0.0015, "{late}: {found:?}");
    }
}

#[test]
fn misalignments_are_found_together_with_offsets() {
    let sweeps = sweeps(5e-4);
    for degrees in [0.0, 5.0, -12.0] {
        let mounted = quaternion_from_angle_axis(&Vector3::new(0.0, f64::to_radians(degrees), 0.0));
        let Lag { misalignment, misalignment_sigma, .. } =
            find_lag(&sweeps, &gyroscope_that(0.02, |rate| mounted * rate)).unwrap();
        // The gyroscope is mounted a degree off in any case.
        let all = quaternion_from_angle_axis(&Vector3::new(0.01, -0.01, 0.015)) * mounted;
        let left = quaternion_from_angle_axis(&misalignment) * all;
        assert!(left.angle().to_degrees() < 0.5, "{degrees}: {misalignment}");
        assert!(misalignment_sigma.to_degrees() < 0.15, "{degrees}: {misalignment_sigma}");
    }
}

#[test]
fn noisy_rotations_are_uncertain_and_unrelated_ones_give_no_lag() {
    let [good, poor] = [5e-4, 0.004].map(|noise| find_lag(&sweeps(noise), &gyroscope(0.0)).unwrap());
    assert!(poor.sigma > 5.0 * good.sigma && poor.seconds.abs() < 4.0 * poor.sigma, "{poor:?} {good:?}");
    let mut other = Gyroscope::default();
    for i in 0..8000 {
        let t = 0.005 * f64::from(i);
        let angular_velocity = Vector3::new(0.1 * (3.1 * t).cos(), 0.2 * (1.9 * t).sin(), 0.1);
        other.add(&ImuData { time: at(t), linear_acceleration: Vector3::z(), angular_velocity });
    }
    assert_eq!(find_lag(&sweeps(5e-4), &other), None);
    assert_eq!(find_lag(&[], &gyroscope(0.0)), None);
    assert_eq!(find_lag(&sweeps(5e-4), &Gyroscope::default()), None);
}

#[test]
fn wrong_axes_signs_and_units_are_detected() {
    let turns = turns(&sweeps(5e-4));
    let found = |late: f64, measured: &dyn Fn(Vector3) -> Vector3| {
        find_mounting(&turns, &gyroscope_that(late, measured))
    };
    assert_eq!(found(0.0, &|rate| rate), None);
    assert_eq!(found(0.2, &|rate| 0.7 * rate), None);
    let (turned, factor) = found(0.1, &|rate| -rate).unwrap();
    assert!(turned == 0.0 && (factor + 1.0).abs() < 0.05, "{turned} {factor}");
    // Rotations this large do not add up as vectors.
    let (turned, factor) = found(0.0, &|rate| 57.3 * rate).unwrap();
    assert!(turned < 0.3 && (factor / 57.3 - 1.0).abs() < 0.05, "{turned} {factor}");
    let (turned, factor) = found(-0.1, &|rate| Vector3::new(-rate.y, rate.x, rate.z)).unwrap();
    assert!((turned.to_degrees() - 90.0).abs() < 5.0 && (factor - 1.0).abs() < 0.05, "{turned} {factor}");
    // Another object that rotates.
    assert_eq!(found(0.0, &|rate| Vector3::new(0.3 * (90.0 * rate.x).sin(), rate.x * rate.y, 0.1)), None);
}
