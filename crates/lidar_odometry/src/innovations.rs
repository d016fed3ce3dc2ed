//! Learns the errors of predicted rotations, constant ones and those of a gyroscope, from registered
//! sweeps.
//!
//! The prior of constant rotation is wide enough for a swinging lidar. On a vehicle it is too wide: sensor
//! errors that repeat in every revolution are then taken for motion during the sweep, and bend the
//! trajectory by the part of them that is carried on from sweep to sweep. The prior of a gyroscope is its
//! own error; it is too narrow where time stamps jitter, its clock is off or its mounting flexes.

use portolan_numeric::CovarianceMatching;

use crate::segment::SegmentCorrection;
use crate::settings::constants::innovations::{
    LEAST_FRACTION, MARGIN_FACTOR, MEMORY_SWEEPS, REGISTERED_SIGMA,
};

/// Innovations of rotation, by which priors are scaled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Innovations {
    constant: CovarianceMatching,
    measured: CovarianceMatching,
}

impl Default for Innovations {
    fn default() -> Self {
        let as_assumed = MARGIN_FACTOR.powi(-2);
        let measured =
            CovarianceMatching::new(MEMORY_SWEEPS).starting_at(as_assumed).within(as_assumed, f64::INFINITY);
        Self { constant: CovarianceMatching::new(MEMORY_SWEEPS), measured }
    }
}

impl Innovations {
    /// Factor of the standard deviation of the prior of constant rotation, at most 1.
    pub fn of_constant(&self) -> f64 {
        (MARGIN_FACTOR * self.constant.sigma_factor()).clamp(LEAST_FRACTION, 1.0)
    }

    /// Factor of the assumed error of a gyroscope's rotations.
    pub fn of_measured(&self) -> f64 {
        MARGIN_FACTOR * self.measured.sigma_factor()
    }

    /// Adds the correction of an unmeasured rotation by registration, with the standard deviation of the
    /// prior, radians.
    pub fn add_constant(&mut self, correction: &SegmentCorrection, sigma: f64) {
        self.constant.add(squared(correction, sigma));
    }

    /// Adds the correction of a rotation by a gyroscope, with its assumed standard deviation, radians.
    pub fn add_measured(&mut self, correction: &SegmentCorrection, sigma: f64) {
        self.measured.add(squared(correction, sigma.hypot(REGISTERED_SIGMA)));
    }
}

/// The squared normalised innovation, divided by the three axes.
fn squared(correction: &SegmentCorrection, sigma: f64) -> f64 {
    let sigmas = correction.end().fixed_rows::<3>(3).norm() / sigma;
    sigmas.powi(2) / 3.0
}

#[cfg(test)]
mod tests {
    use nalgebra as na;

    use super::*;

    fn correction(radians: f64) -> SegmentCorrection {
        let growth = na::Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, radians);
        SegmentCorrection { growth, ..SegmentCorrection::default() }
    }

    #[test]
    fn a_smooth_drive_narrows_the_prior_and_a_jolt_widens_it() {
        let mut innovations = Innovations::default();
        assert_eq!(innovations.of_constant(), 1.0);
        (0..200).for_each(|_| innovations.add_constant(&correction(0.002), 0.05));
        let smooth = innovations.of_constant();
        assert!((smooth - MARGIN_FACTOR * 0.002 / 0.05 / 3f64.sqrt()).abs() < 0.002, "{smooth}");
        let sweeps = (0..40).take_while(|_| {
            innovations.add_constant(&correction(0.05), 0.05);
            innovations.of_constant() < 0.5
        });
        assert!(sweeps.count() < 10);
    }

    #[test]
    fn the_prior_of_a_gyroscope_widens_with_its_innovations() {
        let mut innovations = Innovations::default();
        assert_eq!(innovations.of_measured(), 1.0);
        (0..20).for_each(|_| innovations.add_measured(&correction(0.0002), 0.0005));
        assert_eq!(innovations.of_measured(), 1.0);
        (0..10).for_each(|_| innovations.add_measured(&correction(0.02), 0.0005));
        assert!(innovations.of_measured() > 10.0, "{}", innovations.of_measured());
    }

    #[test]
    fn corrections_that_cancel_within_a_sweep_are_no_innovations() {
        let mut innovations = Innovations::default();
        let SegmentCorrection { growth, .. } = correction(0.01);
        (0..200).for_each(|_| {
            innovations.add_constant(&SegmentCorrection { start: -growth, growth }, 0.05);
        });
        assert_eq!(innovations.of_constant(), LEAST_FRACTION);
    }
}
