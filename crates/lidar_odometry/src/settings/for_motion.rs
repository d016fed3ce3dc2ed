//! Settings in the form that `portolan-motion` uses.

use portolan_motion::{DegenerateIntervals, InertialNoise, SaturationDetector, StandstillTolerances};

use super::{GyroscopeSettings, OdometrySettings};

impl GyroscopeSettings {
    /// Weight of a difference of angular velocities for the bias, at this angular velocity of the
    /// platform, rad/s, relative to one at rest.
    pub fn weight_at(&self, turn_rate: f64) -> f64 {
        let noise = self.noise * self.noise;
        noise / (noise + (self.scale_error * turn_rate).powi(2))
    }

    /// Difference of angular velocities, rad/s, above which it is not a bias but a poor registration or a
    /// saturated gyroscope. The range of a gyroscope ends at no less.
    pub fn max_bias(&self) -> f64 {
        10.0 * self.bias
    }

    /// Detector for a gyroscope without samples so far.
    pub fn saturation_detector(&self) -> SaturationDetector {
        SaturationDetector::new(self.max_bias(), self.equal_in_a_row)
    }
}

impl OdometrySettings {
    /// Degenerate intervals, none so far.
    pub fn degenerate_intervals(&self) -> DegenerateIntervals {
        DegenerateIntervals::new(self.standstill.resting_speed, self.initialisation.leveling_time)
    }

    /// Errors of the IMU for the inertial filter.
    pub fn inertial_noise(&self) -> InertialNoise {
        InertialNoise {
            turn: self.gyroscope.noise,
            turn_scale: self.gyroscope.scale_error,
            gyroscope_bias: self.gyroscope.bias,
            gyroscope_walk: self.gyroscope.bias_walk,
            acceleration: self.inertial.acceleration_noise,
            accelerometer_bias: self.inertial.accelerometer_bias,
            gravity_walk: self.inertial.gravity_walk,
        }
    }

    /// Apparent motion that is tolerated of a platform at rest.
    pub(crate) fn standstill_tolerances(&self) -> StandstillTolerances {
        StandstillTolerances {
            time: self.initialisation.leveling_time,
            bin: self.standstill.bin,
            acceleration_error: self.standstill.acceleration_error,
            turn_rate_error: self.gyroscope.bias,
            resting_speed: self.standstill.resting_speed,
            place_error: self.plane_fit.range_noise,
            rotation_error: self.motion_prior.least_rotation_error,
        }
    }
}
