//! Formats numbers as a histogram in text, for logs.

use std::fmt;

use portolan_numeric::HistogramBins;

/// Rows of a histogram.
const BUCKETS: usize = 10;

/// Distribution of numbers; written as count, smallest, largest, mean and one row per bucket.
#[derive(Clone, Debug, Default)]
pub struct Histogram(portolan_numeric::Histogram);

impl FromIterator<f64> for Histogram {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        Self(values.into_iter().collect())
    }
}

impl fmt::Display for Histogram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(bins) = self.0.bins(BUCKETS) else { return f.write_str("count 0") };
        let HistogramBins { count, min, max, mean, width, counts } = bins;
        write!(f, "count {count}, min {min:.6}, max {max:.6}, mean {mean:.6}")?;
        for (bucket, in_bucket) in counts.iter().enumerate() {
            let start = min + bucket as f64 * width;
            let percent = 100.0 * *in_bucket as f64 / count as f64;
            write!(f, "\n  [{start:.6}, {:.6}) {in_bucket:6} ({percent:.1}%)", start + width)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finite_number_is_in_a_bucket() {
        let histogram: Histogram = [0.0, 1.0, 1.0, 2.0, f64::NAN].into_iter().collect();
        let text = histogram.to_string();
        assert!(text.starts_with("count 4, min 0.000000, max 2.000000, mean 1.000000\n"), "{text}");
        let rows: Vec<usize> =
            text.lines().skip(1).map(|l| l.split_whitespace().nth(2).unwrap().parse().unwrap()).collect();
        assert_eq!(rows, [1, 0, 0, 0, 0, 2, 0, 0, 0, 1]);
        assert_eq!(Histogram::default().to_string(), "count 0");
        assert_eq!([3.0].into_iter().collect::<Histogram>().to_string().lines().count(), 1);
    }
}
