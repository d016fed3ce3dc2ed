//! Gyroscopes that turn faster than they can measure.
//!
//! At the end of its range a sensor repeats the same largest value, which noise does not let happen
//! otherwise. Where the other axes repeat their values as well there is no noise, and an even turn looks the same:
//! then nothing is said.

use portolan_geometry::Vector3;

/// So many equal values in a row, this near to the largest ever seen, are the end of the range.
const EQUAL_IN_A_ROW: u32 = 5;
const SHARE_OF_LARGEST: f64 = 0.98;
/// No gyroscope ends at less, rad/s.
const SMALLEST_RANGE: f64 = 0.1;

/// Finds samples at the end of the range, axis by axis.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct GyroscopeRange {
    largest: [f64; 3],
    last: [f64; 3],
    equal: [u32; 3],
}

impl GyroscopeRange {
    /// Whether this sample, rad/s along the axes of the sensor, is at the end of the range.
    pub fn is_at_end(&mut self, angular_velocity: &Vector3) -> bool {
        for axis in 0..3 {
            let value = angular_velocity[axis];
            self.largest[axis] = self.largest[axis].max(value.abs());
            self.equal[axis] = if value == self.last[axis] { self.equal[axis].saturating_add(1) } else { 1 };
            self.last[axis] = value;
        }
        let is_at_end = |axis: usize| {
            let is_large =
                self.last[axis].abs() >= (SHARE_OF_LARGEST * self.largest[axis]).max(SMALLEST_RANGE);
            let is_noisy = self.equal.iter().any(|equal| *equal < self.equal[axis]);
            is_large && is_noisy && self.equal[axis] >= EQUAL_IN_A_ROW
        };
        (0..3).any(is_at_end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_repeated_largest_values_are_the_end() {
        let count = |limit: f64, noise: f64| {
            let mut range = GyroscopeRange::default();
            let rate = |i: i32| (0.02 * f64::from(i)).sin() + noise * f64::from(i * 7919 % 101) / 101.0;
            let tremble = |i: i32| noise * f64::from(i * 104_729 % 97) / 97.0;
            let sample = |i: i32| Vector3::new(0.0, rate(i).clamp(-limit, limit), tremble(i));
            (0..1000).filter(|i| range.is_at_end(&sample(*i))).count()
        };
        assert!(count(0.5, 0.01) > 500);
        assert_eq!(count(10.0, 0.01), 0);
    }

    #[test]
    fn an_even_turn_without_noise_is_not_the_end() {
        let mut range = GyroscopeRange::default();
        let rate = |i: i32| f64::from(i.min(100)) * 0.01;
        assert!((0..1000).all(|i| !range.is_at_end(&Vector3::new(0.0, 0.002, rate(i)))));
    }
}
