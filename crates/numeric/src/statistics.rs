//! Statistics of values. They are `None` for an empty list.

/// The quantile for a fraction, as one of the values (not interpolated). NaN counts as the largest value. The
/// order of the values changes.
pub fn quantile(values: &mut [f64], fraction: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let index = ((fraction * values.len() as f64) as usize).min(last);
    Some(*values.select_nth_unstable_by(index, f64::total_cmp).1)
}

/// The median, of an even number the upper one of the middle two. NaN counts as the largest value. The order
/// of the values changes.
pub fn median(values: &mut [f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// The quantile of values in ascending order, interpolated between the two neighbouring values. The median of
/// an even number is the mean of the middle two.
pub fn percentile(sorted: &[f64], fraction: f64) -> Option<f64> {
    let position = fraction.clamp(0.0, 1.0) * sorted.len().checked_sub(1)? as f64;
    let below = position.floor();
    let low = *sorted.get(below as usize)?;
    let high = sorted.get(below as usize + 1).copied().unwrap_or(low);
    Some(low + (high - low) * (position - below))
}

/// The arithmetic mean.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The root of the mean square.
pub fn rms(values: &[f64]) -> Option<f64> {
    let squares = values.iter().map(|value| value * value).sum::<f64>();
    (!values.is_empty()).then(|| (squares / values.len() as f64).sqrt())
}

/// Probabilities of alternatives from their log likelihoods, which may have a common offset.
pub fn probabilities(logs: &[f64]) -> Vec<f64> {
    let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let likelihoods: Vec<f64> = logs.iter().map(|log| (log - highest).exp()).collect();
    let all: f64 = likelihoods.iter().sum();
    likelihoods.into_iter().map(|likelihood| likelihood / all).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_are_those_of_likelihoods_however_small() {
        let found = probabilities(&[-1000.0, -1000.0 + 3_f64.ln(), f64::NEG_INFINITY]);
        let differs =
            found.iter().zip([0.25, 0.75, 0.0]).any(|(found, expected)| (found - expected).abs() > 1e-12);
        assert!(!differs, "{found:?}");
        assert!(probabilities(&[]).is_empty());
    }

    #[test]
    fn quantiles_occur_and_percentiles_are_interpolated() {
        let mut values = [5.0, f64::NAN, 1.0, 3.0, 2.0];
        assert_eq!(median(&mut values), Some(3.0));
        assert!(quantile(&mut values, 1.0).unwrap().is_nan());
        assert_eq!(quantile(&mut values, 0.0), Some(1.0));
        assert_eq!((median(&mut []), percentile(&[], 0.5), mean(&[]), rms(&[])), (None, None, None, None));
        assert_eq!(percentile(&[1.0, 2.0, 4.0, 8.0], 0.5), Some(3.0));
        assert_eq!(percentile(&[1.0, 2.0, 4.0, 8.0], 1.0), Some(8.0));
        assert_eq!(percentile(&[7.0], 0.95), Some(7.0));
    }
}
