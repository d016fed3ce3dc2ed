//! Histogram of fixed size of the processing times of scans.

use std::time::Duration;

/// Number of bins per doubling of the time: neighbouring bounds differ by 9 %.
const BINS_PER_DOUBLING: f64 = 8.0;
/// Number of bins. The first ends at one microsecond, the last contains everything beyond two minutes.
const BINS: usize = 216;

/// Histogram of times with bins of logarithmic width, so that quantiles are known to 9 %.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LatencyHistogram {
    counts: Vec<u64>,
    total: Duration,
    longest: Duration,
}

impl Default for LatencyHistogram {
    fn default() -> Self {
        Self { counts: vec![0; BINS], total: Duration::ZERO, longest: Duration::ZERO }
    }
}

impl LatencyHistogram {
    /// Adds a time.
    pub fn add(&mut self, time: Duration) {
        let doublings = (time.as_secs_f64() * 1e6).max(1.0).log2();
        let bin = (doublings * BINS_PER_DOUBLING).ceil() as usize;
        if let Some(count) = self.counts.get_mut(bin.min(BINS - 1)) {
            *count += 1;
        }
        self.total += time;
        self.longest = self.longest.max(time);
    }

    /// Adds the times of another histogram.
    pub fn merge(&mut self, other: &Self) {
        for (count, more) in self.counts.iter_mut().zip(&other.counts) {
            *count += more;
        }
        self.total += other.total;
        self.longest = self.longest.max(other.longest);
    }

    /// Number of times.
    pub fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Sum of all times.
    pub fn total(&self) -> Duration {
        self.total
    }

    /// The longest time.
    pub fn longest(&self) -> Duration {
        self.longest
    }

    /// Upper bound of a quantile: the fraction `quantile` in [0, 1] of all times is at most this long.
    pub fn quantile(&self, quantile: f64) -> Duration {
        let wanted = (quantile.clamp(0.0, 1.0) * self.count() as f64).ceil() as u64;
        let mut seen = 0;
        for (bin, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= wanted && seen > 0 {
                return upper_bound(bin).min(self.longest);
            }
        }
        self.longest
    }

    /// Upper bound and count of every bin that is not empty, in ascending order.
    pub fn bins(&self) -> impl Iterator<Item = (Duration, u64)> + '_ {
        let filled = self.counts.iter().enumerate().filter(|(_, count)| **count > 0);
        filled.map(|(bin, count)| (upper_bound(bin), *count))
    }
}

fn upper_bound(bin: usize) -> Duration {
    Duration::from_secs_f64(1e-6 * (bin as f64 / BINS_PER_DOUBLING).exp2())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_upper_bounds_within_a_bin() {
        let mut histogram = LatencyHistogram::default();
        for milliseconds in 1..=100 {
            histogram.add(Duration::from_millis(milliseconds));
        }
        for (quantile, exact) in [(0.5, 0.050), (0.99, 0.099), (1.0, 0.100)] {
            let found = histogram.quantile(quantile).as_secs_f64();
            assert!(found >= exact && found <= exact * 1.0906, "{quantile}: {found}");
        }
        assert_eq!(histogram.count(), 100);
        assert_eq!(histogram.longest(), Duration::from_millis(100));
        assert_eq!(histogram.bins().map(|(_, n)| n).sum::<u64>(), 100);
    }

    #[test]
    fn empty_histograms_and_extreme_values_are_handled() {
        let mut histogram = LatencyHistogram::default();
        assert_eq!(histogram.quantile(0.99), Duration::ZERO);
        histogram.add(Duration::ZERO);
        histogram.add(Duration::from_secs(100_000));
        assert_eq!(histogram.count(), 2);
        let mut twice = histogram.clone();
        twice.merge(&histogram);
        assert_eq!(twice.count(), 4);
    }
}
