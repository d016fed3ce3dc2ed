//! Detects saturation of a gyroscope at the end of its measuring range.

use portolan_geometry::Vector3;

/// Detects samples at the end of the range of a gyroscope, axis by axis.
///
/// A saturated sensor repeats the same largest value, which noise otherwise prevents. If the other axes
/// repeat their values as well, the data has no noise, and a constant rotation looks the same: then
/// saturation is not reported.
#[derive(Clone, Debug)]
pub struct SaturationDetector {
    /// Smallest possible end of the range of a gyroscope, rad/s.
    least_end: f64,
    /// Number of equal consecutive values from which the value is the end of the range.
    equal_in_a_row: u32,
    axes: [AxisValues; 3],
}

/// Values measured on one axis, rad/s.
#[derive(Clone, Copy, Debug, Default)]
struct AxisValues {
    /// Smallest and largest value so far.
    least: f64,
    largest: f64,
    last: f64,
    /// Number of consecutive values equal to the last one.
    equal: u32,
}

impl AxisValues {
    fn add(&mut self, value: f64) {
        self.least = self.least.min(value);
        self.largest = self.largest.max(value);
        self.equal = if value == self.last { self.equal.saturating_add(1) } else { 1 };
        self.last = value;
    }

    fn is_at_an_end(&self, least_end: f64) -> bool {
        (self.last == self.least || self.last == self.largest) && self.last.abs() >= least_end
    }
}

impl SaturationDetector {
    /// For a sensor without measurements so far, whose range does not end below `least_end`, rad/s. The
    /// largest or smallest value so far is the end of the range if it occurs `equal_in_a_row` times in
    /// succession.
    pub fn new(least_end: f64, equal_in_a_row: u32) -> Self {
        Self { least_end, equal_in_a_row, axes: [AxisValues::default(); 3] }
    }

    /// Whether this sample, rad/s along the axes of the sensor, is at the end of the range.
    pub fn is_saturated(&mut self, angular_velocity: &Vector3) -> bool {
        self.axes.iter_mut().zip(angular_velocity.iter()).for_each(|(axis, value)| axis.add(*value));
        let is_saturated = |axis: &AxisValues| {
            let is_noisy = self.axes.iter().any(|other| other.equal < axis.equal);
            axis.is_at_an_end(self.least_end) && is_noisy && axis.equal >= self.equal_in_a_row
        };
        self.axes.iter().any(is_saturated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_repeated_largest_values_are_saturation() {
        let count = |limit: f64, noise: f64| {
            let mut detector = SaturationDetector::new(0.2, 5);
            let rate = |i: i32| (0.02 * f64::from(i)).sin() + noise * f64::from(i * 7919 % 101) / 101.0;
            let tremble = |i: i32| noise * f64::from(i * 104_729 % 97) / 97.0;
            let sample = |i: i32| Vector3::new(0.0, rate(i).clamp(-limit, limit), tremble(i));
            (0..1000).filter(|i| detector.is_saturated(&sample(*i))).count()
        };
        assert!(count(0.5, 0.01) > 500);
        assert_eq!(count(10.0, 0.01), 0);
    }

    #[test]
    fn a_uniform_turn_without_noise_is_not_saturation() {
        let mut detector = SaturationDetector::new(0.2, 5);
        let rate = |i: i32| f64::from(i.min(100)) * 0.01;
        assert!((0..1000).all(|i| !detector.is_saturated(&Vector3::new(0.0, 0.002, rate(i)))));
    }
}
