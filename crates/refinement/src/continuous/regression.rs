//! Fits a few unknowns to many residuals, robustly, with their covariance.

use nalgebra::{DMatrix, DVector};

/// Number of standard deviations above which residuals lose weight (Cauchy).
const ROBUST: f64 = 2.0;
/// Number of Gauss–Newton steps.
const STEPS: usize = 6;
/// Number of residuals of neighbouring times that count as one, as their errors are correlated.
const CORRELATED: f64 = 3.0;

/// A fit.
#[derive(Clone, Debug)]
pub(crate) struct Fit {
    pub value: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// Fraction of the weighted sum of squares that the unknowns explain, 0 to 1.
    pub explained: f64,
}

impl Fit {
    pub fn deviation(&self, k: usize) -> f64 {
        self.covariance[(k, k)].max(0.0).sqrt()
    }
}

/// Fits by Gauss–Newton with Jacobians by differences. `residuals` gives for each time a vector of
/// `kinds.len()` numbers, which are distinguished by kind: the standard deviation of each kind is estimated.
/// `steps` are those of the differences, `prior` inverse variances about zero. None with fewer than four
/// times as many residuals as unknowns.
pub(crate) fn fit(
    residuals: impl Fn(&DVector<f64>) -> Vec<Vec<f64>>,
    kinds: &[usize],
    steps: &[f64],
    prior: &[f64],
) -> Option<Fit> {
    let size = steps.len();
    let mut value = DVector::zeros(size);
    let first = residuals(&value);
    if first.len() * kinds.len() < 4 * size {
        return None;
    }
    let mut result = None;
    for _ in 0..STEPS {
        let now = residuals(&value);
        let weights = weights(&now, kinds);
        let moved: Vec<Vec<Vec<f64>>> = (0..size)
            .map(|k| {
                let mut value = value.clone();
                value[k] += steps[k];
                residuals(&value)
            })
            .collect();
        let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        for i in 0..now.len() {
            for row in 0..kinds.len() {
                let j = DVector::from_fn(size, |k, _| (moved[k][i][row] - now[i][row]) / steps[k]);
                matrix += &j * j.transpose() * weights[i][row];
                right -= &j * (weights[i][row] * now[i][row]);
            }
        }
        for k in 0..size {
            matrix[(k, k)] += prior[k];
            right[k] -= prior[k] * value[k];
        }
        let inverse = matrix.try_inverse()?;
        value += &inverse * right;
        let after = residuals(&value);
        let sum = |r: &[Vec<f64>]| -> f64 {
            r.iter().zip(&weights).flat_map(|(r, w)| r.iter().zip(w).map(|(r, w)| w * r * r)).sum()
        };
        let explained = 1.0 - sum(&after) / sum(&first).max(f64::MIN_POSITIVE);
        result = Some(Fit { value: value.clone(), covariance: inverse * CORRELATED, explained });
    }
    result.filter(|fit| fit.value.iter().chain(fit.covariance.iter()).all(|v| v.is_finite()))
}

/// Inverse variances, by kind, and reduced for outliers.
fn weights(residuals: &[Vec<f64>], kinds: &[usize]) -> Vec<Vec<f64>> {
    let count = kinds.iter().max().map_or(0, |k| k + 1);
    let variances: Vec<f64> = (0..count)
        .map(|kind| {
            let own = residuals
                .iter()
                .flat_map(|r| r.iter().zip(kinds).filter(|(_, k)| **k == kind).map(|(r, _)| r.abs()));
            let mut own: Vec<f64> = own.collect();
            own.sort_by(f64::total_cmp);
            // The median of the absolute value of a normal variable is 0.6745 standard deviations.
            let median = own.get(own.len() / 2).copied().unwrap_or(1.0);
            (median / 0.6745).powi(2).max(1e-16)
        })
        .collect();
    let weight = |r: f64, kind: usize| {
        let variance = variances[kind];
        1.0 / (variance * (1.0 + r * r / (ROBUST * ROBUST * variance)))
    };
    residuals.iter().map(|r| r.iter().zip(kinds).map(|(r, k)| weight(*r, *k)).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_in_spite_of_outliers() {
        let residuals = |v: &DVector<f64>| -> Vec<Vec<f64>> {
            (0..200)
                .map(|i| {
                    let x = f64::from(i) * 0.01;
                    let noise = ((f64::from(i) * 0.7548).fract() - 0.5) * 0.1;
                    let outlier = if i % 20 == 0 { 5.0 } else { 0.0 };
                    vec![v[0] + v[1] * x - (0.3 + 2.0 * x + noise + outlier)]
                })
                .collect()
        };
        let fit = fit(residuals, &[0], &[1e-4, 1e-4], &[1e-6, 1e-6]).unwrap();
        assert!((fit.value[0] - 0.3).abs() < 4.0 * fit.deviation(0), "{}", fit.value);
        assert!((fit.value[1] - 2.0).abs() < 4.0 * fit.deviation(1) && fit.deviation(1) < 0.05);
        assert!(fit.explained > 0.5);
        assert!(super::fit(|_| vec![vec![0.0]; 3], &[0], &[1.0], &[1.0]).is_none());
    }
}
