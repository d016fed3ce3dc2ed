//! Writes histograms as text (`spec/tools.md` §2.6).

use std::fmt::Write;

/// Maximum number of values that are kept; of more, every second, fourth, … value is kept.
const MAX_VALUES: usize = 1 << 20;
const BUCKETS: usize = 10;
const BAR: usize = 20;

/// Collects values and writes their distribution. Count, extremes and mean are of all values, median and bins
/// of those that are kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    kept: Vec<f64>,
    /// Binary logarithm of the number of values for each one that is kept.
    halvings: u32,
    count: u64,
    sum: f64,
    /// Smallest and largest value.
    range: Option<(f64, f64)>,
}

impl Histogram {
    /// Adds a value; non-finite values are left out.
    pub fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        if self.count.is_multiple_of(1 << self.halvings) {
            self.kept.push(value);
        }
        self.count += 1;
        self.sum += value;
        self.range = Some(self.range.map_or((value, value), |(min, max)| (min.min(value), max.max(value))));
        if self.kept.len() == MAX_VALUES {
            let mut is_first_of_two = false;
            self.kept.retain(|_| {
                is_first_of_two = !is_first_of_two;
                is_first_of_two
            });
            self.halvings += 1;
        }
    }

    /// Whether there is no value.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Largest value.
    pub fn max(&self) -> Option<f64> {
        self.range.map(|(_, max)| max)
    }

    /// Median.
    pub fn median(&self) -> Option<f64> {
        portolan_numeric::median(&mut self.kept.clone())
    }

    /// `Count: n  Min: a  Max: b  Mean: m`, then one line for each of ten equal bins from the least to the
    /// largest value, with a bar of up to 20 `#`, count, fraction and the running total.
    pub fn to_text(&self) -> String {
        let Some((min, max)) = self.range else { return "Count: 0".to_owned() };
        let (count, mean) = (self.count, self.sum / self.count as f64);
        let mut text = format!("Count: {count}  Min: {min:.6}  Max: {max:.6}  Mean: {mean:.6}");
        if min >= max {
            return text;
        }
        if self.halvings > 0 {
            // Writing to a string cannot fail.
            let _ = write!(text, "  Bins: one of {} values", 1u64 << self.halvings);
        }
        let edge = |i: usize| min + (max - min) * i as f64 / BUCKETS as f64;
        let mut counts = [0usize; BUCKETS];
        for value in &self.kept {
            let bucket = ((value - min) / (max - min) * BUCKETS as f64) as usize;
            counts[bucket.min(BUCKETS - 1)] += 1;
        }
        let mut total = 0;
        for (i, bucket) in counts.iter().enumerate() {
            total += bucket;
            let share = |n: usize| n as f64 / self.kept.len() as f64;
            let bar = (share(*bucket) * BAR as f64).round() as usize;
            let end = if i + 1 == BUCKETS { ']' } else { ')' };
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
    fn of_very_many_values_the_bins_are_a_sample_and_the_rest_is_exact() {
        let mut histogram = Histogram::default();
        let count = 3 * MAX_VALUES;
        (0..count).for_each(|i| histogram.add(i as f64));
        let text = histogram.to_text();
        let max = (count - 1) as f64;
        let head = format!(
            "Count: {count}  Min: 0.000000  Max: {max:.6}  Mean: {:.6}  Bins: one of 4 values",
            0.5 * max
        );
        assert_eq!(text.lines().next(), Some(head.as_str()));
        assert!((histogram.median().unwrap() - 0.5 * max).abs() <= 4.0);
        assert!(text.lines().skip(1).all(|line| line.contains("\tCount: 7864")), "{text}");
    }

    #[test]
    fn one_value_has_no_buckets() {
        let mut histogram = Histogram::default();
        histogram.add(2.0);
        assert_eq!(histogram.to_text(), "Count: 1  Min: 2.000000  Max: 2.000000  Mean: 2.000000");
        assert_eq!(Histogram::default().to_text(), "Count: 0");
    }
}
