//! Summaries of many errors.

use std::fmt;

use portolan_numeric::{mean, percentile, rms};
use serde::Serialize;

/// Figures of a set of errors, all in the unit of the errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorStatistics {
    /// How many errors.
    pub count: usize,
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median; of an even number the mean of the middle two.
    pub median: f64,
    /// 95th percentile, interpolated.
    pub percentile_95: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl ErrorStatistics {
    /// Summarises errors; none if there are none.
    pub fn of(errors: &[f64]) -> Option<Self> {
        let mut sorted = errors.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (min, max) = (*sorted.first()?, *sorted.last()?);
        Some(Self {
            count: sorted.len(),
            rmse: rms(&sorted)?,
            mean: mean(&sorted)?,
            median: percentile(&sorted, 0.5)?,
            percentile_95: percentile(&sorted, 0.95)?,
            min,
            max,
        })
    }
}

impl fmt::Display for ErrorStatistics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "rmse {:.4}  mean {:.4}  median {:.4}  95% {:.4}  max {:.4}",
            self.rmse, self.mean, self.median, self.percentile_95, self.max
        )
    }
}

/// Mean and sample standard deviation (with n − 1).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanDeviation {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation.
    pub standard_deviation: f64,
}

impl MeanDeviation {
    /// Of at least two values.
    pub fn of(values: impl Iterator<Item = f64> + Clone) -> Option<Self> {
        let count = values.clone().count();
        if count < 2 {
            return None;
        }
        let mean = values.clone().sum::<f64>() / count as f64;
        let squares = values.map(|v| (v - mean) * (v - mean)).sum::<f64>();
        Some(Self { mean, standard_deviation: (squares / (count - 1) as f64).sqrt() })
    }
}

impl fmt::Display for MeanDeviation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.5} +/- {:.5}", self.mean, self.standard_deviation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_a_few_numbers() {
        let s = ErrorStatistics::of(&[3.0, 1.0, 2.0, 10.0]).unwrap();
        assert_eq!((s.count, s.mean, s.median, s.min, s.max), (4, 4.0, 2.5, 1.0, 10.0));
        assert!((s.rmse - 28.5_f64.sqrt()).abs() < 1e-12 && (s.percentile_95 - 8.95).abs() < 1e-12);
        assert!(ErrorStatistics::of(&[]).is_none());
        let m = MeanDeviation::of([1.0, 2.0, 3.0, 4.0].into_iter()).unwrap();
        assert!((m.standard_deviation - (5.0_f64 / 3.0).sqrt()).abs() < 1e-12);
        assert_eq!(m.to_string(), "2.50000 +/- 1.29099");
        assert!(MeanDeviation::of([1.0].into_iter()).is_none());
    }
}
