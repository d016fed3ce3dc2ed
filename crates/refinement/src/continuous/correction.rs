//! Corrections of extrinsics and stamps of the range sensors.

use portolan_geometry::{Quaternion, Rigid3, Vector3, nalgebra as na, quaternion_from_angle_axis};

use crate::MAX_SENSORS;

/// Correction of the extrinsics and the clock of a range sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorCorrection {
    /// Transforms points of the sensor from the tracking frame as assumed in the recording to the corrected
    /// one.
    pub tracking_from_assumed: Rigid3,
    /// Seconds to be added to the sensor's stamps.
    pub delay: f64,
}

impl Default for SensorCorrection {
    fn default() -> Self {
        Self { tracking_from_assumed: Rigid3::identity(), delay: 0.0 }
    }
}

impl SensorCorrection {
    /// Applies an increment: translation (metres) and rotation (rotation vector) of the sensor about its own
    /// position `origin`, in axes of the tracking frame, and delay (seconds).
    pub(crate) fn apply(&mut self, increment: &[f64; 7], origin: &Vector3) {
        let [x, y, z, a, b, c, delay] = *increment;
        let turn: Quaternion = quaternion_from_angle_axis(&Vector3::new(a, b, c));
        let place = self.tracking_from_assumed * na::Point3::from(*origin);
        let about = Rigid3::from_parts(
            na::Translation3::from(place.coords - turn * place.coords + Vector3::new(x, y, z)),
            turn,
        );
        self.tracking_from_assumed = about * self.tracking_from_assumed;
        self.tracking_from_assumed.rotation.renormalize();
        self.delay += delay;
    }
}

/// The corrections of all sensors.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Corrections {
    sensors: [SensorCorrection; MAX_SENSORS],
    /// Whether a sensor has a correction.
    corrected: [bool; MAX_SENSORS],
}

impl Default for Corrections {
    fn default() -> Self {
        Self { sensors: [SensorCorrection::default(); MAX_SENSORS], corrected: [false; MAX_SENSORS] }
    }
}

impl Corrections {
    pub fn of(&self, sensor: usize) -> &SensorCorrection {
        &self.sensors[sensor]
    }

    /// Changes the correction of a sensor.
    pub fn apply(&mut self, sensor: usize, increment: &[f64; 7], origin: &Vector3) {
        self.sensors[sensor].apply(increment, origin);
        self.corrected[sensor] = true;
    }

    /// Corrects a point of a sensor from the recording: time, and position in the tracking frame.
    #[inline]
    pub fn place(&self, sensor: usize, seconds: f64, in_tracking: [f32; 3]) -> (f64, [f32; 3]) {
        if !self.corrected[sensor] {
            return (seconds, in_tracking);
        }
        let correction = &self.sensors[sensor];
        let p = correction.tracking_from_assumed * na::Point3::from(in_tracking.map(f64::from));
        (seconds + correction.delay, [p.x as f32, p.y as f32, p.z as f32])
    }

    /// Uncorrected time and position of a corrected point: the inverse of [`Corrections::place`].
    pub fn uncorrected(&self, sensor: usize, seconds: f64, in_tracking: &Vector3) -> (f64, Vector3) {
        if !self.corrected[sensor] {
            return (seconds, *in_tracking);
        }
        let correction = &self.sensors[sensor];
        let assumed =
            correction.tracking_from_assumed.inverse_transform_point(&na::Point3::from(*in_tracking));
        (seconds - correction.delay, assumed.coords)
    }

    /// A direction of the recording's tracking frame, corrected.
    pub fn turn(&self, sensor: usize, direction: &Vector3) -> Vector3 {
        if self.corrected[sensor] {
            self.sensors[sensor].tracking_from_assumed.rotation * direction
        } else {
            *direction
        }
    }

    /// The inverse of [`Corrections::turn`].
    pub fn uncorrected_direction(&self, sensor: usize, direction: &Vector3) -> Vector3 {
        if self.corrected[sensor] {
            self.sensors[sensor].tracking_from_assumed.rotation.inverse() * direction
        } else {
            *direction
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_turns_about_its_own_place() {
        let origin = Vector3::new(0.5, -0.2, 1.0);
        let mut corrections = Corrections::default();
        corrections.apply(3, &[0.1, 0.0, 0.0, 0.0, 0.0, 0.2, 0.05], &origin);
        let (seconds, at) = corrections.place(3, 2.0, [0.5, -0.2, 1.0]);
        assert!((Vector3::from(at.map(f64::from)) - origin - Vector3::new(0.1, 0.0, 0.0)).norm() < 1e-6);
        assert!((seconds - 2.05).abs() < 1e-12);
        let (back, there) = corrections.uncorrected(3, seconds, &Vector3::from(at.map(f64::from)));
        assert!((there - origin).norm() < 1e-6 && (back - 2.0).abs() < 1e-12);
        assert_eq!(corrections.place(2, 1.0, [1.0; 3]), (1.0, [1.0; 3]));
    }
}
