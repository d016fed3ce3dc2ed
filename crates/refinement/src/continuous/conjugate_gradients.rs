//! Solves symmetric positive definite equations that are never formed, by preconditioned conjugate gradients.

use super::unknowns::dot;

/// Fraction of the residual that may remain in a final solution.
pub(crate) const TIGHT: f64 = 1e-3;
/// Fraction of the residual that may remain where the equations are linearised again afterwards.
pub(crate) const LOOSE: f64 = 1e-2;
/// Maximum number of steps.
const MAX_STEPS: usize = 150;

/// Solves `S x = right` (Hestenes and Stiefel 1952) until the residual has decreased to the fraction
/// `tolerance`.
pub(crate) fn conjugate_gradients(
    right: &[f64],
    product: impl Fn(&[f64], &mut [f64]),
    precondition: impl Fn(&mut [f64]),
    tolerance: f64,
) -> Vec<f64> {
    let size = right.len();
    let mut x = vec![0.0; size];
    let mut residual = right.to_vec();
    let mut z = residual.clone();
    precondition(&mut z);
    let mut direction = z.clone();
    let mut rz = dot(&residual, &z);
    let goal = rz * tolerance * tolerance;
    let mut image = vec![0.0; size];
    for _ in 0..MAX_STEPS {
        if rz <= goal || rz <= 0.0 {
            return x;
        }
        product(&direction, &mut image);
        let curvature = dot(&direction, &image);
        if curvature <= 0.0 {
            return x;
        }
        let length = rz / curvature;
        for i in 0..size {
            x[i] += length * direction[i];
            residual[i] -= length * image[i];
        }
        z.copy_from_slice(&residual);
        precondition(&mut z);
        let next = dot(&residual, &z);
        let ratio = next / rz;
        rz = next;
        for i in 0..size {
            direction[i] = z[i] + ratio * direction[i];
        }
    }
    x
}
