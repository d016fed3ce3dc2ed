//! What a gyroscope measures while nothing turns, learned while mapping.

use portolan_geometry::{Quaternion, Vector3, angle_axis_from_quaternion};
use portolan_sensor::ImuData;

/// How much zero bias is believed at the beginning, as seconds of evidence.
const BELIEF_AT_START: f64 = 1.0;
/// Biases wander: evidence older than about this is forgotten, seconds.
const MEMORY: f64 = 20.0;
/// A difference beyond this is no bias but a poor match or a saturated gyroscope, rad/s.
pub(crate) const LARGEST_BIAS: f64 = 0.2;
/// Turning this fast, rad/s, halves what a difference tells of the bias.
const FAST: f64 = 0.3;

/// How much a difference tells of the bias at this turn rate, rad/s: errors of scale and alignment and the end
/// of the range grow with the turn.
pub(crate) fn weight_at(turn_rate: f64) -> f64 {
    1.0 / (1.0 + (turn_rate / FAST).powi(2))
}

/// The bias of a gyroscope, as the mean difference between the turns that it measured and those at which
/// scans matched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GyroscopeBias {
    /// rad/s in the tracking frame, to be subtracted.
    bias: Vector3,
    /// Seconds of evidence.
    evidence: f64,
}

impl Default for GyroscopeBias {
    fn default() -> Self {
        Self { bias: Vector3::zeros(), evidence: BELIEF_AT_START }
    }
}

impl GyroscopeBias {
    /// The sample without the bias.
    pub fn corrected(&self, data: &ImuData) -> ImuData {
        ImuData { angular_velocity: data.angular_velocity - self.bias, ..*data }
    }

    /// The bias, rad/s in the tracking frame.
    #[cfg(test)]
    pub fn bias(&self) -> Vector3 {
        self.bias
    }

    /// Learns from a turn over `seconds` that was predicted with corrected samples and then matched
    /// (rotations from the tracking frame at its end to that at its beginning).
    pub fn observe(&mut self, predicted: &Quaternion, matched: &Quaternion, seconds: f64) {
        if seconds <= 0.0 {
            return;
        }
        let error = angle_axis_from_quaternion(&(matched.inverse() * predicted)) / seconds;
        if !error.iter().all(|v| v.is_finite()) || error.norm() > LARGEST_BIAS {
            return;
        }
        let told = seconds * weight_at(matched.angle() / seconds);
        self.evidence = (self.evidence + told).min(MEMORY);
        self.bias += error * (told / self.evidence).min(1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Time, quaternion_from_angle_axis};

    #[test]
    fn a_constant_bias_is_learned_within_seconds() {
        let truth = Vector3::new(0.02, -0.01, 0.03);
        let mut learned = GyroscopeBias::default();
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
        let mut learned = GyroscopeBias::default();
        let turned = quaternion_from_angle_axis(&(Vector3::z() * 0.5));
        learned.observe(&turned, &Quaternion::identity(), 0.1);
        learned.observe(&turned, &Quaternion::identity(), 0.0);
        assert_eq!(learned, GyroscopeBias::default());
    }
}
