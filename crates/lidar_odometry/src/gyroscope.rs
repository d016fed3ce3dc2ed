//! What is wrong with a gyroscope: its bias, learned while mapping, and the end of its range.

use portolan_geometry::{Quaternion, Vector3, angle_axis_from_quaternion};
use portolan_sensor::ImuData;

use crate::settings::GyroscopeSettings;

impl GyroscopeSettings {
    /// How much a difference of turn rates says of the bias while the platform turns this fast, rad/s: errors of scale
    /// and alignment grow with the turn rate.
    pub fn weight_at(&self, turn_rate: f64) -> f64 {
        1.0 / (1.0 + (turn_rate / self.fast).powi(2))
    }
}

/// The bias of a gyroscope, as the mean difference between the rotations that it measured and those at which sweeps were
/// registered.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct GyroscopeBias {
    settings: GyroscopeSettings,
    /// rad/s in the tracking frame, to be subtracted.
    bias: Vector3,
    /// Seconds of evidence.
    evidence: f64,
}

impl GyroscopeBias {
    pub fn new(settings: &GyroscopeSettings) -> Self {
        Self { bias: Vector3::zeros(), evidence: settings.initial_evidence, settings: settings.clone() }
    }

    /// The sample without the bias.
    pub fn corrected(&self, data: &ImuData) -> ImuData {
        ImuData { angular_velocity: data.angular_velocity - self.bias, ..*data }
    }

    /// The bias, rad/s in the tracking frame.
    #[cfg(test)]
    pub fn bias(&self) -> Vector3 {
        self.bias
    }

    /// Learns from a rotation over `seconds` that was predicted with corrected samples and then registered (both from the
    /// tracking frame at its end to that at its beginning).
    pub fn observe(&mut self, predicted: &Quaternion, registered: &Quaternion, seconds: f64) {
        if seconds <= 0.0 {
            return;
        }
        let error = angle_axis_from_quaternion(&(registered.inverse() * predicted)) / seconds;
        if !error.iter().all(|v| v.is_finite()) || error.norm() > self.settings.max_bias {
            return;
        }
        let evidence = seconds * self.settings.weight_at(registered.angle() / seconds);
        self.evidence = (self.evidence + evidence).min(self.settings.memory);
        self.bias += error * (evidence / self.evidence).min(1.0);
    }
}

/// Finds samples at the end of the range of a gyroscope, axis by axis.
///
/// There a sensor repeats the same largest value, which noise does not let happen otherwise. Where the other axes repeat
/// their values as well there is no noise, and an even rotation looks the same: then nothing is said.
#[derive(Clone, Debug)]
pub struct SaturationDetector {
    settings: GyroscopeSettings,
    largest: [f64; 3],
    last: [f64; 3],
    equal: [u32; 3],
}

impl SaturationDetector {
    /// Of a sensor that has measured nothing yet.
    pub fn new(settings: &GyroscopeSettings) -> Self {
        Self { settings: settings.clone(), largest: [0.0; 3], last: [0.0; 3], equal: [0; 3] }
    }

    /// Whether this sample, rad/s along the axes of the sensor, is at the end of the range.
    pub fn is_saturated(&mut self, angular_velocity: &Vector3) -> bool {
        for axis in 0..3 {
            let value = angular_velocity[axis];
            self.largest[axis] = self.largest[axis].max(value.abs());
            self.equal[axis] = if value == self.last[axis] { self.equal[axis].saturating_add(1) } else { 1 };
            self.last[axis] = value;
        }
        let settings = &self.settings;
        let is_saturated = |axis: usize| {
            let limit = (settings.fraction_of_largest * self.largest[axis]).max(settings.smallest_range);
            let is_large = self.last[axis].abs() >= limit;
            let is_noisy = self.equal.iter().any(|equal| *equal < self.equal[axis]);
            is_large && is_noisy && self.equal[axis] >= settings.equal_in_a_row
        };
        (0..3).any(is_saturated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Time, quaternion_from_angle_axis};

    fn learner() -> GyroscopeBias {
        GyroscopeBias::new(&GyroscopeSettings::default())
    }

    #[test]
    fn a_constant_bias_is_learned_within_seconds() {
        let truth = Vector3::new(0.02, -0.01, 0.03);
        let mut learned = learner();
        for i in 0..100 {
            // Matching is noisier than the bias turns in a tenth of a second.
            let noise = Vector3::new(0.0, 0.003, -0.003) * if i % 2 == 0 { 1.0 } else { -1.0 };
            let predicted = quaternion_from_angle_axis(&((truth - learned.bias()) * 0.1));
            learned.observe(&predicted, &quaternion_from_angle_axis(&noise), 0.1);
        }
        assert!((learned.bias() - truth).norm() < 0.005, "{learned:?}");
        let data = ImuData {
            time: Time::from_ticks(0),
            linear_acceleration: Vector3::z(),
            angular_velocity: learned.bias(),
        };
        assert_eq!(learned.corrected(&data).angular_velocity, Vector3::zeros());
    }

    #[test]
    fn what_is_no_bias_is_not_learned() {
        let mut learned = learner();
        let turned = quaternion_from_angle_axis(&(Vector3::z() * 0.5));
        learned.observe(&turned, &Quaternion::identity(), 0.1);
        learned.observe(&turned, &Quaternion::identity(), 0.0);
        assert_eq!(learned, learner());
    }

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
