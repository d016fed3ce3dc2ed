//! Interpolation between two poses, with derivatives (slam2d §14.6 item 2).

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3, Vector3};

use super::rotation::{Matrix3, put};

/// A pose between two others: linear interpolation of translation, rotation along the shorter arc.
pub(super) struct Interpolated {
    pub pose: Rigid3,
    /// Weights of the first and of the second translation.
    pub shares: (f64, f64),
    /// Derivatives of the half-angle rotation of the interpolated pose with respect to those of the first and
    /// of the second.
    pub by_first: Matrix3,
    pub by_second: Matrix3,
}

/// Cosine between the quaternions above which the weights are linear.
const LINEAR_ABOVE: f64 = 1.0 - 1e-5;

/// Interpolates at `factor` from the first (0) to the second (1).
pub(super) fn interpolate(first: &Rigid3, second: &Rigid3, factor: f64) -> Interpolated {
    let (q0, q1) = (first.rotation.quaternion(), second.rotation.quaternion());
    let dot = q0.coords.dot(&q1.coords);
    let sign = if dot < 0.0 { -1.0 } else { 1.0 };
    let cosine = dot.abs();
    // For nearly equal rotations the chord gives the angle far more accurately than the cosine.
    let chord = (q0.coords - q1.coords * sign).norm();
    let weights = slerp_weights(cosine, 2.0 * (chord / 2.0).min(1.0).asin(), factor);
    let blended = q0 * weights.first + q1 * (sign * weights.second);
    // With linear weights the norm is slightly below one.
    let norm = blended.norm();
    let rotation = Quaternion::new_normalize(blended);
    let along = q0 * weights.first_by_cosine + q1 * (sign * weights.second_by_cosine);
    let turn = |k: usize, of: &na::Quaternion<f64>, other: &na::Quaternion<f64>, weight: f64| {
        let mut axis = Vector3::zeros();
        axis[k] = 1.0;
        let moved = na::Quaternion::from_parts(0.0, axis) * of;
        let change = moved * weight + along * (sign * moved.coords.dot(&other.coords));
        (change * rotation.quaternion().conjugate()).imag() / norm
    };
    let columns = |of, other, weight| {
        Matrix3::from_columns(&[
            turn(0, of, other, weight),
            turn(1, of, other, weight),
            turn(2, of, other, weight),
        ])
    };
    let shares = (1.0 - factor, factor);
    let translation = first.translation.vector * shares.0 + second.translation.vector * shares.1;
    Interpolated {
        pose: Rigid3::from_parts(translation.into(), rotation),
        shares,
        by_first: columns(q0, q1, weights.first),
        by_second: columns(q1, q0, sign * weights.second),
    }
}

struct SlerpWeights {
    first: f64,
    second: f64,
    first_by_cosine: f64,
    second_by_cosine: f64,
}

/// Weights of the two quaternions for the angle between them, with derivatives with respect to its cosine.
fn slerp_weights(cosine: f64, angle: f64, factor: f64) -> SlerpWeights {
    let (f, g) = (factor, 1.0 - factor);
    if cosine >= LINEAR_ABOVE {
        return SlerpWeights { first: g, second: f, first_by_cosine: 0.0, second_by_cosine: 0.0 };
    }
    let sine = angle.sin();
    // d sin(m a)/sin(a) / d cos(a) = (sin(m a) cos(a) − m cos(m a) sin(a)) / sin³(a)
    let by_cosine = |m: f64| ((m * angle).sin() * cosine - m * (m * angle).cos() * sine) / sine.powi(3);
    SlerpWeights {
        first: (g * angle).sin() / sine,
        second: (f * angle).sin() / sine,
        first_by_cosine: by_cosine(g),
        second_by_cosine: by_cosine(f),
    }
}

impl Interpolated {
    /// Converts a Jacobian (6 rows; columns translation, then half-angle) with respect to the interpolated
    /// pose to one with respect to one of the two poses.
    pub fn carry(&self, by_pose: &[f64; 36], second: bool, jacobian: &mut [f64]) {
        let (share, turn) =
            if second { (self.shares.1, &self.by_second) } else { (self.shares.0, &self.by_first) };
        for row in [0, 3] {
            let block = |column: usize| Matrix3::from_fn(|r, c| by_pose[(column + c) * 6 + row + r]);
            put(jacobian, 6, row, 0, &(block(0) * share));
            put(jacobian, 6, row, 3, &(block(3) * turn));
        }
    }
}
