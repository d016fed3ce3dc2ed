//! Gyroscopes that turn faster than they can measure.
//!
//! At the end of its range a sensor repeats the same largest value, which noise does not let happen
//! otherwise.

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
        let mut at_end = false;
        for axis in 0..3 {
            let value = angular_velocity[axis];
            self.largest[axis] = self.largest[axis].max(value.abs());
            self.equal[axis] = if value == self.last[axis] { self.equal[axis].saturating_add(1) } else { 1 };
            self.last[axis] = value;
            let is_large = value.abs() >= (SHARE_OF_LARGEST * self.largest[axis]).max(SMALLEST_RANGE);
            at_end |= is_large && self.equal[axis] >= EQUAL_IN_A_ROW;
        }
        at_end
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
            let sample = |i: i32| Vector3::new(0.0, rate(i).clamp(-limit, limit), 0.01);
            (0..1000).filter(|i| range.is_at_end(&sample(*i))).count()
        };
        assert!(count(0.5, 0.01) > 500);
        assert_eq!(count(10.0, 0.01), 0);
    }
}
