//! Estimates by how much local SLAM drifts more than usual, from the innovations of the filter: distances of
//! matches from their predictions (covariance matching; Mehra 1972, Myers and Tapley 1976).

use crate::belief::Freedom;
use crate::settings::tracking::{INNOVATIONS, LARGEST_DRIFT_SCALE};

/// Factor on the variance of the drift of local SLAM.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DriftScale {
    factor: f64,
    /// Squared Mahalanobis distances since the factor was changed last.
    squared_distances: [f64; INNOVATIONS],
    count: usize,
}

impl Default for DriftScale {
    fn default() -> Self {
        Self { factor: 1.0, squared_distances: [0.0; INNOVATIONS], count: 0 }
    }
}

impl DriftScale {
    /// The factor, at least 1.
    pub fn factor(&self) -> f64 {
        self.factor
    }

    /// Adds the squared Mahalanobis distance of a match, be it accepted or not. Single wrong matches have no
    /// effect: the median of several is compared with that of the χ² distribution.
    pub fn add(&mut self, squared_distance: f64, freedom: Freedom) {
        if squared_distance.is_nan() {
            return;
        }
        if let Some(free) = self.squared_distances.get_mut(self.count) {
            *free = squared_distance;
            self.count += 1;
        }
        if self.count < INNOVATIONS {
            return;
        }
        self.count = 0;
        self.squared_distances.sort_by(f64::total_cmp);
        let median = self.squared_distances.get(INNOVATIONS / 2).copied().unwrap_or_default();
        self.factor = (self.factor * median / median_of_chi_squared(freedom)).clamp(1.0, LARGEST_DRIFT_SCALE);
    }
}

/// Median of the χ² distribution with as many degrees of freedom as the scanner has.
fn median_of_chi_squared(freedom: Freedom) -> f64 {
    match freedom {
        Freedom::TwoD => 2.366,
        Freedom::ThreeD => 5.348,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn factor_after(squared_distances: &[f64]) -> f64 {
        let mut scale = DriftScale::default();
        squared_distances.iter().for_each(|d| scale.add(*d, Freedom::TwoD));
        scale.factor()
    }

    #[test]
    fn large_innovations_raise_the_drift_and_single_ones_do_not() {
        assert!((factor_after(&[1.0; 50]) - 1.0).abs() < 1e-9);
        assert!((factor_after(&[0.5, 400.0, 1.0, f64::INFINITY, 2.0]) - 1.0).abs() < 1e-9);
        assert!((factor_after(&[23.66; 5]) - 10.0).abs() < 1e-9);
        assert!((factor_after(&[f64::INFINITY; 5]) - LARGEST_DRIFT_SCALE).abs() < 1e-9);
        let mut and_then_small = vec![23.66; 5];
        and_then_small.extend([0.2366; 5]);
        assert!((factor_after(&and_then_small) - 1.0).abs() < 1e-9);
    }
}
