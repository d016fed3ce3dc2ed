//! Numbers as a histogram in words, for logs.

use std::fmt;

/// Rows of a histogram.
const BUCKETS: usize = 10;

/// Counts how numbers are distributed; written as count, smallest, largest, mean and one row per bucket.
#[derive(Clone, Debug, Default)]
pub struct Histogram {
    values: Vec<f64>,
}

impl Histogram {
    /// One more number; one that is not finite does not count.
    pub fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.values.push(value);
        }
    }
}

impl FromIterator<f64> for Histogram {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut histogram = Self::default();
        values.into_iter().for_each(|value| histogram.add(value));
        histogram
    }
}

impl fmt::Display for Histogram {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.values.len();
        if count == 0 {
            return f.write_str("count 0");
        }
        let min = self.values.iter().copied().fold(f64::INFINITY, f64::min);
        let max = self.values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mean = self.values.iter().sum::<f64>() / count as f64;
        write!(f, "count {count}, min {min:.6}, max {max:.6}, mean {mean:.6}")?;
        let width = (max - min) / BUCKETS as f64;
        if width <= 0.0 {
            return Ok(());
        }
        let mut counts = [0_usize; BUCKETS];
        for value in &self.values {
            counts[(((value - min) / width) as usize).min(BUCKETS - 1)] += 1;
        }
        for (bucket, in_bucket) in counts.iter().enumerate() {
            let start = min + bucket as f64 * width;
            let share = 100.0 * *in_bucket as f64 / count as f64;
            write!(f, "\n  [{start:.6}, {:.6}) {in_bucket:6} ({share:.1}%)", start + width)?;
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
