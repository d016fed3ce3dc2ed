//! Thins a stream to a fixed fraction.

use thiserror::Error;

/// A ratio outside [0, 1].
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("sampling ratio {0} is not within [0, 1]: choose the share of data to keep")]
pub struct InvalidRatio(pub f64);

/// Keeps a fixed fraction of the pulses, evenly spread. The first pulse is kept unless the ratio is zero
/// (`spec/options.md`).
#[derive(Clone, Debug)]
pub struct FixedRatioSampler {
    ratio: f64,
    pulses: u64,
    samples: u64,
}

impl FixedRatioSampler {
    /// A sampler that keeps `ratio` of all pulses, 0 (none) to 1 (all).
    ///
    /// # Errors
    /// If the ratio is outside this range.
    pub fn new(ratio: f64) -> Result<Self, InvalidRatio> {
        if !(0.0..=1.0).contains(&ratio) {
            return Err(InvalidRatio(ratio));
        }
        Ok(Self { ratio, pulses: 0, samples: 0 })
    }

    /// Counts one pulse and returns whether to keep it.
    pub fn pulse(&mut self) -> bool {
        self.pulses += 1;
        let keep = self.samples as f64 / (self.pulses as f64) < self.ratio;
        self.samples += u64::from(keep);
        keep
    }

    /// Number of pulses.
    pub fn pulses(&self) -> u64 {
        self.pulses
    }

    /// Number of pulses that were kept.
    pub fn samples(&self) -> u64 {
        self.samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(ratio: f64, pulses: usize) -> Vec<bool> {
        let mut sampler = FixedRatioSampler::new(ratio).unwrap();
        (0..pulses).map(|_| sampler.pulse()).collect()
    }

    #[test]
    fn keeps_the_given_fraction() {
        assert!(kept(1.0, 100).iter().all(|k| *k));
        assert!(kept(0.0, 100).iter().all(|k| !*k));
        assert!(kept(0.5, 100).iter().enumerate().all(|(i, k)| *k == (i % 2 == 0)));
        assert!(kept(1e-20, 100).iter().enumerate().all(|(i, k)| *k == (i == 0)));
    }

    #[test]
    fn ratios_beyond_a_share_are_refused() {
        for ratio in [2.0, -0.1, f64::NAN] {
            assert!(FixedRatioSampler::new(ratio).unwrap_err().to_string().contains("ratio"));
        }
    }
}
