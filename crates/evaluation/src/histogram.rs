//! Histograms as text (`spec/tools.md` §2.6).

use std::fmt::Write;

use portolan_numeric::HistogramBins;

/// Characters of a full bar.
const BAR: usize = 20;

/// Values for a histogram. Values that are not finite are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram(portolan_numeric::Histogram);

impl Histogram {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        self.0.add(value);
    }

    /// The histogram with `buckets` bins of equal width from the smallest to the largest value.
    pub fn to_text(&self, buckets: usize) -> String {
        let Some(bins) = self.0.bins(buckets) else { return "Count: 0".to_owned() };
        let HistogramBins { count, min, max, mean, .. } = bins;
        let mut text = format!("Count: {count}  Min: {min:.6}  Max: {max:.6}  Mean: {mean:.6}");
        write_buckets(&mut text, &bins);
        text
    }
}

fn write_buckets(text: &mut String, bins: &HistogramBins) {
    let HistogramBins { min, width, counts, .. } = bins;
    let total = bins.count as f64;
    let mut cumulative = 0;
    for (i, count) in counts.iter().enumerate() {
        cumulative += count;
        let fraction = *count as f64 / total;
        let (low, high) = (min + width * i as f64, min + width * (i + 1) as f64);
        let bracket = if i + 1 == counts.len() { ']' } else { ')' };
        let bar = "#".repeat((fraction * BAR as f64).round() as usize);
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n[{low:.6}, {high:.6}{bracket}\t{bar:>BAR$}\tCount: {count} ({:.6}%)\tTotal: {cumulative} ({:.6}%)",
            100.0 * fraction,
            100.0 * cumulative as f64 / total,
        );
    }
}

impl FromIterator<f64> for Histogram {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        Self(values.into_iter().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_drawn() {
        let histogram: Histogram = [0.0, 0.1, 0.2, 1.0, f64::NAN].into_iter().collect();
        let text = histogram.to_text(2);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "Count: 4  Min: 0.000000  Max: 1.000000  Mean: 0.325000");
        let bar = format!("{:>20}", "#".repeat(15));
        assert_eq!(
            lines[1],
            format!("[0.000000, 0.500000)\t{bar}\tCount: 3 (75.000000%)\tTotal: 3 (75.000000%)")
        );
        assert!(
            lines[2].starts_with("[0.500000, 1.000000]\t") && lines[2].ends_with("Total: 4 (100.000000%)")
        );
    }

    #[test]
    fn equal_values_have_no_buckets() {
        assert_eq!(Histogram::default().to_text(10), "Count: 0");
        let same: Histogram = [2.0; 5].into_iter().collect();
        assert_eq!(same.to_text(10).lines().count(), 1);
    }
}
