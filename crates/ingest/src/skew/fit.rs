//! Compares how well sweeps fit each other under different assumptions on the motion in their points.
//!
//! Residuals of points beyond the seam of a turn are as large as the motion of a turn, so the robust loss
//! takes them for outliers. Linear least squares may then miss the motion where only these points could show
//! it. The number of points on surfaces after de-skewing shows it.

use super::INFLATION;
use super::evidence::TurnTimes;
use super::follow::Followed;

/// Number of standard errors from which a fit counts as better or worse.
const CLEARLY: f64 = 2.5;
/// Minimum number of pairs of sweeps for a standard error.
const MIN_PAIRS: usize = 4;

/// Turns of usual lidars: begin behind, at the sides and ahead, in both directions.
pub(super) fn usual_turns() -> impl Iterator<Item = TurnTimes> {
    [0.0, 0.25, 0.5, 0.75]
        .into_iter()
        .flat_map(|begin| [1.0, -1.0].map(|sense| TurnTimes::by_azimuth(begin, sense)))
}

/// Whether sweeps fit clearly better in `other`; both hold the same pairs.
pub(super) fn is_better(one: &[Followed], other: &[Followed]) -> bool {
    is_clearly_positive(&gains(one, other))
}

/// By how many standard errors sweeps fit better in `other`, or worse if negative. Pairs that share sweeps
/// are not independent, so errors are inflated as those of factors. Zero if there are too few pairs.
pub(super) fn sigmas_better(one: &[Followed], other: &[Followed]) -> f64 {
    let (mean, error) = mean_and_error(&gains(one, other));
    let sigmas = mean / (INFLATION * error);
    if sigmas.is_finite() { sigmas } else { 0.0 }
}

/// Weighted number of points on surfaces, over all pairs.
pub(super) fn explained(followed: &[Followed]) -> f64 {
    followed.iter().flat_map(|followed| &followed.pairs).map(|pair| pair.explained).sum()
}

/// How many more points of each pair are on surfaces in `other`.
fn gains(one: &[Followed], other: &[Followed]) -> Vec<f64> {
    (one.iter().zip(other))
        .flat_map(|(one, other)| one.pairs.iter().zip(&other.pairs))
        .map(|(one, other)| other.explained - one.explained)
        .collect()
}

/// The mean and its standard error, as if values were independent; NaN if they are too few.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let error = if values.len() >= MIN_PAIRS { (variance / n).sqrt() } else { f64::NAN };
    (mean, error)
}

fn is_clearly_positive(gains: &[f64]) -> bool {
    let (mean, error) = mean_and_error(gains);
    mean > CLEARLY * error
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_must_exceed_its_own_scatter() {
        assert!(is_clearly_positive(&[4.0, 5.0, 3.0, 4.0]));
        assert!(!is_clearly_positive(&[4.0, -5.0, 3.0, 1.0]));
        assert!(!is_clearly_positive(&[-4.0, -5.0, -3.0, -4.0]));
        assert!(!is_clearly_positive(&[9.0, 9.0]) && !is_clearly_positive(&[]));
        assert!(!is_clearly_positive(&[f64::NAN; 5]));
    }
}
