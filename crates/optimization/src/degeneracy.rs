//! Weights of motions along directions that the scan of a node does not constrain.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Rigid3, Vector3};
use portolan_motion::Observability;

/// Standard deviation of a translation that is not constrained by a scan: constant part, metres.
const SHIFT: f64 = 0.02;
/// The same per metre measured by odometry, metres.
const SHIFT_BY_ODOMETRY: f64 = 0.05;
/// The same per second without any measurement, metres.
const UNMEASURED_SHIFT: f64 = 1.0;
/// Standard deviation of a rotation that is not constrained by a scan: constant part, radians.
const TURN: f64 = 0.001;
/// The same per second with a gyroscope, radians.
const TURN_BY_GYROSCOPE: f64 = 0.002;
/// The same per second without any measurement, radians.
const UNMEASURED_TURN: f64 = 0.1;

/// Weights (1/m) along the degenerate translations and (1/rad) about the degenerate rotations of a motion
/// that took `seconds`.
fn weights(of: &Observability, motion: &Rigid3, seconds: f64) -> (f64, f64) {
    let shift = match of.translation_is_measured {
        true => SHIFT_BY_ODOMETRY * motion.translation.vector.norm(),
        false => UNMEASURED_SHIFT * seconds,
    };
    let rate = if of.rotation_is_measured { TURN_BY_GYROSCOPE } else { UNMEASURED_TURN };
    (1.0 / (SHIFT + shift), 1.0 / (TURN + rate * seconds))
}

/// Square root of the information of a motion to a node with this observability: these weights (1/m, 1/rad),
/// but smaller ones in degenerate directions, for the substitute that was used there.
pub(crate) fn weakened(
    of: &Observability,
    full: (f64, f64),
    motion: &Rigid3,
    seconds: f64,
) -> na::Matrix6<f64> {
    let (shift, turn) = weights(of, motion, seconds);
    let part = |full: f64, weak: f64, degenerate: &[Vector3]| {
        let all = na::Matrix3::from_diagonal_element(full);
        degenerate.iter().fold(all, |sum, d| sum + d * d.transpose() * (weak.min(full) - full))
    };
    let degenerate = &of.degenerate;
    blocks(part(full.0, shift, &degenerate.translations), part(full.1, turn, &degenerate.rotations))
}

/// The same for a motion of which only the degenerate translations count.
pub(crate) fn only_degenerate_translations(
    of: &Observability,
    motion: &Rigid3,
    seconds: f64,
) -> na::Matrix6<f64> {
    let (weight, _) = weights(of, motion, seconds);
    let sum = |sum: na::Matrix3<f64>, d: &Vector3| sum + d * d.transpose() * weight;
    blocks(of.degenerate.translations.iter().fold(na::Matrix3::zeros(), sum), na::Matrix3::zeros())
}

fn blocks(translation: na::Matrix3<f64>, rotation: na::Matrix3<f64>) -> na::Matrix6<f64> {
    let mut all = na::Matrix6::zeros();
    all.fixed_view_mut::<3, 3>(0, 0).copy_from(&translation);
    all.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    all
}

#[cfg(test)]
mod tests {
    use portolan_motion::DegenerateDirections;

    use super::*;

    #[test]
    fn only_degenerate_directions_are_weak() {
        let degenerate =
            DegenerateDirections { translations: vec![Vector3::x()], rotations: vec![Vector3::z()] };
        let of = Observability { degenerate, translation_is_measured: true, rotation_is_measured: true };
        let motion = Rigid3::translation(4.0, 0.0, 0.0);
        let root = weakened(&of, (500.0, 1600.0), &motion, 4.0);
        let expected = [1.0 / 0.22, 500.0, 500.0, 1600.0, 1600.0, 1.0 / 0.009];
        assert!((root.diagonal() - na::Vector6::from(expected)).norm() < 1e-9, "{root}");
        assert_eq!(only_degenerate_translations(&of, &motion, 4.0)[(1, 1)], 0.0);
    }
}
