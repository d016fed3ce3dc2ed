//! Square roots of information matrices.

use nalgebra::{SMatrix, SVector};

/// Fraction of the largest eigenvalue below which an eigenvalue counts as zero or, if negative, as rounding.
const RELATIVE_ZERO: f64 = 1e-12;

/// `S` with `SᵀS = Ω` for a symmetric positive semidefinite `Ω`, and whether `Ω` had to be repaired:
/// directions with negative eigenvalues get no information. `None` if an entry is not finite. Only the
/// symmetric part of `Ω` is used.
pub fn square_root_information<const N: usize>(
    information: &SMatrix<f64, N, N>,
) -> Option<(SMatrix<f64, N, N>, bool)> {
    if !information.iter().all(|v| v.is_finite()) {
        return None;
    }
    let symmetric = (information + information.transpose()) * 0.5;
    if let Some(root) = cholesky(&symmetric) {
        return Some((root, false));
    }
    // Rarely needed, so by the plain Jacobi method, which works for any size and for zero eigenvalues.
    let (values, vectors) = symmetric_eigen(symmetric);
    let zero = RELATIVE_ZERO * values.amax();
    let repaired = values.iter().any(|v| *v < -zero);
    let roots = values.map(|v| if v > zero { v.sqrt() } else { 0.0 });
    Some((SMatrix::from_diagonal(&roots) * vectors.transpose(), repaired))
}

/// Upper triangular `S` with `SᵀS = A`, if `A` is safely positive definite.
fn cholesky<const N: usize>(a: &SMatrix<f64, N, N>) -> Option<SMatrix<f64, N, N>> {
    let mut upper = SMatrix::<f64, N, N>::zeros();
    for i in 0..N {
        let mut pivot = a[(i, i)];
        for k in 0..i {
            pivot -= upper[(k, i)] * upper[(k, i)];
        }
        if pivot <= RELATIVE_ZERO * a[(i, i)].abs() || pivot <= 0.0 {
            return None;
        }
        let root = pivot.sqrt();
        upper[(i, i)] = root;
        for j in i + 1..N {
            let mut value = a[(i, j)];
            for k in 0..i {
                value -= upper[(k, i)] * upper[(k, j)];
            }
            upper[(i, j)] = value / root;
        }
    }
    Some(upper)
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix by cyclic Jacobi rotations.
fn symmetric_eigen<const N: usize>(mut a: SMatrix<f64, N, N>) -> (SVector<f64, N>, SMatrix<f64, N, N>) {
    let mut vectors = SMatrix::<f64, N, N>::identity();
    for _ in 0..50 {
        let off: f64 = (0..N).flat_map(|i| (0..i).map(move |j| (i, j))).map(|at| a[at] * a[at]).sum();
        if off <= f64::EPSILON * f64::EPSILON * a.norm_squared() {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                if a[(p, q)] == 0.0 {
                    continue;
                }
                let theta = (a[(q, q)] - a[(p, p)]) / (2.0 * a[(p, q)]);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let c = 1.0 / t.hypot(1.0);
                let s = t * c;
                for k in 0..N {
                    let (x, y) = (a[(k, p)], a[(k, q)]);
                    (a[(k, p)], a[(k, q)]) = (c * x - s * y, s * x + c * y);
                    let (x, y) = (vectors[(k, p)], vectors[(k, q)]);
                    (vectors[(k, p)], vectors[(k, q)]) = (c * x - s * y, s * x + c * y);
                }
                for k in 0..N {
                    let (x, y) = (a[(p, k)], a[(q, k)]);
                    (a[(p, k)], a[(q, k)]) = (c * x - s * y, s * x + c * y);
                }
            }
        }
    }
    (a.diagonal(), vectors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Matrix6};
    use proptest::prelude::*;

    #[test]
    fn indefinite_matrices_lose_only_their_negative_part() {
        let (root, repaired) =
            square_root_information(&Matrix3::from_diagonal(&[4.0, -1.0, 0.0].into())).unwrap();
        let product = root.transpose() * root;
        assert!(repaired && (product - Matrix3::from_diagonal(&[4.0, 0.0, 0.0].into())).norm() < 1e-12);
        let (root, repaired) = square_root_information(&Matrix3::<f64>::zeros()).unwrap();
        assert!(!repaired && root.norm() == 0.0);
        assert!(square_root_information(&Matrix3::from_element(f64::NAN)).is_none());
    }

    proptest! {
        #[test]
        fn roots_square_to_the_matrix(entries in prop::array::uniform32(-2.0..2.0f64), rank in 1usize..7) {
            let a = Matrix6::from_fn(|i, j| if i < rank { entries[(i * 6 + j) % 32] } else { 0.0 });
            let information = a.transpose() * a;
            let (root, repaired) = square_root_information(&information).unwrap();
            prop_assert!(!repaired);
            prop_assert!((root.transpose() * root - information).norm() < 1e-9 * (1.0 + information.norm()));
        }
    }
}
