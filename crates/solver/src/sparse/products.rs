//! Small matrix products, specialised for the sizes of pose problems.

/// `out = AᵀB` for column-major `A` and `B` of `rows` rows; `out` is column-major too.
pub(crate) fn transposed_product(rows: usize, a: &[f64], b: &[f64], out: &mut [f64]) {
    match (rows, a.len()) {
        (3, 9) => fixed::<3, 3>(a, b, out),
        (3, 18) => fixed::<3, 6>(a, b, out),
        (6, 18) => fixed::<6, 3>(a, b, out),
        (6, 36) => fixed::<6, 6>(a, b, out),
        (0, _) => out.fill(0.0),
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

/// With known sizes each column of the result is a sum of rows of `A`: whole vectors, no horizontal sums.
fn fixed<const ROWS: usize, const COLUMNS: usize>(a: &[f64], b: &[f64], out: &mut [f64]) {
    let mut a_rows = [[0.0; COLUMNS]; ROWS];
    for (column, values) in a.as_chunks::<ROWS>().0.iter().enumerate().take(COLUMNS) {
        for row in 0..ROWS {
            a_rows[row][column] = values[row];
        }
    }
    for (out, b) in out.as_chunks_mut::<COLUMNS>().0.iter_mut().zip(b.as_chunks::<ROWS>().0) {
        let mut sum = [0.0; COLUMNS];
        for row in 0..ROWS {
            for column in 0..COLUMNS {
                sum[column] += a_rows[row][column] * b[row];
            }
        }
        *out = sum;
    }
}

/// Adds a column-major block of `height` rows to a panel whose columns are `stride` apart.
pub(crate) fn add_block(block: &[f64], height: usize, panel: &mut [f64], stride: usize) {
    match height {
        3 => add_columns::<3>(block, panel, stride),
        6 => add_columns::<6>(block, panel, stride),
        _ => {
            for (values, target) in block.chunks_exact(height.max(1)).zip(panel.chunks_mut(stride.max(1))) {
                target.iter_mut().zip(values).for_each(|(t, v)| *t += v);
            }
        }
    }
}

fn add_columns<const HEIGHT: usize>(block: &[f64], panel: &mut [f64], stride: usize) {
    for (values, target) in block.as_chunks::<HEIGHT>().0.iter().zip(panel.chunks_mut(stride.max(1))) {
        if let Some(target) = target.first_chunk_mut::<HEIGHT>() {
            for (t, v) in target.iter_mut().zip(values) {
                *t += v;
            }
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

    #[test]
    fn blocks_are_added_column_by_column() {
        for height in [1, 3, 4, 6] {
            let block: Vec<f64> = (0..2 * height).map(|i| i as f64).collect();
            let stride = height + 2;
            let mut panel = vec![1.0; stride + height];
            add_block(&block, height, &mut panel, stride);
            assert_eq!(panel[height - 1], height as f64);
            assert_eq!(panel[stride - 1], 1.0);
            assert_eq!(panel[stride + height - 1], 2.0 * height as f64);
        }
    }
}
