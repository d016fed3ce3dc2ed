//! Histograms with bins of equal width.

/// Values for a histogram. Values that are not finite are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    values: Vec<f64>,
}

/// The bins of a histogram, and statistics of its values.
#[derive(Clone, Debug, PartialEq)]
pub struct HistogramBins {
    /// Number of values.
    pub count: usize,
    /// The smallest.
    pub min: f64,
    /// The largest.
    pub max: f64,
    /// Their mean.
    pub mean: f64,
    /// Width of a bin.
    pub width: f64,
    /// Number of values in each bin, from the smallest value on; the largest value is in the last bin. Empty
    /// if all values are equal.
    pub counts: Vec<usize>,
}

impl Histogram {
    /// Adds a value.
    pub fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.values.push(value);
        }
    }

    /// The values in `steps` bins of equal width, from the smallest to the largest value; `None` without
    /// values.
    pub fn bins(&self, steps: usize) -> Option<HistogramBins> {
        let count = self.values.len();
        if count == 0 || steps == 0 {
            return None;
        }
        let min = self.values.iter().copied().fold(f64::INFINITY, f64::min);
        let max = self.values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mean = self.values.iter().sum::<f64>() / count as f64;
        let width = (max - min) / steps as f64;
        let mut counts = Vec::new();
        if width > 0.0 {
            counts.resize(steps, 0);
            for value in &self.values {
                counts[(((value - min) / width) as usize).min(steps - 1)] += 1;
            }
        }
        Some(HistogramBins { count, min, max, mean, width, counts })
    }
}

impl FromIterator<f64> for Histogram {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut histogram = Self::default();
        values.into_iter().for_each(|value| histogram.add(value));
        histogram
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finite_value_is_in_a_step() {
        let bins = [0.0, 1.0, 1.0, 2.0, f64::NAN].into_iter().collect::<Histogram>().bins(4);
        let expected =
            HistogramBins { count: 4, min: 0.0, max: 2.0, mean: 1.0, width: 0.5, counts: vec![1, 0, 2, 1] };
        assert_eq!(bins, Some(expected));
    }

    #[test]
    fn equal_values_have_no_steps() {
        assert_eq!(Histogram::default().bins(10), None);
        let equal: Histogram = [2.0; 5].into_iter().collect();
        assert!(equal.bins(10).is_some_and(|bins| bins.count == 5 && bins.counts.is_empty()));
    }
}
