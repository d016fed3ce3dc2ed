//! Integrates IMU measurements between two times (`slam3d.md` §8).

use std::collections::BTreeMap;

use portolan_geometry::{Duration, Quaternion, Time, Vector3, quaternion_from_angle_axis};
use portolan_sensor::ImuData;

/// Interval without samples above which the motion is unknown, seconds.
const MAX_GAP: f64 = 0.5;

/// Change of velocity, position and rotation between two times, in the tracking frame at the first,
/// including the effect of gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuMotion {
    /// m/s.
    pub delta_velocity: Vector3,
    /// Metres.
    pub delta_translation: Vector3,
    /// From the tracking frame at the second time to that at the first.
    pub delta_rotation: Quaternion,
}

/// Integrates samples from `start` to `end`, each valid until the next one. None where they do not reach
/// back to `start`, or leave a gap of more than half a second.
pub fn integrate_imu(data: &BTreeMap<Time, ImuData>, start: Time, end: Time) -> Option<ImuMotion> {
    let (mut time, mut current) = (start, data.range(..=start).next_back()?.1);
    let mut motion = ImuMotion {
        delta_velocity: Vector3::zeros(),
        delta_translation: Vector3::zeros(),
        delta_rotation: Quaternion::identity(),
    };
    let mut following = data.range((std::ops::Bound::Excluded(start), std::ops::Bound::Unbounded));
    while time < end {
        let next = following.next().map(|(_, sample)| sample).filter(|sample| sample.time < end);
        let until = next.map_or(end, |sample| sample.time);
        if until.seconds_since(current.time) > MAX_GAP {
            return None;
        }
        let seconds = until.seconds_since(time);
        motion.delta_rotation *= quaternion_from_angle_axis(&(current.angular_velocity * seconds));
        motion.delta_velocity += motion.delta_rotation * (current.linear_acceleration * seconds);
        motion.delta_translation += motion.delta_velocity * seconds;
        (time, current) = (until, next.unwrap_or(current));
    }
    Some(motion)
}

/// The specific force integrated between the middles of two intervals, in the frame of the time between
/// them (`slam3d.md` §8). None where samples are missing.
pub fn velocity_change(imu: &BTreeMap<Time, ImuData>, times: [Time; 3]) -> Option<Vector3> {
    let [first, second, third] = times;
    let middle = |from: Time, to: Time| from + Duration::from_ticks((to - from).ticks() / 2);
    let whole = integrate_imu(imu, first, second)?;
    let half = integrate_imu(imu, first, middle(first, second))?;
    let between = integrate_imu(imu, middle(first, second), middle(second, third))?;
    Some((whole.delta_rotation.inverse() * half.delta_rotation) * between.delta_velocity)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Data set D of the golden vectors.
    fn samples() -> BTreeMap<Time, ImuData> {
        let mut state = 3u32;
        let mut symmetric = |a: f32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from((((state >> 8) as f32 / 16_777_216.0) * 2.0 - 1.0) * a)
        };
        let sample = |i: i64| {
            let force = Vector3::new(symmetric(1.0), symmetric(1.0), 0.0);
            let linear_acceleration = force + Vector3::z() * f64::from(9.8 + symmetric(0.5) as f32);
            let angular_velocity = Vector3::new(symmetric(0.5), symmetric(0.5), symmetric(1.0));
            let time = Time::from_ticks(100_000 * i);
            (time, ImuData { time, linear_acceleration, angular_velocity })
        };
        (0..50).map(sample).collect()
    }

    #[test]
    fn integration_equals_the_golden_one() {
        let samples = samples();
        let ticks = Time::from_ticks;
        let motion = integrate_imu(&samples, ticks(150_000), ticks(3_333_333)).unwrap();
        let velocity = Vector3::new(-0.002411279937, 0.043116984953, 3.100659917032);
        let translation = Vector3::new(-0.009369232302, 0.005447153902, 0.509769072084);
        assert!((motion.delta_velocity - velocity).norm() < 1e-6, "{motion:?}");
        assert!((motion.delta_translation - translation).norm() < 1e-6, "{motion:?}");
        let q = motion.delta_rotation;
        let golden = [0.999739285941, -0.003019726652, 0.011174769159, 0.019681614059];
        let difference = [q.w - golden[0], q.i - golden[1], q.j - golden[2], q.k - golden[3]];
        assert!(difference.iter().all(|d| d.abs() < 1e-11), "{q}");
    }

    #[test]
    fn unmeasured_intervals_are_not_integrated() {
        let mut samples = samples();
        let ticks = Time::from_ticks;
        assert!(integrate_imu(&samples, ticks(-1), ticks(50_000)).is_none());
        assert!(integrate_imu(&samples, ticks(4_000_000), ticks(9_900_000)).is_some());
        assert!(integrate_imu(&samples, ticks(4_000_000), ticks(9_900_001)).is_none());
        assert!(integrate_imu(&samples, ticks(0), ticks(0)).is_some());
        samples.retain(|time, _| time.ticks() < 1_000_000);
        assert!(integrate_imu(&samples, ticks(500_000), ticks(5_900_000)).is_some());
        assert!(integrate_imu(&BTreeMap::new(), ticks(0), ticks(1)).is_none());
    }
}
