//! Derivatives of rotations, and conversion of variables to poses.
//!
//! Rotations are updated from the left by half-angle vectors δ: `q ← exp(δ) ⊗ q`, which rotates `R v` by the
//! rotation vector 2δ.

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid2, Rigid3, Vector3};

pub(super) type Matrix3 = na::Matrix3<f64>;

/// The 2D pose of a variable.
pub(super) fn read_se2(values: &[f64]) -> Option<Rigid2> {
    let &[x, y, angle] = values else { return None };
    Some(Rigid2::new(x, y, angle))
}

/// The pose of a variable.
pub(super) fn read_se3(values: &[f64]) -> Option<Rigid3> {
    let (translation, rotation) = values.split_at_checked(3)?;
    let &[x, y, z] = translation else { return None };
    Some(Rigid3::from_parts(na::Translation3::new(x, y, z), read_rotation(rotation)?))
}

/// The rotation of a variable.
pub(super) fn read_rotation(values: &[f64]) -> Option<Quaternion> {
    let &[w, x, y, z] = values else { return None };
    // The manifold keeps the norm at one.
    Some(Quaternion::new_unchecked(na::Quaternion::new(w, x, y, z)))
}

/// The matrix of a cross product: `skew(a) b = a × b`.
pub(super) fn skew(v: &Vector3) -> Matrix3 {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// `∂ log(exp(φ) Q)/∂φ` at φ = 0 for rotation vectors, with `θ = log Q` (the inverse left Jacobian of
/// SO(3); Solà et al., "A micro Lie theory", 2018, eq. 146).
pub(super) fn inverse_left_jacobian(theta: &Vector3) -> Matrix3 {
    let squared = theta.norm_squared();
    let cross = skew(theta);
    let coefficient = if squared < 1e-8 {
        1.0 / 12.0
    } else {
        let half = squared.sqrt() / 2.0;
        (1.0 - half / half.tan()) / squared
    };
    Matrix3::identity() - cross * 0.5 + cross * cross * coefficient
}

/// `∂ vec(exp(a) ⊗ q)/∂a` at a = 0 for half-angle vectors.
pub(super) fn vector_part_jacobian(q: &Quaternion) -> Matrix3 {
    Matrix3::identity() * q.w - skew(&q.imag())
}

/// `angleaxis(q)`, the rotation vector of length at most π.
pub(super) fn log(q: &Quaternion) -> Vector3 {
    portolan_geometry::angle_axis_from_quaternion(q)
}

/// Copies a matrix into a column-major Jacobian with `rows` rows, at the given row and column.
pub(super) fn put(jacobian: &mut [f64], rows: usize, row: usize, column: usize, block: &Matrix3) {
    for c in 0..3 {
        let at = (column + c) * rows + row;
        if let Some(target) = jacobian.get_mut(at..at + 3) {
            target.copy_from_slice(block.column(c).as_slice());
        }
    }
}

/// Copies a vector into a residual, from the given row on.
pub(super) fn put_residual(residual: &mut [f64], row: usize, part: &Vector3) {
    if let Some(target) = residual.get_mut(row..row + 3) {
        target.copy_from_slice(part.as_slice());
    }
}
