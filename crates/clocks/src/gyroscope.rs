//! Integrates the rotation of the IMU as a function of its own time.

use portolan_geometry::{Quaternion, Time, Vector3, quaternion_from_angle_axis};
use portolan_sensor::ImuData;

/// Interval without samples above which the rotation is unknown, seconds.
const MAX_GAP: f64 = 0.1;
/// Maximum number of samples that are kept: eight minutes at 1 kHz.
const MAX_SAMPLES: usize = 500_000;

/// Integrated angular velocities.
#[derive(Debug, Default)]
pub(super) struct Gyroscope {
    samples: Vec<Sample>,
}

#[derive(Debug)]
struct Sample {
    time: Time,
    rate: Vector3,
    /// Orientation of the IMU at this time in its frame at the first sample.
    rotation: Quaternion,
    /// Number of gaps before this sample.
    gaps: u32,
}

impl Gyroscope {
    /// Takes a sample. One that is not later than the last, or not finite, is left out.
    pub fn add(&mut self, imu: &ImuData) {
        let (time, rate) = (imu.time, imu.angular_velocity);
        if self.samples.len() >= MAX_SAMPLES || !rate.iter().all(|v| v.is_finite()) {
            return;
        }
        let sample = match self.samples.last() {
            None => Sample { time, rate, rotation: Quaternion::identity(), gaps: 0 },
            Some(last) => {
                let seconds = time.seconds_since(last.time);
                if seconds <= 0.0 {
                    return;
                }
                // Trapezoidal rule: a sample is measured at its own time, not held until the next.
                let turn = quaternion_from_angle_axis(&((last.rate + rate) * (0.5 * seconds)));
                let rotation = Quaternion::new_normalize((last.rotation * turn).into_inner());
                Sample { time, rate, rotation, gaps: last.gaps + u32::from(seconds > MAX_GAP) }
            }
        };
        self.samples.push(sample);
    }

    /// Root mean square of the rates, rad/s.
    pub fn rms_rate(&self) -> f64 {
        let squares: f64 = self.samples.iter().map(|sample| sample.rate.norm_squared()).sum();
        (squares / self.samples.len().max(1) as f64).sqrt()
    }

    /// Time of the last sample.
    pub fn end(&self) -> Option<Time> {
        self.samples.last().map(|sample| sample.time)
    }

    /// Rotation from the frame at `to` to that at `from`; none where it is not known throughout.
    pub fn turn(&self, from: Time, to: Time) -> Option<Quaternion> {
        let ((a, gaps_a), (b, gaps_b)) = (self.at(from)?, self.at(to)?);
        (gaps_a == gaps_b).then(|| a.inverse() * b)
    }

    fn at(&self, time: Time) -> Option<(Quaternion, u32)> {
        let index = self.samples.partition_point(|sample| sample.time <= time);
        let before = self.samples.get(index.checked_sub(1)?)?;
        let seconds = time.seconds_since(before.time);
        let rate = match self.samples.get(index) {
            Some(after) => {
                let share = seconds / after.time.seconds_since(before.time);
                before.rate + (after.rate - before.rate) * (0.5 * share)
            }
            None if seconds > 0.0 => return None,
            None => before.rate,
        };
        Some((before.rotation * quaternion_from_angle_axis(&(rate * seconds)), before.gaps))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Duration;

    #[test]
    fn rotations_integrate_the_rates_and_are_unknown_across_gaps() {
        let at = |seconds: f64| Time::UNIX_EPOCH + Duration::from_seconds(seconds);
        let mut gyroscope = Gyroscope::default();
        for i in (0..400).filter(|i| !(200..230).contains(i)) {
            let t = 0.01 * f64::from(i);
            gyroscope.add(&ImuData {
                time: at(t),
                linear_acceleration: Vector3::z(),
                angular_velocity: Vector3::new(0.0, 0.0, t.cos()),
            });
        }
        let turn = gyroscope.turn(at(0.503), at(1.497)).unwrap().angle();
        assert!((turn - (1.497_f64.sin() - 0.503_f64.sin())).abs() < 1e-5, "{turn}");
        assert!(gyroscope.turn(at(1.5), at(2.5)).is_none());
        assert!(gyroscope.turn(at(2.5), at(3.5)).is_some());
        assert!(gyroscope.turn(at(3.5), at(4.5)).is_none());
        assert!(gyroscope.turn(at(-0.5), at(0.5)).is_none());
    }
}
