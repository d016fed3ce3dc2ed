//! Whether a turn takes less time than passes between clouds.
//!
//! A recording may hold every other cloud of a lidar, or one in three: to save space, or because its topic was throttled. Clouds
//! without times do not say so. If all of the motion of a turn is in the points, and it is a half or a third of that
//! between clouds, so long is the turn.

use super::{Skew, SkewFactor};

/// One cloud in so many is there.
const ONE_IN: [f64; 2] = [2.0, 3.0];
/// Lidars turn up to 20 times a second, give or take.
const FASTEST_HZ: f64 = 21.0;
/// One step along the secant is off by some such share of the factor, whatever its standard deviation says: factors of raw drives
/// are 0.77 to 1.15.
const SECANT_ERROR: f64 = 0.15;
/// Squared standard deviations that two factors are likely to be off by at most …
const LIKELY: f64 = 12.0;
/// … and by how much more they must be off from 0 and from 1.
const MARGIN: f64 = 6.0;

/// One cloud in how many there is, if these come each `interval` seconds and it is not each, as their factors in units of the motion between
/// clouds tell.
pub(super) fn one_cloud_in(skew: &Skew, interval: f64) -> Option<f64> {
    let factors = [skew.translation, skew.rotation];
    let misfit = |expected: f64| -> f64 {
        let known = factors.iter().filter(|f: &&SkewFactor| f.sigma.is_finite());
        known.map(|f| ((f.factor - expected) / f.sigma.hypot(SECANT_ERROR * expected)).powi(2)).sum()
    };
    let possible = ONE_IN.into_iter().filter(|one_in| *one_in <= FASTEST_HZ * interval);
    let (one_in, least) =
        possible.map(|one_in| (one_in, misfit(one_in.recip()))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    (least < LIKELY && misfit(0.0).min(misfit(1.0)) > least + MARGIN).then_some(one_in)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(interval: f64, translation: (f64, f64), rotation: (f64, f64)) -> Option<f64> {
        let factor =
            |(factor, sigma): (f64, f64)| SkewFactor { factor, sigma, at_most: factor + 2.5 * sigma };
        let skew = Skew {
            translation: factor(translation),
            rotation: factor(rotation),
            begin_radians: 0.0,
            is_clockwise: true,
            turn_in_intervals: 1.0,
            is_contradicted: false,
            elevation: None,
        };
        one_cloud_in(&skew, interval)
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
