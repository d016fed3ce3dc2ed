//! Directions in which a scan did not hold, and how well they are known instead.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Rigid3, Vector3};
use portolan_lidar_odometry::Observability;

/// Errors of what was taken instead (standard deviations): metres at once, metres for each metre that odometry
/// tells, and metres for each second of which nothing tells; radians at once, and for each second with and
/// without a gyroscope.
const SHIFT: f64 = 0.02;
const SHIFT_BY_ODOMETRY: f64 = 0.05;
const SHIFT_BY_NOTHING: f64 = 1.0;
const TURN: f64 = 0.001;
const TURN_BY_GYROSCOPE: f64 = 0.002;
const TURN_BY_NOTHING: f64 = 0.1;

/// What the scan of a node left open.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenDirections {
    /// Unit vectors along which shifts were open, in the tracking frame.
    pub translations: Vec<Vector3>,
    /// Unit vectors about which turns were open, in the tracking frame.
    pub rotations: Vec<Vector3>,
    /// Whether odometry measured the translation.
    pub way_is_measured: bool,
    /// Whether a gyroscope measured the rotation.
    pub turn_is_measured: bool,
}

impl OpenDirections {
    /// What a registered sweep says.
    pub fn of(observability: Observability) -> Self {
        let Observability { degenerate, translation_is_measured, rotation_is_measured } = observability;
        Self {
            translations: degenerate.translations,
            rotations: degenerate.rotations,
            way_is_measured: translation_is_measured,
            turn_is_measured: rotation_is_measured,
        }
    }

    /// Whether the scan held in all directions.
    pub fn is_empty(&self) -> bool {
        self.translations.is_empty() && self.rotations.is_empty()
    }

    /// Weights (1/m) along the open shifts and (1/rad) about the open turns of a motion that took so long.
    fn weights(&self, motion: &Rigid3, seconds: f64) -> (f64, f64) {
        let shift = match self.way_is_measured {
            true => SHIFT_BY_ODOMETRY * motion.translation.vector.norm(),
            false => SHIFT_BY_NOTHING * seconds,
        };
        let rate = if self.turn_is_measured { TURN_BY_GYROSCOPE } else { TURN_BY_NOTHING };
        (1.0 / (SHIFT + shift), 1.0 / (TURN + rate * seconds))
    }

    /// Square root of the information of a motion to the node: these weights (1/m, 1/rad), but in open
    /// directions what was taken instead is known worse.
    pub(crate) fn weaken(&self, full: (f64, f64), motion: &Rigid3, seconds: f64) -> na::Matrix6<f64> {
        let (shift, turn) = self.weights(motion, seconds);
        let part = |full: f64, weak: f64, open: &[Vector3]| {
            let all = na::Matrix3::from_diagonal_element(full);
            open.iter().fold(all, |sum, d| sum + d * d.transpose() * (weak.min(full) - full))
        };
        blocks(part(full.0, shift, &self.translations), part(full.1, turn, &self.rotations))
    }

    /// The same of a motion of which nothing but the open shifts counts.
    pub(crate) fn only_open_shifts(&self, motion: &Rigid3, seconds: f64) -> na::Matrix6<f64> {
        let (weight, _) = self.weights(motion, seconds);
        let sum = |sum: na::Matrix3<f64>, d: &Vector3| sum + d * d.transpose() * weight;
        blocks(self.translations.iter().fold(na::Matrix3::zeros(), sum), na::Matrix3::zeros())
    }
}

fn blocks(translation: na::Matrix3<f64>, rotation: na::Matrix3<f64>) -> na::Matrix6<f64> {
    let mut all = na::Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).copy_from(&translation);
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_open_directions_are_weak() {
        let open = OpenDirections {
            translations: vec![Vector3::x()],
            rotations: vec![Vector3::z()],
            way_is_measured: true,
            turn_is_measured: true,
        };
        let motion = Rigid3::translation(4.0, 0.0, 0.0);
        let root = open.weaken((500.0, 1600.0), &motion, 4.0);
        let expected = [1.0 / 0.22, 500.0, 500.0, 1600.0, 1600.0, 1.0 / 0.009];
        assert!((root.diagonal() - na::Vector6::from(expected)).norm() < 1e-9, "{root}");
        assert_eq!(open.only_open_shifts(&motion, 4.0)[(1, 1)], 0.0);
        assert!(OpenDirections::default().is_empty() && !open.is_empty());
    }
}
