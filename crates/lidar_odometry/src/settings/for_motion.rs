//! What `portolan-motion` takes of the settings.

use portolan_motion::{DegenerateIntervals, InertialNoise, SaturationDetector, StandstillTolerances};

use super::{GyroscopeSettings, OdometrySettings};

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

    /// Of a gyroscope that has measured nothing yet.
    pub fn saturation_detector(&self) -> SaturationDetector {
        SaturationDetector::new(self.max_bias(), self.equal_in_a_row)
    }
}

impl OdometrySettings {
    /// No interval so far.
    pub fn degenerate_intervals(&self) -> DegenerateIntervals {
        DegenerateIntervals::new(self.standstill.resting_speed, self.initialisation.leveling_time)
    }

    /// Errors of the IMU as an inertial filter takes them.
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

    /// What a platform at rest may seem to do.
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
