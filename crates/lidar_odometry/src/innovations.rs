//! How far constant rotation is off, learned from how sweeps were registered.
//!
//! The prior of a segment is wide enough for a lidar that is swung about. On a vehicle it is too wide: errors of the
//! sensor that repeat in every turn are then taken for motion during the sweep, and bend the trajectory by what of them is
//! carried on from sweep to sweep.

use portolan_numeric::CovarianceMatching;

use crate::segment::SegmentCorrection;

/// About so many sweeps are remembered.
const MEMORY: f64 = 20.0;
/// Innovations are those of the ends of segments; as much is allowed for within one, and so many times more.
const MARGIN: f64 = 2.0;
/// What was learned counts for no less than this fraction of the prior.
const LEAST: f64 = 0.03;

/// What innovations of rotation about one axis say of the prior.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Innovations {
    rotation: CovarianceMatching,
}

impl Default for Innovations {
    fn default() -> Self {
        Self { rotation: CovarianceMatching::new(MEMORY) }
    }
}

impl Innovations {
    /// By what fraction the standard deviation of the prior is to be multiplied.
    pub fn fraction(&self) -> f64 {
        (MARGIN * self.rotation.sigma_factor()).clamp(LEAST, 1.0)
    }

    /// Takes what registration added to a rotation that nothing measured, with the prior's standard deviation, radians.
    pub fn add(&mut self, correction: &SegmentCorrection, sigma: f64) {
        let sigmas = correction.end().fixed_rows::<3>(3).norm() / sigma;
        // Three axes share the length.
        self.rotation.add(sigmas.powi(2) / 3.0);
    }
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
    fn a_smooth_drive_narrows_the_prior_and_a_jolt_opens_it() {
        let mut innovations = Innovations::default();
        assert_eq!(innovations.fraction(), 1.0);
        (0..200).for_each(|_| innovations.add(&correction(0.002), 0.05));
        let smooth = innovations.fraction();
        assert!((smooth - MARGIN * 0.002 / 0.05 / 3f64.sqrt()).abs() < 0.002, "{smooth}");
        let sweeps = (0..40).take_while(|_| {
            innovations.add(&correction(0.05), 0.05);
            innovations.fraction() < 0.5
        });
        assert!(sweeps.count() < 10);
    }

    #[test]
    fn what_repeats_within_sweeps_and_not_from_sweep_to_sweep_is_no_innovation() {
        let mut innovations = Innovations::default();
        let SegmentCorrection { growth, .. } = correction(0.01);
        (0..200).for_each(|_| {
            innovations.add(&SegmentCorrection { start: -growth, growth }, 0.05);
        });
        assert_eq!(innovations.fraction(), LEAST);
    }
}
