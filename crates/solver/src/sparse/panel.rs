//! Dense operations on adjacent columns for the Cholesky factorisation.
//!
//! All sums have a fixed order, without fused multiply-add, so that they are the same on every processor.

use wide::f64x4;

/// Number of rows and columns of a tile of a product that is kept in registers.
const TILE: usize = 4;
/// Number of columns that are factorised before the columns after them are updated.
const STRIP: usize = 16;

/// Values in columns, `stride` apart; the slice begins at the first row.
#[derive(Clone, Copy)]
pub(super) struct Columns<'a> {
    pub values: &'a [f64],
    pub stride: usize,
}

/// `target -= a bᵀ` for `rows` rows of `a` and `columns` rows of `b`, which both have `inner` columns. Above
/// the diagonal the result is undefined.
pub(super) fn subtract_product(
    target: &mut [f64],
    stride: usize,
    (a, b): (Columns, Columns),
    (rows, columns, inner): (usize, usize, usize),
) {
    for column in (0..columns).step_by(TILE) {
        let b = Columns { values: b.values.get(column..).unwrap_or_default(), ..b };
        // Tiles above the diagonal are skipped.
        for row in (column..rows).step_by(TILE) {
            let a = Columns { values: &a.values[row..], ..a };
            let target = &mut target[column * stride + row..];
            let size = (TILE.min(rows - row), TILE.min(columns - column));
            match size {
                (TILE, 4) => subtract_tile::<4>(target, stride, (a, b), inner),
                (TILE, 3) => subtract_tile::<3>(target, stride, (a, b), inner),
                (TILE, 2) => subtract_tile::<2>(target, stride, (a, b), inner),
                (TILE, 1) => subtract_tile::<1>(target, stride, (a, b), inner),
                _ => subtract_corner(target, stride, (a, b), size, inner),
            }
        }
    }
}

fn subtract_tile<const COLUMNS: usize>(
    target: &mut [f64],
    stride: usize,
    (a, b): (Columns, Columns),
    inner: usize,
) {
    let mut sums = [f64x4::ZERO; COLUMNS];
    for k in 0..inner {
        let (Some(left), Some(right)) = (
            a.values[k * a.stride..].first_chunk::<TILE>(),
            b.values[k * b.stride..].first_chunk::<COLUMNS>(),
        ) else {
            return;
        };
        let left = f64x4::from(*left);
        // Indices instead of iterators, because these become calls where nothing is inlined across codegen
        // units of a crate.
        for column in 0..COLUMNS {
            sums[column] += left * f64x4::splat(right[column]);
        }
    }
    for (column, sum) in sums.into_iter().enumerate() {
        if let Some(place) = target[column * stride..].first_chunk_mut::<TILE>() {
            *place = (f64x4::from(*place) - sum).to_array();
        }
    }
}

/// The same for the last rows, which do not fill a tile.
fn subtract_corner(
    target: &mut [f64],
    stride: usize,
    (a, b): (Columns, Columns),
    (rows, columns): (usize, usize),
    inner: usize,
) {
    for column in 0..columns {
        for (row, place) in target[column * stride..][..rows].iter_mut().enumerate() {
            let product = |k: usize| a.values[k * a.stride + row] * b.values[k * b.stride + column];
            *place -= (0..inner).map(product).sum::<f64>();
        }
    }
}

/// Cholesky factorisation of the first `width` rows of a panel with as many columns, and the resulting rows
/// below. Returns false if the matrix is not positive definite.
pub(super) fn factorize(panel: &mut [f64], height: usize, width: usize) -> bool {
    for first in (0..width).step_by(STRIP) {
        let end = width.min(first + STRIP);
        let (done, later) = panel.split_at_mut(end * height);
        let strip = &mut done[first * height..];
        if !factorize_strip(strip, height, first) {
            return false;
        }
        let below = Columns { values: &strip[end.min(height)..], stride: height };
        let size = (height - end, width - end, end - first);
        subtract_product(later.get_mut(end..).unwrap_or_default(), height, (below, below), size);
    }
    true
}

/// The same for a strip of columns; the diagonal of the first one is in row `first`.
fn factorize_strip(strip: &mut [f64], height: usize, first: usize) -> bool {
    let width = strip.len() / height;
    for column in 0..width {
        let (before, own) = strip.split_at_mut(column * height);
        let own = &mut own[first + column..height];
        for earlier in before.chunks_exact(height) {
            let earlier = &earlier[first + column..];
            let factor = earlier[0];
            for i in 0..own.len().min(earlier.len()) {
                own[i] -= factor * earlier[i];
            }
        }
        let pivot = own[0];
        // NaN is not a valid pivot either.
        if !(pivot > 0.0 && pivot.is_finite()) {
            return false;
        }
        let root = pivot.sqrt();
        own[0] = root;
        own[1..].iter_mut().for_each(|value| *value /= root);
    }
    true
}

#[cfg(test)]
mod tests {
    use portolan_numeric::Lcg64;

    use super::*;

    #[test]
    fn a_panel_times_its_transpose_is_the_factorised_matrix() {
        for (width, height) in [(1, 1), (3, 3), (3, 10), (6, 41), (17, 17), (33, 70), (50, 53)] {
            let mut random = Lcg64::new(7);
            let mut uniform = || (random.bits() >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
            let mut panel: Vec<f64> = (0..width * height).map(|_| uniform()).collect();
            (0..width).for_each(|k| panel[k * height + k] = width as f64);
            let before = panel.clone();
            assert!(factorize(&mut panel, height, width));
            for column in 0..width {
                for row in column..height {
                    let product = |k: usize| panel[k * height + row] * panel[k * height + column];
                    let sum: f64 = (0..=column).map(product).sum();
                    let error = sum - before[column * height + row];
                    assert!(error.abs() < 1e-13 * width as f64, "{width} {height}: {row} {column}, {error}");
                }
            }
        }
    }

    #[test]
    fn pivots_must_be_positive_numbers() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(!factorize(&mut [1.0, 0.5, 0.0, bad], 2, 2), "{bad}");
        }
    }
}
