//! Estimates how much larger errors are than assumed.

/// Ratio of the actual variance of an error to its assumed variance, estimated from innovations: the
/// differences of measurements from predictions. If the assumption is right, innovations have the covariance
/// of the prediction (plus that of the measurement, where it matters). Otherwise they differ from it by a
/// factor (covariance matching: Mehra 1972, "Approaches to adaptive filtering", IEEE Transactions on
/// Automatic Control 17(5)).
///
/// `s` is the squared innovation per degree of freedom in units of the assumed variance; its expectation is
/// the factor `λ`. `m` is the memory: the number of innovations over which they are forgotten exponentially.
///
/// ```text
/// λ ← λ + (min(s, k² λ) − λ) / m
/// ```
///
/// An innovation is limited to `k` = 4 standard deviations as estimated so far: a single outlier has little
/// effect, and several in a row are not outliers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CovarianceMatching {
    factor: f64,
    memory: f64,
    bounds: (f64, f64),
}

/// Limit of an innovation, in estimated standard deviations.
const LARGEST_SIGMAS: f64 = 4.0;

impl CovarianceMatching {
    /// Starts with a factor of 1: errors as assumed. `memory` is the approximate number of innovations that
    /// changes the factor.
    pub const fn new(memory: f64) -> Self {
        Self { factor: 1.0, memory, bounds: (0.0, f64::INFINITY) }
    }

    /// Starts with this factor of the variance instead of 1.
    #[must_use]
    pub const fn starting_at(self, factor: f64) -> Self {
        Self { factor, ..self }
    }

    /// Limits the factor to these bounds.
    pub const fn within(self, least: f64, most: f64) -> Self {
        Self { bounds: (least, most), ..self }
    }

    /// Sets the factor to its upper bound: the measurements are of no use.
    pub fn distrust(&mut self) {
        self.factor = self.bounds.1;
    }

    /// Ratio of the estimated to the assumed variance.
    pub const fn variance_factor(&self) -> f64 {
        self.factor
    }

    /// Ratio of the estimated to the assumed standard deviation.
    pub fn sigma_factor(&self) -> f64 {
        self.factor.sqrt()
    }

    /// Adds a squared innovation per degree of freedom, in units of the assumed variance.
    pub fn add(&mut self, squared: f64) {
        let most = LARGEST_SIGMAS * LARGEST_SIGMAS * self.factor;
        let learned = self.factor + (squared.min(most) - self.factor) / self.memory;
        self.factor = learned.clamp(self.bounds.0, self.bounds.1);
    }

    /// Adds a squared innovation per degree of freedom, in units of the variance as estimated so far.
    pub fn add_relative(&mut self, squared: f64) {
        self.add(squared * self.factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SplitMix64;

    /// A normal variate: the sum of twelve uniform ones.
    fn normal(random: &mut SplitMix64) -> f64 {
        (0..12).map(|_| random.uniform()).sum::<f64>() - 6.0
    }

    #[test]
    fn the_variance_of_innovations_is_found() {
        for sigma in [0.3_f64, 1.0, 5.0] {
            let (mut matching, mut random) = (CovarianceMatching::new(200.0), SplitMix64::new(1));
            (0..5000).for_each(|_| matching.add((sigma * normal(&mut random)).powi(2)));
            let found = matching.sigma_factor() / sigma;
            assert!((found - 1.0).abs() < 0.07, "{sigma}: {found}");
        }
    }

    #[test]
    fn one_outlier_has_little_effect_and_several_increase_the_variance() {
        let mut matching = CovarianceMatching::new(20.0);
        matching.add(1e6);
        assert_eq!(matching.variance_factor(), 1.0 + 15.0 / 20.0);
        (0..20).for_each(|_| matching.add(100.0));
        assert!(matching.variance_factor() > 60.0, "{matching:?}");
    }

    #[test]
    fn relative_innovations_are_those_of_a_filter_that_knows_the_factor() {
        let (mut absolute, mut relative) = (CovarianceMatching::new(20.0), CovarianceMatching::new(20.0));
        for squared in [4.0, 9.0, 1.0, 25.0] {
            relative.add_relative(squared / relative.variance_factor());
            absolute.add(squared);
            assert!((absolute.variance_factor() - relative.variance_factor()).abs() < 1e-12);
        }
    }

    #[test]
    fn the_factor_is_within_its_bounds() {
        let mut matching = CovarianceMatching::new(2.0).within(1.0, 10.0);
        (0..9).for_each(|_| matching.add(0.0));
        assert_eq!(matching.variance_factor(), 1.0);
        (0..9).for_each(|_| matching.add(1e9));
        assert_eq!(matching.variance_factor(), 10.0);
        (0..9).for_each(|_| matching.add(0.0));
        matching.distrust();
        assert_eq!(matching.variance_factor(), 10.0);
    }
}
