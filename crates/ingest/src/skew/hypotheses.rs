//! What factors that are neither 0 nor 1 mean: a turn takes less time than passes between clouds, or times of points are wrong by a factor.
//!
//! A recording may hold every other cloud of a lidar, or one in three: to save space, or because its topic was throttled. Clouds
//! without times do not say so. If all of the motion of a turn is in the points, and it is a half or a third of that
//! between clouds, so long is the turn. Times of points may count backwards, as the age of points at the end of the sweep, or be made for
//! another rate of revolution.

use super::{Skew, SkewFactor};

/// One cloud in so many is there.
const ONE_IN: [f64; 2] = [2.0, 3.0];
/// What times of points may be wrong by: they are ages; for 20 instead of 10 turns a second; the other way round.
const TIME_SCALES: [f64; 3] = [-1.0, 2.0, 0.5];
/// Lidars turn up to 20 times a second, give or take.
const FASTEST_HZ: f64 = 21.0;
/// One step along the secant is off by some such share of the factor, whatever its standard deviation says: factors of raw drives
/// are 0.77 to 1.15.
const SECANT_ERROR: f64 = 0.15;
/// Squared standard deviations that two factors are likely to be off by at most …
const LIKELY: f64 = 12.0;
/// … and by how much more they must be off from 0 and from 1.
const MARGIN: f64 = 6.0;
/// By so much more where nothing but the factors tells.
const CLEAR_MARGIN: f64 = 16.0;

/// One cloud in how many there is, if these come each `interval` seconds and it is not each, as their factors in units of the motion between
/// clouds tell.
pub(super) fn one_cloud_in(skew: &Skew, interval: f64) -> Option<f64> {
    let possible = ONE_IN.into_iter().filter(|one_in| *one_in <= FASTEST_HZ * interval);
    told(skew, possible.map(f64::recip), MARGIN).map(f64::recip)
}

/// What the times of points are to be multiplied with, as factors in units of the motion during the time that they span tell; none if they
/// are right, the motion was taken out, or that is not known.
pub(super) fn scale_of_times(skew: &Skew) -> Option<f64> {
    let is_known = skew.translation.sigma.is_finite() && skew.rotation.sigma.is_finite();
    told(skew, TIME_SCALES.into_iter(), CLEAR_MARGIN).filter(|_| is_known)
}

/// Which of these both factors are, if neither 0 nor 1 is likely.
fn told(skew: &Skew, expected: impl Iterator<Item = f64>, margin: f64) -> Option<f64> {
    let factors = [skew.translation, skew.rotation];
    let misfit = |expected: f64| -> f64 {
        let known = factors.iter().filter(|f: &&SkewFactor| f.sigma.is_finite());
        known.map(|f| ((f.factor - expected) / f.sigma.hypot(SECANT_ERROR * expected)).powi(2)).sum()
    };
    let (found, least) =
        expected.map(|factor| (factor, misfit(factor))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    (least < LIKELY && misfit(0.0).min(misfit(1.0)) > least + margin).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn skew(translation: (f64, f64), rotation: (f64, f64)) -> Skew {
        let factor =
            |(factor, sigma): (f64, f64)| SkewFactor { factor, sigma, at_most: factor + 2.5 * sigma };
        Skew {
            translation: factor(translation),
            rotation: factor(rotation),
            begin_radians: 0.0,
            is_clockwise: true,
            turn_in_intervals: 1.0,
            is_contradicted: false,
            elevation: None,
        }
    }

    fn told(interval: f64, translation: (f64, f64), rotation: (f64, f64)) -> Option<f64> {
        one_cloud_in(&skew(translation, rotation), interval)
    }

    #[test]
    fn times_that_are_wrong_by_a_factor_are_told() {
        let unknown = (7.0, f64::INFINITY);
        for (translation, rotation, expected) in [
            ((-1.03, 0.35), (-1.1, 0.17), Some(-1.0)),
            ((1.9, 0.15), (2.1, 0.2), Some(2.0)),
            ((0.16, 0.28), (0.45, 0.15), None),
            ((0.41, 0.12), (0.47, 0.07), Some(0.5)),
            ((0.77, 0.12), (1.01, 0.03), None),
            ((-0.1, 0.1), (0.02, 0.02), None),
            ((-0.6, 0.5), unknown, None),
            // Rotation was taken out, translation was not.
            ((1.0, 0.1), (0.0, 0.1), None),
        ] {
            assert_eq!(
                scale_of_times(&skew(translation, rotation)),
                expected,
                "{translation:?} {rotation:?}"
            );
        }
    }

    #[test]
    fn a_half_and_a_third_are_told_from_all_and_from_nothing() {
        let unknown = (7.0, f64::INFINITY);
        assert_eq!(told(0.2, (0.41, 0.09), (0.45, 0.09)), Some(2.0));
        assert_eq!(told(0.2, unknown, (0.35, 0.04)), Some(3.0));
        assert_eq!(told(0.1, (0.97, 0.1), (1.01, 0.03)), None);
        assert_eq!(told(0.1, (0.02, 0.05), unknown), None);
        // Rotation was taken out, translation was not.
        assert_eq!(told(0.2, (1.0, 0.05), (0.0, 0.05)), None);
        // Anything fits.
        assert_eq!(told(0.2, (0.5, 0.3), unknown), None);
        assert_eq!(told(0.2, unknown, unknown), None);
    }

    #[test]
    fn no_lidar_turns_thirty_times_a_second() {
        let third = (0.33, 0.02);
        assert_ne!(told(0.1, third, third), Some(3.0));
        assert_eq!(told(0.1, (0.5, 0.03), (0.5, 0.03)), Some(2.0));
        assert_eq!(told(f64::NAN, third, third), None);
    }
}
