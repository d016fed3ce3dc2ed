//! What is wrong with a gyroscope: errors that grow with the turn rate, and the end of its range.

use portolan_geometry::Vector3;

use crate::settings::GyroscopeSettings;

impl GyroscopeSettings {
    /// How much a difference of turn rates says of the bias while the platform turns this fast, rad/s, beside one at rest.
    pub fn weight_at(&self, turn_rate: f64) -> f64 {
        let noise = self.noise * self.noise;
        noise / (noise + (self.scale_error * turn_rate).powi(2))
    }

    /// A difference of turn rates beyond this, rad/s, is no bias but a poor registration or a saturated gyroscope; no
    /// gyroscope ends at less, either.
    pub fn max_bias(&self) -> f64 {
        10.0 * self.bias
    }
}

/// Finds samples at the end of the range of a gyroscope, axis by axis.
///
/// There a sensor repeats the same largest value, which noise does not let happen otherwise. Where the other axes repeat
/// their values as well there is no noise, and an even rotation looks the same: then nothing is said.
#[derive(Clone, Debug)]
pub struct SaturationDetector {
    settings: GyroscopeSettings,
    /// The ends of the values so far.
    least: [f64; 3],
    largest: [f64; 3],
    last: [f64; 3],
    equal: [u32; 3],
}

impl SaturationDetector {
    /// Of a sensor that has measured nothing yet.
    pub fn new(settings: &GyroscopeSettings) -> Self {
        Self { settings: settings.clone(), least: [0.0; 3], largest: [0.0; 3], last: [0.0; 3], equal: [0; 3] }
    }

    /// Whether this sample, rad/s along the axes of the sensor, is at the end of the range.
    pub fn is_saturated(&mut self, angular_velocity: &Vector3) -> bool {
        for axis in 0..3 {
            let value = angular_velocity[axis];
            self.least[axis] = self.least[axis].min(value);
            self.largest[axis] = self.largest[axis].max(value);
            self.equal[axis] = if value == self.last[axis] { self.equal[axis].saturating_add(1) } else { 1 };
            self.last[axis] = value;
        }
        let settings = &self.settings;
        let is_saturated = |axis: usize| {
            let value = self.last[axis];
            let is_large = (value == self.least[axis] || value == self.largest[axis])
                && value.abs() >= settings.max_bias();
            let is_noisy = self.equal.iter().any(|equal| *equal < self.equal[axis]);
            is_large && is_noisy && self.equal[axis] >= settings.equal_in_a_row
        };
        (0..3).any(is_saturated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_repeated_largest_values_are_the_end() {
        let count = |limit: f64, noise: f64| {
            let mut detector = SaturationDetector::new(&GyroscopeSettings::default());
            let rate = |i: i32| (0.02 * f64::from(i)).sin() + noise * f64::from(i * 7919 % 101) / 101.0;
            let tremble = |i: i32| noise * f64::from(i * 104_729 % 97) / 97.0;
            let sample = |i: i32| Vector3::new(0.0, rate(i).clamp(-limit, limit), tremble(i));
            (0..1000).filter(|i| detector.is_saturated(&sample(*i))).count()
        };
        assert!(count(0.5, 0.01) > 500);
        assert_eq!(count(10.0, 0.01), 0);
    }

    #[test]
    fn an_even_turn_without_noise_is_not_the_end() {
        let mut detector = SaturationDetector::new(&GyroscopeSettings::default());
        let rate = |i: i32| f64::from(i.min(100)) * 0.01;
        assert!((0..1000).all(|i| !detector.is_saturated(&Vector3::new(0.0, 0.002, rate(i)))));
    }
}
