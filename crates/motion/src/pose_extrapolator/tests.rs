use super::*;
use portolan_geometry::{angular_distance, rotation_between, rotation_from_roll_pitch_yaw};
use proptest::prelude::*;

fn at(seconds: f64) -> Time {
    Time::from_ticks((seconds * 1e7 + 0.5).floor() as i64)
}

fn pose_2d(x: f64, y: f64, yaw: f64) -> Rigid3 {
    Rigid3::new(Vector3::new(x, y, 0.0), Vector3::z() * yaw)
}

fn odometry(seconds: f64, pose: Rigid3) -> OdometryData {
    OdometryData { time: at(seconds), odom_from_tracking: pose }
}

fn imu(seconds: f64, acceleration: [f64; 3], rate: [f64; 3]) -> ImuData {
    ImuData { time: at(seconds), linear_acceleration: acceleration.into(), angular_velocity: rate.into() }
}

fn difference(a: &Rigid3, b: &Rigid3) -> (f64, f64) {
    ((a.translation.vector - b.translation.vector).norm(), angular_distance(&a.rotation, &b.rotation))
}

fn is_near(a: &Rigid3, b: &Rigid3, metres: f64, radians: f64) -> bool {
    let (distance, angle) = difference(a, b);
    distance < metres && angle < radians
}

#[test]
fn without_odometry_the_velocity_of_poses_continues() {
    let along = |x: f64| Rigid3::translation(x, 0.0, 0.0);
    let mut extrapolator = PoseExtrapolator::new(0.001, 10.0, true);
    for i in 0..3 {
        extrapolator.add_pose(at(0.1 * f64::from(i)), along(f64::from(i)));
    }
    for i in 0..4 {
        extrapolator.add_odometry(&odometry(0.1 * f64::from(i), along(0.0))).unwrap();
    }
    let mut without = extrapolator.without_odometry();
    assert!(extrapolator.has_odometry(at(0.3)) && !without.has_odometry(at(0.3)));
    assert!(is_near(&extrapolator.extrapolate_pose(at(0.3)), &along(2.0), 1e-6, 1e-6), "wheels stand");
    assert!(is_near(&without.extrapolate_pose(at(0.3)), &along(3.0), 1e-6, 1e-6), "poses continue");
}

/// The golden run of `vectors.md` §9: the prediction at the end of each of four steps, the gravity
/// orientation there, and the prediction half a step later.
fn golden_run() -> Vec<(Rigid3, Quaternion, Rigid3)> {
    let mut state = 11_u32;
    let mut uniform = |a: f32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 8) as f32 / 16_777_216.0 * 2.0 - 1.0) * a
    };
    let mut extrapolator = PoseExtrapolator::new(0.001, 10.0, false);
    extrapolator.add_pose(at(0.0), Rigid3::identity());
    let mut results = Vec::new();
    for s in 1..=4 {
        let s = f64::from(s);
        for j in 1..=10 {
            let t = 0.1 * (s - 1.0) + 0.01 * f64::from(j);
            let mut rate = [uniform(0.2), uniform(0.2), uniform(0.2)].map(f64::from);
            rate[2] += 0.5;
            extrapolator.add_imu(&imu(t, [0.1, -0.2, 9.7], rate)).unwrap();
            if j % 5 == 0 {
                extrapolator.add_odometry(&odometry(t - 0.002, pose_2d(0.8 * t, 0.1 * t, 0.5 * t))).unwrap();
            }
        }
        let end = extrapolator.extrapolate_pose(at(0.1 * s));
        let gravity = extrapolator.estimate_gravity_orientation(at(0.1 * s));
        let rotation = rotation_from_roll_pitch_yaw(0.01 * s, 0.0, 0.05 * s);
        let translation = na::Translation3::new(0.08 * s, 0.01 * s, 0.0);
        extrapolator.add_pose(at(0.1 * s), Rigid3::from_parts(translation, rotation));
        results.push((end, gravity, extrapolator.extrapolate_pose(at(0.1 * s + 0.05))));
    }
    results
}

fn assert_golden(pose: &Rigid3, translation: [f64; 3], rotation_wxyz: [f64; 4]) {
    assert!((pose.translation.vector - Vector3::from(translation)).amax() < 1e-12, "{pose}");
    assert_golden_rotation(&pose.rotation, rotation_wxyz);
}

fn assert_golden_rotation(q: &Quaternion, wxyz: [f64; 4]) {
    let difference = na::Vector4::new(q.w, q.i, q.j, q.k) - na::Vector4::from(wxyz);
    assert!(difference.amax() < 1e-12, "{q:?}");
}

#[test]
fn golden_first_step() {
    let (end, gravity, later) = golden_run()[0];
    let q = [0.999793062541, -0.003025492348, -0.000328802277, 0.020113934964];
    assert_golden(&end, [0.080103619472, 0.009132901800, -0.000015880670], q);
    assert_golden_rotation(&gravity, q);
    let q = [0.999128088505, 0.000472134806, -0.001499998871, 0.041720376949];
    assert_golden(&later, [0.120051809736, 0.014566450900, -0.000007940335], q);
}

#[test]
fn golden_fourth_step() {
    let (end, gravity, later) = golden_run()[3];
    let q = [0.995270321999, 0.015921749624, 0.005060321468, 0.095696798190];
    assert_golden(&end, [0.320017681026, 0.039846601719, -0.000463851046], q);
    assert_golden_rotation(&gravity, [0.995337990680, -0.008036118408, -0.000474020702, 0.096111812044]);
    let q = [0.993696080857, 0.016779042331, 0.000752798599, 0.110842211822];
    assert_golden(&later, [0.360008840513, 0.044923300860, -0.000231925523], q);
}

#[test]
fn without_a_pose_there_is_no_prediction() {
    for use_all_odometry in [false, true] {
        let mut extrapolator = PoseExtrapolator::new(0.1, 0.1, use_all_odometry);
        assert_eq!(extrapolator.extrapolate_pose(at(1.0)), Rigid3::identity());
        extrapolator.add_imu(&imu(1.0, [0.0, 0.0, 9.8], [0.0; 3])).unwrap();
        assert_eq!(extrapolator.extrapolate_pose(at(1.0)), Rigid3::identity());
        assert_eq!(extrapolator.estimate_gravity_orientation(at(1.0)), Quaternion::identity());
        assert_eq!((extrapolator.counts().queries_too_early, extrapolator.last_pose_time()), (2, None));
    }
}

#[test]
fn old_data_is_counted_and_rejected() {
    for use_all_odometry in [false, true] {
        let mut extrapolator = PoseExtrapolator::new(0.1, 0.1, use_all_odometry);
        let pose = pose_2d(1.0, 2.0, 0.3);
        extrapolator.add_pose(at(100.0), pose);
        assert!(is_near(&extrapolator.extrapolate_pose(at(100.0)), &pose, 1e-8, 1e-8));
        assert!(is_near(&extrapolator.extrapolate_pose(at(90.0)), &pose, 1e-8, 1e-8));
        extrapolator.extrapolate_pose(at(120.0));
        assert_eq!(extrapolator.last_extrapolated_time(), Some(at(120.0)));
        assert!(is_near(&extrapolator.extrapolate_pose(at(100.0)), &pose, 1e-8, 1e-8));
        extrapolator.add_pose(at(99.0), pose_2d(7.0, 7.0, 0.0));
        assert_eq!(extrapolator.last_pose_time(), Some(at(100.0)));
        let old = imu(99.0, [0.0, 0.0, 9.8], [0.0; 3]);
        assert_eq!(extrapolator.add_imu(&old), Err(ExtrapolatorError::OlderThanLastPose));
        let bad = imu(101.0, [f64::NAN, 0.0, 9.8], [0.0; 3]);
        assert_eq!(extrapolator.add_imu(&bad), Err(ExtrapolatorError::NotFinite));
        assert_eq!(extrapolator.add_odometry(&odometry(99.0, pose)).is_ok(), use_all_odometry);
        let counts = extrapolator.counts();
        assert_eq!((counts.rejected_poses, counts.rejected_imu, counts.queries_too_early), (1, 2, 1));
    }
}

#[test]
fn an_imu_measures_the_vertical() {
    let acceleration = [1.6, 2.0, 8.0];
    let expected = rotation_between(&Vector3::from(acceleration), &Vector3::z());
    let mut extrapolator =
        PoseExtrapolator::from_imu(0.1, 0.1, false, &imu(5.0, acceleration, [0.0; 3])).unwrap();
    assert!(angular_distance(&extrapolator.estimate_gravity_orientation(at(5.0)), &expected) < 1e-8);
    for k in 1..=10 {
        let time = 5.0 + 0.1 * f64::from(k);
        extrapolator.add_imu(&imu(time, acceleration, [0.0; 3])).unwrap();
        assert!(angular_distance(&extrapolator.estimate_gravity_orientation(at(time)), &expected) < 1e-8);
    }
    assert!(angular_distance(&extrapolator.extrapolate_pose(at(6.0)).rotation, &expected) < 1e-8);
}

#[test]
fn constant_velocity_continues() {
    for use_all_odometry in [false, true] {
        let mut extrapolator = PoseExtrapolator::new(0.5, 0.1, use_all_odometry);
        let mut pose = Rigid3::identity();
        let step = |seconds: f64| {
            let rotation = quaternion_from_angle_axis(&(Vector3::new(0.01, 0.0, 0.1) * seconds));
            Rigid3::from_parts(na::Translation3::new(0.0, 0.1 * seconds, 0.0), rotation)
        };
        for second in 0..20 {
            let time = f64::from(second);
            extrapolator.add_pose(at(time), pose);
            if second >= 2 {
                assert!(is_near(&extrapolator.extrapolate_pose(at(time)), &pose, 1e-8, 1e-8));
                let expected = pose * step(0.1);
                let predicted = extrapolator.extrapolate_pose(at(time + 0.1));
                assert!(is_near(&predicted, &expected, 1e-2, 1e-2), "{predicted} {expected}");
                assert_eq!(extrapolator.last_pose_time(), Some(at(time)));
                assert_eq!(extrapolator.last_extrapolated_time(), Some(at(time + 0.1)));
                let up = extrapolator.estimate_gravity_orientation(at(time + 0.1)) * Vector3::z();
                assert!((up - Vector3::z()).norm() < 1e-2);
            }
            pose *= step(1.0);
        }
    }
}

#[test]
fn a_gyroscope_measures_rotations() {
    for use_all_odometry in [false, true] {
        let at_rest = imu(0.0, [0.0, 0.0, 9.8], [0.0; 3]);
        let mut extrapolator = PoseExtrapolator::from_imu(0.5, 0.1, use_all_odometry, &at_rest).unwrap();
        let (mut time, mut yaw) = (0.0, 0.0);
        while time < 2.5 {
            time += 0.1;
            extrapolator.add_imu(&imu(time, [0.0, 0.0, 9.8], [0.0; 3])).unwrap();
            extrapolator.add_pose(at(time), Rigid3::identity());
        }
        for _ in 0..3 {
            for _ in 0..10 {
                extrapolator.add_imu(&imu(time, [0.0, 0.0, 9.8], [0.0, 0.0, 0.1])).unwrap();
                time += 0.1;
                yaw += 0.01;
            }
            let predicted = extrapolator.extrapolate_pose(at(time));
            assert!(is_near(&predicted, &pose_2d(0.0, 0.0, yaw), 1e-2, 1e-2), "{predicted} {yaw}");
            let up = extrapolator.estimate_gravity_orientation(at(time)) * Vector3::z();
            assert!((up - Vector3::z()).norm() < 1e-8);
            extrapolator.add_pose(at(time), pose_2d(0.0, 0.0, yaw));
        }
    }
}

mod all_odometry {
    use super::*;

    /// Straight on for a second, then a tight curve, then straight again.
    fn truth(seconds: f64) -> Rigid3 {
        let straight = |s: f64| pose_2d(0.8 * s, 0.0, 0.0);
        let quarter = ScrewMotion::to(&pose_2d(0.5, 0.5, std::f64::consts::FRAC_PI_2));
        let turn = |s: f64| quarter.fraction(s);
        straight(seconds.min(1.0))
            * turn((seconds - 1.0).clamp(0.0, 1.0))
            * straight((seconds - 2.0).max(0.0))
    }

    /// Scans at 5 Hz; the largest errors of prediction at all times between them, metres and radians.
    /// Odometry (seen through `distort`) comes every `interval` seconds, gyroscope data at 100 Hz.
    fn largest_errors(
        use_all_odometry: bool,
        interval: Option<f64>,
        gyroscope: bool,
        distort: impl Fn(f64, Rigid3) -> Rigid3,
    ) -> (f64, f64) {
        let mut extrapolator = PoseExtrapolator::new(0.001, 10.0, use_all_odometry);
        let (mut worst_distance, mut worst_angle) = (0.0_f64, 0.0_f64);
        let (mut next_odometry, mut next_imu) = (0.0, 0.0);
        for scan in 0..15 {
            let end = 0.2 * f64::from(scan);
            while gyroscope && next_imu <= end + 1e-9 {
                let rate = if (1.0..2.0).contains(&next_imu) { std::f64::consts::FRAC_PI_2 } else { 0.0 };
                let _ = extrapolator.add_imu(&imu(next_imu, [0.0, 0.0, 9.8], [0.0, 0.0, rate]));
                next_imu += 0.01;
            }
            while let Some(interval) = interval.filter(|_| next_odometry <= end + 1e-9) {
                let pose = distort(next_odometry, truth(next_odometry));
                let _ = extrapolator.add_odometry(&odometry(next_odometry, pose));
                next_odometry += interval;
            }
            for point in 1..=20 {
                let time = end - 0.2 + 0.01 * f64::from(point);
                if scan > 1 {
                    let (distance, angle) =
                        difference(&extrapolator.extrapolate_pose(at(time)), &truth(time));
                    worst_distance = worst_distance.max(distance);
                    worst_angle = worst_angle.max(angle);
                }
            }
            extrapolator.add_pose(at(end), truth(end));
        }
        (worst_distance, worst_angle)
    }

    const UNCHANGED: fn(f64, Rigid3) -> Rigid3 = |_, pose| pose;

    #[test]
    fn odometry_is_followed_through_a_turn() {
        let (distance, angle) = largest_errors(true, Some(0.02), false, UNCHANGED);
        assert!(distance < 1e-6 && angle < 1e-6, "{distance} {angle}");
    }

    #[test]
    fn odometry_at_the_rate_of_scans_is_enough() {
        let (distance, angle) = largest_errors(true, Some(0.2), false, UNCHANGED);
        assert!(distance < 1e-6 && angle < 1e-6, "{distance} {angle}");
        // Cartographer predicts a straight line.
        let (distance, _) = largest_errors(false, Some(0.2), false, UNCHANGED);
        assert!(distance > 0.03, "{distance}");
    }

    #[test]
    fn odometry_may_end_a_little_before_the_scan() {
        let late = |time: f64, _: Rigid3| truth(time);
        let (distance, angle) = largest_errors(true, Some(0.03), false, late);
        assert!(distance < 0.01 && angle < 0.05, "{distance} {angle}");
    }

    #[test]
    fn the_gyroscope_is_trusted_for_turning() {
        // Wheels that measure distance but not rotation.
        let blind = |seconds: f64, _: Rigid3| pose_2d(truth_path_length(seconds), 0.0, 0.0);
        let (distance, angle) = largest_errors(true, Some(0.02), true, blind);
        assert!(distance < 0.005 && angle < 0.02, "{distance} {angle}");
    }

    fn truth_path_length(seconds: f64) -> f64 {
        let radius = 0.5;
        let arc = radius * std::f64::consts::FRAC_PI_2;
        0.8 * seconds.min(1.0) + arc * (seconds - 1.0).clamp(0.0, 1.0) + 0.8 * (seconds - 2.0).max(0.0)
    }

    #[test]
    fn without_measurements_an_arc_continues() {
        let quarter = ScrewMotion::to(&pose_2d(0.5, 0.5, std::f64::consts::FRAC_PI_2));
        let circle = |time: f64| quarter.fraction(time);
        let mut extrapolator = PoseExtrapolator::new(0.001, 10.0, true);
        for scan in 0..10 {
            let time = 0.2 * f64::from(scan);
            extrapolator.add_pose(at(time), circle(time));
        }
        for time in [1.85, 1.9, 2.0, 1.81] {
            assert!(is_near(&extrapolator.extrapolate_pose(at(time)), &circle(time), 1e-6, 1e-6));
        }
        // Between the last two poses it is interpolated.
        let between = extrapolator.extrapolate_pose(at(1.7));
        assert!(is_near(&between, &circle(1.7), 0.01, 1e-3));
    }

    #[test]
    fn a_reset_of_odometry_is_detected() {
        let reset = |time: f64, pose: Rigid3| if time < 1.5 { pose } else { pose_2d(5.0, -3.0, 2.0) * pose };
        let (distance, angle) = largest_errors(true, Some(0.02), false, reset);
        assert!(distance < 0.05 && angle < 0.1, "{distance} {angle}");
    }

    #[test]
    fn odometry_that_stops_is_no_longer_used() {
        let mut extrapolator = PoseExtrapolator::new(0.001, 10.0, true);
        for scan in 0..20 {
            let time = 0.2 * f64::from(scan);
            if scan < 5 {
                extrapolator.add_odometry(&odometry(time, Rigid3::identity())).unwrap();
            }
            extrapolator.add_pose(at(time), pose_2d(time, 0.0, 0.0));
        }
        let predicted = extrapolator.extrapolate_pose(at(4.0));
        assert!(is_near(&predicted, &pose_2d(4.0, 0.0, 0.0), 1e-6, 1e-6), "{predicted}");
    }

    #[test]
    fn a_gyroscope_that_stops_is_no_longer_used() {
        let mut extrapolator = PoseExtrapolator::new(0.001, 10.0, true);
        for tick in 0..100 {
            let time = 0.02 * f64::from(tick);
            if time < 1.0 {
                extrapolator.add_imu(&imu(time, [0.0, 0.0, 9.8], [0.0, 0.0, 0.5])).unwrap();
            }
            extrapolator.add_odometry(&odometry(time, pose_2d(time, 0.0, 0.0))).unwrap();
            if tick % 10 == 0 {
                extrapolator.add_pose(at(time), pose_2d(time, 0.0, 0.0));
            }
        }
        let predicted = extrapolator.extrapolate_pose(at(1.98));
        assert!(is_near(&predicted, &pose_2d(1.98, 0.0, 0.0), 1e-6, 1e-6), "{predicted}");
    }

    #[test]
    fn memory_is_bounded_while_no_scan_arrives() {
        let mut extrapolator = PoseExtrapolator::new(0.001, 10.0, true);
        extrapolator.add_pose(at(0.0), Rigid3::identity());
        for tick in 0..100_000 {
            let time = 0.005 * f64::from(tick);
            extrapolator.add_imu(&imu(time, [0.0, 0.0, 9.8], [0.0, 0.0, 0.01])).unwrap();
            let _ = extrapolator.add_odometry(&odometry(time, pose_2d(0.1 * time, 0.0, 0.01 * time)));
        }
        assert!(extrapolator.imu.len() <= IMU_CAPACITY && extrapolator.odometry.len() <= 20_000);
        let predicted = extrapolator.extrapolate_pose(at(499.0));
        assert!(is_near(&predicted, &pose_2d(49.9, 0.0, 4.99), 0.1, 0.01), "{predicted}");
    }
}

proptest! {
    #[test]
    fn any_sequence_of_calls_keeps_a_valid_pose(
        use_all_odometry: bool,
        calls in prop::collection::vec(
            (0..5usize, prop_oneof![-3.0..3.0f64, Just(f64::NAN), Just(1e300), Just(-1e15)], prop::array::uniform3(-9.0..9.0f64)),
            0..60,
        ),
    ) {
        let mut extrapolator = PoseExtrapolator::new(0.1, 1.0, use_all_odometry);
        let mut newest = 0.0;
        for (call, step, v) in calls {
            newest += if step.abs() < 10.0 { step + 1.0 } else { 0.0 };
            let time = if step.abs() < 10.0 { at(newest) } else { Time::from_unix_seconds(step) };
            let pose = Rigid3::new(Vector3::from(v), Vector3::from(v) / 3.0);
            match call {
                0 => extrapolator.add_pose(time, pose),
                1 => { let _ = extrapolator.add_imu(&ImuData { time, linear_acceleration: v.into(), angular_velocity: v.into() }); }
                2 => { let _ = extrapolator.add_odometry(&OdometryData { time, odom_from_tracking: pose }); }
                3 => prop_assert!(is_valid_pose(&extrapolator.extrapolate_pose(time))),
                _ => prop_assert!(extrapolator.estimate_gravity_orientation(time).coords.iter().all(|c| c.is_finite())),
            }
        }
    }
}

#[test]
fn prediction_continues_after_the_imu_stops() {
    let settings = ImuBasedSettings::default();
    let mut extrapolator = PoseExtrapolator::new(0.001, 10.0, false).with_imu_based(&settings);
    for i in 0..=100 {
        let t = 0.01 * f64::from(i);
        extrapolator.add_imu(&imu(t, [0.0, 0.0, 9.80665], [0.0; 3])).unwrap();
        if i % 10 == 0 {
            extrapolator.add_pose(at(t), Rigid3::translation(t, 0.0, 0.0));
        }
    }
    // Two seconds of scans without an IMU.
    for i in 11..=30 {
        let t = 0.1 * f64::from(i);
        let truth = Rigid3::translation(t, 0.0, 0.0);
        extrapolator.prepare(at(t));
        let predicted = extrapolator.extrapolate_pose(at(t));
        assert!(is_near(&predicted, &truth, 0.02, 0.01), "{t}: {predicted}");
        extrapolator.add_pose(at(t), truth);
    }
}

#[test]
fn sparse_readings_measure_the_distance_and_not_the_motion() {
    let along = |x: f64| Rigid3::translation(x, 0.0, 0.0);
    let drive = |readings: &[f64]| {
        let mut extrapolator = PoseExtrapolator::new(0.1, 10.0, true);
        for (t, x) in [(0.8, 0.0), (0.9, 0.1), (1.0, 0.2)] {
            extrapolator.add_pose(at(t), along(x));
        }
        // Half as fast as the poses.
        for t in readings {
            extrapolator.add_odometry(&odometry(*t, along(0.5 * t))).unwrap();
        }
        let predicted = extrapolator.extrapolate_pose(at(1.2)).translation.x;
        let interpolated = extrapolator.between_readings(at(1.2)).map(|pose| pose.translation.x);
        (extrapolator.measured_since_last_pose(at(1.2)), predicted, interpolated)
    };
    let near = |found: f64, wanted: f64| (found - wanted).abs() < 1e-9;
    let (is_measured, predicted, interpolated) = drive(&[0.9, 1.1, 1.3]);
    assert!(is_measured && near(predicted, 0.3) && interpolated.is_none(), "{predicted} {interpolated:?}");
    let (is_measured, predicted, interpolated) = drive(&[0.5, 1.5]);
    assert!(
        !is_measured && near(predicted, 0.4) && near(interpolated.unwrap(), 0.3),
        "{predicted} {interpolated:?}"
    );
    // Data before the last pose does not determine the motion after it.
    let (is_measured, predicted, interpolated) = drive(&[0.8, 0.9]);
    assert!(!is_measured && near(predicted, 0.4) && interpolated.is_none(), "{predicted} {interpolated:?}");
}
