//! Detects IMUs whose driver repeats the last sample after the sensor stopped measuring.

use portolan_geometry::{Duration, Time};
use portolan_recording::Imu;

/// Maximum time for which a sample may repeat. Noise changes the last digits of its six numbers with every
/// measurement; drivers that poll faster than the IMU measures repeat them for less than this.
const LONGEST_REPEAT: Duration = Duration::from_ticks(1_000_000);

/// Detects samples without a new measurement.
#[derive(Clone, Debug, Default)]
pub(crate) struct StuckSample {
    /// Time since which the sample repeats, and its values to the last bit.
    last: Option<(Time, [u64; 6])>,
}

impl StuckSample {
    /// Whether a sample repeats the one before, and this has lasted too long.
    pub fn is_stuck(&mut self, stamp: Time, imu: &Imu) -> bool {
        let ([a, b, c], [d, e, f]) = (imu.linear_acceleration, imu.angular_velocity);
        let values = [a, b, c, d, e, f].map(f64::to_bits);
        match self.last {
            Some((since, last)) if last == values => stamp - since > LONGEST_REPEAT,
            _ => {
                self.last = Some((stamp, values));
                false
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_messages::imu;
    use portolan_recording::Message;

    #[test]
    fn samples_that_repeat_for_longer_than_drivers_poll_are_left_out() {
        let mut stuck = StuckSample::default();
        let at = |hundredths: i64| Time::from_ticks(hundredths * 100_000);
        let sample = |value: f64| {
            let Message::Imu(imu) = imu(0.0, [0.0, value, 9.8]) else { panic!() };
            imu
        };
        assert!((0..10).all(|t| !stuck.is_stuck(at(t), &sample(0.1))));
        assert!(!stuck.is_stuck(at(10), &sample(0.1)) && stuck.is_stuck(at(11), &sample(0.1)));
        assert!(!stuck.is_stuck(at(12), &sample(0.2)));
    }
}
