//! How much larger errors are than they are assumed to be.

/// The factor by which the variance of an error differs from what is assumed of it, learned from innovations: what
/// measurements add to predictions. Innovations have the covariance of the prediction (and of the measurement, where
/// that counts), or else the assumption is wrong by a factor (covariance matching: Mehra 1972, "Approaches to adaptive
/// filtering", IEEE Transactions on Automatic Control 17(5)).
///
/// With the squared innovation `s`, for each degree of freedom and in units of the assumed variance, whose expectation is
/// the factor `λ`, and the memory `m`, in innovations, which are forgotten exponentially:
///
/// ```text
/// λ ← λ + (min(s, k² λ) − λ) / m
/// ```
///
/// One innovation counts as at most `k` = 4 standard deviations of what was learned so far: a single outlier says little,
/// and a few in a row are no outliers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CovarianceMatching {
    factor: f64,
    memory: f64,
    bounds: (f64, f64),
}

/// An innovation counts as at most so many standard deviations.
const LARGEST_SIGMAS: f64 = 4.0;

impl CovarianceMatching {
    /// Errors are as assumed until about so many innovations say something else.
    pub const fn new(memory: f64) -> Self {
        Self { factor: 1.0, memory, bounds: (0.0, f64::INFINITY) }
    }

    /// Errors are believed to have so many times the variance that is assumed, until innovations say something else.
    #[must_use]
    pub const fn starting_at(self, factor: f64) -> Self {
        Self { factor, ..self }
    }

    /// The factor does not leave these bounds.
    pub const fn within(self, least: f64, most: f64) -> Self {
        Self { bounds: (least, most), ..self }
    }

    /// The variance is as many times what is assumed as the bounds allow: the measurements are of no use.
    pub fn distrust(&mut self) {
        self.factor = self.bounds.1;
    }

    /// How many times the variance is what is assumed.
    pub const fn variance_factor(&self) -> f64 {
        self.factor
    }

    /// How many times the standard deviation is what is assumed.
    pub fn sigma_factor(&self) -> f64 {
        self.factor.sqrt()
    }

    /// Takes a squared innovation for each degree of freedom, in units of the variance that is assumed.
    pub fn add(&mut self, squared: f64) {
        let most = LARGEST_SIGMAS * LARGEST_SIGMAS * self.factor;
        let learned = self.factor + (squared.min(most) - self.factor) / self.memory;
        self.factor = learned.clamp(self.bounds.0, self.bounds.1);
    }

    /// Takes one in units of the variance as it was learned so far.
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
    fn one_outlier_says_little_and_several_say_that_they_are_none() {
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
    fn it_stays_within_its_bounds() {
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
