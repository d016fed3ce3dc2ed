//! Small matrix products, with fixed sizes where pose problems have them.

/// `out = AᵀB` for column-major `A` and `B` of `rows` rows; `out` is column-major too.
pub(crate) fn transposed_product(rows: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
    match rows {
        3 => fixed::<3>(a, b, out),
        6 => fixed::<6>(a, b, out),
        0 => out.fill(0.0),
        _ => {
            let columns = a.len() / rows;
            for (out, b) in out.chunks_exact_mut(columns.max(1)).zip(b.chunks_exact(rows)) {
                for (out, a) in out.iter_mut().zip(a.chunks_exact(rows)) {
                    *out = a.iter().zip(b).map(|(a, b)| a * b).sum();
                }
            }
        }
    }
}

fn fixed<const ROWS: usize>(a: &[f64], b: &[f64], out: &mut [f64]) {
    let (a, _) = a.as_chunks::<ROWS>();
    let (b, _) = b.as_chunks::<ROWS>();
    for (out, b) in out.chunks_exact_mut(a.len().max(1)).zip(b) {
        for (out, a) in out.iter_mut().zip(a) {
            let mut sum = 0.0;
            for k in 0..ROWS {
                sum += a[k] * b[k];
            }
            *out = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    #[test]
    fn products_are_those_of_matrices() {
        for (rows, m, n) in [(1, 1, 1), (3, 3, 3), (6, 6, 2), (6, 1, 6), (3, 6, 3), (4, 2, 5), (3, 3, 1)] {
            let a = DMatrix::from_fn(rows, m, |i, j| (i * 3 + j) as f64 - 2.5);
            let b = DMatrix::from_fn(rows, n, |i, j| (i * 5 + 2 * j) as f64 * 0.3 - 1.0);
            let mut out = vec![f64::NAN; m * n];
            transposed_product(rows, a.as_slice(), b.as_slice(), &mut out);
            assert!((DMatrix::from_vec(m, n, out) - a.transpose() * b).norm() < 1e-12);
        }
    }
}
