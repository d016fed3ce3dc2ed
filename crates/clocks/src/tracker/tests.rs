use super::*;
use portolan_sensor::ImuData;

/// Swaying and nodding steps in a hall that the carrier slowly leaves.
fn truth(t: f64) -> Rigid3 {
    let turn = Vector3::new(0.02 * (4.4 * t).sin(), 0.015 * (8.8 * t).cos(), 0.3 * (0.5 * t).sin());
    Rigid3::new(Vector3::new(0.5 * t, 0.02 * (4.4 * t).cos(), 0.02 * (8.8 * t).sin()), turn)
}

/// Hits of 16 beams in a revolution of the head that ends at `end`: walls, floor and ceiling.
fn sweep(end: f64) -> Sweep {
    let (low, high) = (Vector3::new(-6.0, -4.0, -1.2), Vector3::new(9.0, 5.0, 3.0));
    let mut points = Vec::new();
    for i in 0..4800 {
        let offset = 0.1 * f64::from(i) / 4800.0 - 0.05;
        let pose = truth(end - 0.05 + offset);
        let azimuth = std::f64::consts::TAU * f64::from(i / 16) / 300.0;
        let elevation = (2.0 * f64::from(i % 16) - 15.0).to_radians();
        let beam =
            Vector3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        let (ray, origin) = (pose.rotation * beam, pose.translation.vector);
        let ranges = (0..3).map(|a| (if ray[a] > 0.0 { high[a] } else { low[a] } - origin[a]) / ray[a]);
        // Noise of a centimetre.
        let noise = 0.01 * ((i * 7919 % 101) as f64 / 50.0 - 1.0);
        let range = ranges.filter(|r| r.is_finite()).fold(f64::INFINITY, f64::min) + noise;
        points.push((offset as f32, Point3f::from((beam * range).cast::<f32>())));
    }
    let middle = Time::UNIX_EPOCH + Duration::from_seconds(end - 0.05);
    Sweep { middle, half: 0.05, points, origin: Point3f::origin() }
}

#[test]
fn rotations_of_sweeps_are_correct_despite_a_wrong_clock_of_the_gyroscope() {
    let mut gyroscope = Gyroscope::default();
    for i in 0..2000 {
        let (t, step) = (0.005 * f64::from(i), 1e-4);
        let turn = truth(t - step).rotation.inverse() * truth(t + step).rotation;
        gyroscope.add(&ImuData {
            time: Time::UNIX_EPOCH + Duration::from_seconds(t - 0.05),
            linear_acceleration: Vector3::z(),
            angular_velocity: portolan_geometry::angle_axis_from_quaternion(&turn) / (2.0 * step),
        });
    }
    let mut tracker = SweepTracker::default();
    let tracked: Vec<TrackedSweep> =
        (2..42).filter_map(|i| tracker.add(&sweep(0.1 * f64::from(i)), &gyroscope)).collect();
    assert!(tracked.len() >= 35, "{}", tracked.len());
    let mut errors = Vec::new();
    for pair in tracked.windows(4) {
        let at = |sweep: &TrackedSweep| truth(sweep.time.seconds_since(Time::UNIX_EPOCH)).rotation;
        let expected = at(&pair[0]).inverse() * at(&pair[3]);
        errors.push((pair[0].rotation.inverse() * pair[3].rotation).angle_to(&expected));
    }
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    assert!(median < 0.0015, "{median} {errors:?}");
    // A new local frame begins after a gap in time.
    let before = tracked[0].segment;
    assert!(tracker.add(&sweep(6.0), &gyroscope).is_none());
    let after = (61..75).find_map(|i| tracker.add(&sweep(0.1 * f64::from(i)), &gyroscope)).unwrap();
    assert_ne!(after.segment, before);
}
