//! Writes histograms as text (`spec/tools.md` §2.6).

use std::fmt::Write;

/// Maximum number of values that are kept; further ones are only counted as dropped.
const MAX_VALUES: usize = 1 << 20;
const BUCKETS: usize = 10;
const BAR: usize = 20;

/// Collects values and writes their distribution.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    values: Vec<f64>,
    dropped: u64,
}

impl Histogram {
    /// Adds a value; non-finite values are left out.
    pub fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        if self.values.len() < MAX_VALUES {
            self.values.push(value);
        } else {
            self.dropped += 1;
        }
    }

    /// Whether there is no value.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Largest value.
    pub fn max(&self) -> Option<f64> {
        self.values.iter().copied().max_by(f64::total_cmp)
    }

    /// Median.
    pub fn median(&self) -> Option<f64> {
        portolan_numeric::median(&mut self.values.clone())
    }

    /// `Count: n  Min: a  Max: b  Mean: m`, then one line for each of ten equal bins from the least to the
    /// largest value, with a bar of up to 20 `#`, count, fraction and the running total.
    pub fn to_text(&self) -> String {
        let (Some(min), Some(max)) = (self.values.iter().copied().min_by(f64::total_cmp), self.max()) else {
            return "Count: 0".to_owned();
        };
        let count = self.values.len();
        let mean = self.values.iter().sum::<f64>() / count as f64;
        let mut text = format!("Count: {count}  Min: {min:.6}  Max: {max:.6}  Mean: {mean:.6}");
        if min >= max {
            return text;
        }
        let edge = |i: usize| min + (max - min) * i as f64 / BUCKETS as f64;
        let mut counts = [0usize; BUCKETS];
        for value in &self.values {
            let bucket = ((value - min) / (max - min) * BUCKETS as f64) as usize;
            counts[bucket.min(BUCKETS - 1)] += 1;
        }
        let mut total = 0;
        for (i, bucket) in counts.iter().enumerate() {
            total += bucket;
            let share = |n: usize| n as f64 / count as f64;
            let bar = (share(*bucket) * BAR as f64).round() as usize;
            let end = if i + 1 == BUCKETS { ']' } else { ')' };
            // Writing to a string cannot fail.
            let _ = write!(
                text,
                "\n[{:.6}, {:.6}{end}\t{:>BAR$}\tCount: {bucket} ({:.6}%)\tTotal: {total} ({:.6}%)",
                edge(i),
                edge(i + 1),
                "#".repeat(bar),
                100.0 * share(*bucket),
                100.0 * share(total),
            );
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_buckets_with_bars_and_totals() {
        let mut histogram = Histogram::default();
        for i in 0..=10 {
            histogram.add(f64::from(i));
        }
        histogram.add(f64::NAN);
        let text = histogram.to_text();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 11);
        assert_eq!(lines[0], "Count: 11  Min: 0.000000  Max: 10.000000  Mean: 5.000000");
        assert_eq!(
            lines[1],
            "[0.000000, 1.000000)\t                  ##\tCount: 1 (9.090909%)\tTotal: 1 (9.090909%)"
        );
        assert!(lines[10].starts_with("[9.000000, 10.000000]\t                ####\tCount: 2"));
        assert_eq!(histogram.median(), Some(5.0));
    }

    #[test]
    fn one_value_has_no_buckets() {
        let mut histogram = Histogram::default();
        histogram.add(2.0);
        assert_eq!(histogram.to_text(), "Count: 1  Min: 2.000000  Max: 2.000000  Mean: 2.000000");
        assert_eq!(Histogram::default().to_text(), "Count: 0");
    }
}
