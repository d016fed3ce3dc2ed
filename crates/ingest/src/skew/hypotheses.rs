//! Explains skew factors that are neither 0 nor 1: a turn takes less time than the interval between clouds,
//! or the times of points are wrong by a factor.
//!
//! A recording may hold only every second or third cloud of a lidar: to save space, or because its topic was
//! throttled. Clouds without times do not show it directly. If all of the motion of a turn is in the points,
//! and it is a half or a third of the motion between clouds, then a turn takes a half or a third of the
//! interval. Times of points may count backwards, as the age of points at the end of the sweep, or be made
//! for another rate of revolution. Or they belong to other points: of another lidar, of a turn that begins
//! elsewhere, or shuffled. For a spinning lidar the azimuth gives the times of its points as well.

use super::{Skew, SkewFactor};
use crate::azimuth_time::Turn;

/// Ratios of clouds measured to clouds recorded that are tried.
const ONE_IN: [f64; 2] = [2.0, 3.0];
/// Factors by which times of points may have to be multiplied: they are ages (−1); they were made for 20
/// instead of 10 turns a second (2); the reverse (0.5).
const TIME_SCALES: [f64; 3] = [-1.0, 2.0, 0.5];
/// Upper limit of the rate of lidars, turns per second: 20, with some tolerance.
const FASTEST_HZ: f64 = 21.0;
/// Relative error of a factor from one secant step, beside its standard deviation: factors of raw drives are
/// 0.77 to 1.15.
const SECANT_ERROR: f64 = 0.15;
/// Misfit of the two factors, in squared standard deviations, up to which a hypothesis is likely.
const LIKELY: f64 = 12.0;
/// Minimum by which the misfits of 0 and of 1 must exceed that of the accepted hypothesis, squared standard
/// deviations.
const MARGIN: f64 = 6.0;
/// The same where only the factors decide, or where the recorded times already span one turn.
const CLEAR_MARGIN: f64 = 16.0;
/// Tolerance within which times span a whole turn, as a fraction of the turn.
const WHOLE_TURN: f64 = 0.1;
/// Number of standard deviations by which sweeps must fit better with other times for the recorded ones to be
/// rejected.
const CONTRADICTED: f64 = 2.5;

/// Ratio of clouds measured to clouds recorded, if clouds are missing. It follows from the factors, in units
/// of the motion between clouds; `interval` is the time between clouds, seconds.
pub(super) fn one_cloud_in(skew: &Skew, interval: f64) -> Option<f64> {
    let possible = ONE_IN.into_iter().filter(|one_in| *one_in <= FASTEST_HZ * interval);
    common_factor(skew, possible.map(f64::recip), MARGIN).map(f64::recip)
}

/// Factor by which the times of points must be multiplied. It follows from the skew factors, in units of the
/// motion during the time that the times span. None if the times are right, the clouds were de-skewed, or the
/// factors are unknown.
pub(super) fn scale_of_times(skew: &Skew) -> Option<f64> {
    let is_known = skew.translation.sigma.is_finite() && skew.rotation.sigma.is_finite();
    common_factor(skew, TIME_SCALES.into_iter(), CLEAR_MARGIN).filter(|_| is_known)
}

/// The expected value that both factors have, if neither 0 nor 1 is likely.
fn common_factor(skew: &Skew, expected: impl Iterator<Item = f64>, margin: f64) -> Option<f64> {
    let (found, least) =
        expected.map(|factor| (factor, misfit(skew, factor))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    (least < LIKELY && misfit(skew, 0.0).min(misfit(skew, 1.0)) > least + margin).then_some(found)
}

/// Squared standard deviations between an expected value and those factors that are known.
fn misfit(skew: &Skew, expected: f64) -> f64 {
    let factors = [skew.translation, skew.rotation];
    let known = factors.iter().filter(|f: &&SkewFactor| f.sigma.is_finite());
    known.map(|f| ((f.factor - expected) / f.sigma.hypot(SECANT_ERROR * expected)).powi(2)).sum()
}

/// Candidates for the times of points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Times {
    /// The recorded times multiplied by this; 0: they are not to be used.
    Scaled(f64),
    /// The times that follow from the azimuth, for a lidar that turns like this.
    ByAzimuth(Turn),
}

/// Times of points that factors and fits determine together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FittingTimes {
    /// The times.
    pub times: Times,
    /// Whether these times are clearly right. Otherwise it is only clear that the recorded ones are wrong.
    pub is_clear: bool,
}

/// Skew estimated with times by azimuth, where these differ from the recorded ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct AzimuthSkew {
    /// Factors in units of the motion with times by azimuth.
    pub skew: Skew,
    /// Expected value of the factors if the recorded times are right.
    pub slope: f64,
}

impl AzimuthSkew {
    fn times(&self) -> Times {
        Times::ByAzimuth(self.skew.turn())
    }

    /// Squared standard deviations between the factors and those expected for these times.
    fn misfit(&self, times: Times) -> f64 {
        misfit(
            &self.skew,
            match times {
                Times::Scaled(scale) => scale * self.slope,
                Times::ByAzimuth(_) => 1.0,
            },
        )
    }
}

/// Fit of the sweeps for candidate times of points.
pub(super) trait Fits {
    /// By how many standard deviations sweeps fit better with `to` than with `from`.
    fn sigmas_better(&self, from: Times, to: Times) -> f64;

    /// Weighted number of points on surfaces with these times.
    fn explained(&self, times: Times) -> f64;
}

/// Whether times that span the fraction `duty` of the interval between clouds span a whole turn.
pub(super) fn is_whole_turn(duty: f64) -> bool {
    (duty - 1.0).abs() < WHOLE_TURN
}

/// Candidate factors of wrong times that span the fraction `duty` of the interval between clouds. The factor
/// with which they span exactly one interval is included.
fn wrong_scales(duty: f64) -> impl Iterator<Item = f64> {
    let is_new = |whole: &f64| TIME_SCALES.iter().chain(&[1.0]).all(|scale| !is_whole_turn(whole / scale));
    TIME_SCALES.into_iter().chain(Some(duty.recip()).filter(is_new))
}

/// The same, and also times as recorded (1) and times not used (0).
pub(super) fn scales_of_times(duty: f64) -> impl Iterator<Item = f64> {
    wrong_scales(duty).chain([0.0, 1.0])
}

const AS_RECORDED: Times = Times::Scaled(1.0);
const NONE: Times = Times::Scaled(0.0);

/// Times of points that factors and fits determine together; none if nothing contradicts the recorded ones.
/// Factors are in units of the motion during the time that the times span, which is the fraction `duty` of
/// the interval between clouds.
pub(super) fn times_that_fit(
    skew: &Skew,
    duty: f64,
    by_azimuth: Option<AzimuthSkew>,
    fits: &impl Fits,
) -> Option<FittingTimes> {
    // Fits alone do not show that a lidar spins: non-repetitive sweeps hardly show the same surfaces.
    let by_azimuth = by_azimuth.filter(|azimuth_skew| is_known(&azimuth_skew.skew));
    let scaled = clear_scale(skew, duty, fits);
    let turned = by_azimuth.and_then(|azimuth_skew| clear_by_azimuth(&azimuth_skew, scaled, fits));
    if let Some(times) = turned.or(scaled) {
        // If another hypothesis fits better, though not clearly, the question stays open.
        let is_rivalled = by_azimuth.is_some_and(|azimuth_skew| {
            turned.is_none() && fits.sigmas_better(times, azimuth_skew.times()) > 0.0
        });
        if !is_rivalled {
            return Some(FittingTimes { times, is_clear: true });
        }
    }
    let all = || {
        scales_of_times(duty).map(Times::Scaled).chain(by_azimuth.map(|azimuth_skew| azimuth_skew.times()))
    };
    // Where sweeps carry no information on the motion, as non-repetitive ones, equal times of all points fit
    // best, whichever times are right.
    let is_known = is_known(skew);
    let contradicts = |times: Times| {
        fits.sigmas_better(AS_RECORDED, times) > CONTRADICTED
            && (is_known || fits.sigmas_better(NONE, times) > 0.0)
    };
    let is_contradicted = scaled.is_some() || all().any(contradicts);
    let times = all().max_by(|a, b| fits.explained(*a).total_cmp(&fits.explained(*b)))?;
    is_contradicted.then_some(FittingTimes { times, is_clear: false })
}

/// Whether at least one factor is known.
fn is_known(skew: &Skew) -> bool {
    skew.translation.sigma.is_finite() || skew.rotation.sigma.is_finite()
}

/// Factor by which recorded times must be multiplied, if that is clear.
fn clear_scale(skew: &Skew, duty: f64, fits: &impl Fits) -> Option<Times> {
    let evidence = |from: f64, to: f64| {
        let sigmas = fits.sigmas_better(Times::Scaled(from), Times::Scaled(to));
        misfit(skew, from) - misfit(skew, to) + sigmas * sigmas.abs()
    };
    let spans_turn = |scale: f64| is_whole_turn(scale.abs() * duty);
    // A sweep takes the time from one cloud to the next: times with another span are suspect from the start.
    let margin = |scale| if spans_turn(scale) && !spans_turn(1.0) { MARGIN } else { CLEAR_MARGIN };
    let exceeds = |scale: f64| evidence(1.0, scale).min(evidence(0.0, scale)) - margin(scale);
    let likely = wrong_scales(duty).filter(|scale| misfit(skew, *scale) < LIKELY);
    let clear = likely.map(|scale| (exceeds(scale), scale)).max_by(|a, b| a.0.total_cmp(&b.0));
    clear.filter(|(exceeds, _)| *exceeds > 0.0).map(|(_, scale)| Times::Scaled(scale))
}

/// Times by azimuth, if they are clearly right: the recorded times are rejected, and the clock of the sweep
/// then follows from its points.
fn clear_by_azimuth(azimuth_skew: &AzimuthSkew, scaled: Option<Times>, fits: &impl Fits) -> Option<Times> {
    let times = azimuth_skew.times();
    let evidence = |from: Times| {
        let sigmas = fits.sigmas_better(from, times);
        azimuth_skew.misfit(from) - azimuth_skew.misfit(times) + sigmas * sigmas.abs()
    };
    let exceeds = |from: Times| evidence(from) > CLEAR_MARGIN;
    let is_clear = exceeds(AS_RECORDED) && exceeds(NONE) && scaled.is_none_or(exceeds);
    (is_clear && azimuth_skew.misfit(times) < LIKELY).then_some(times)
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

    fn found(interval: f64, translation: (f64, f64), rotation: (f64, f64)) -> Option<f64> {
        one_cloud_in(&skew(translation, rotation), interval)
    }

    #[test]
    fn times_wrong_by_a_factor_are_detected() {
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

    struct Explained(fn(f64) -> f64, f64);

    impl Fits for Explained {
        fn sigmas_better(&self, from: Times, to: Times) -> f64 {
            (self.explained(to) - self.explained(from)) / self.1
        }

        fn explained(&self, times: Times) -> f64 {
            match times {
                Times::Scaled(scale) => self.0(scale),
                Times::ByAzimuth(_) => BY_AZIMUTH,
            }
        }
    }

    /// Fit of the sweeps with times by azimuth.
    const BY_AZIMUTH: f64 = 1.0;

    #[test]
    fn fits_decide_where_factors_are_not_clear() {
        let unknown = (-0.8, f64::INFINITY);
        let found = |translation, rotation, duty, fit, error| {
            times_that_fit(&skew(translation, rotation), duty, None, &Explained(fit, error)).map(|found| {
                let Times::Scaled(scale) = found.times else { panic!("{found:?}") };
                (scale, found.is_clear)
            })
        };
        let right: fn(f64) -> f64 = |s| -(s - 1.0).abs();
        let back: fn(f64) -> f64 = |s| -(s + 1.0).abs();
        let double: fn(f64) -> f64 = |s| -(s - 2.0).abs();
        let zero: fn(f64) -> f64 = |_| 0.0;
        // Factors are unknown: fits determine the times, or only that they are wrong, or nothing.
        assert_eq!(found(unknown, unknown, 1.0, back, 0.2), Some((-1.0, true)));
        assert_eq!(found(unknown, unknown, 1.0, back, 0.7), Some((-1.0, false)));
        assert_eq!(found(unknown, unknown, 1.0, back, 1.0), None);
        assert_eq!(found(unknown, unknown, 1.0, right, 0.2), None);
        let none: fn(f64) -> f64 = |s| -s.abs();
        assert_eq!(found(unknown, unknown, 1.0, none, 0.2), None);
        assert_eq!(found((0.3, 0.4), unknown, 1.0, none, 0.3), Some((0.0, false)));
        // Sweeps of half of the interval between clouds: their factors alone are not conclusive, and the fits
        // do not decide.
        let factors = ((1.58, 0.21), (1.64, 0.25));
        assert_eq!(found(factors.0, factors.1, 0.5, zero, 1.0), Some((2.0, true)));
        assert_eq!(found(factors.0, factors.1, 1.0, zero, 1.0), None);
        assert_eq!(found(factors.0, factors.1, 1.0, double, 0.3), Some((2.0, true)));
        assert_eq!(found(factors.0, factors.1, 0.5, right, 0.2), None);
    }

    #[test]
    fn times_by_azimuth_must_fit_better_than_all_others() {
        let unknown = (7.0, f64::INFINITY);
        let found = |by_azimuth, slope, fit, error| {
            let azimuth_skew = AzimuthSkew { skew: skew(by_azimuth, unknown), slope };
            times_that_fit(&skew((0.1, 0.2), (0.0, 0.2)), 1.0, Some(azimuth_skew), &Explained(fit, error))
        };
        let by_azimuth = |is_clear| {
            let times = Times::ByAzimuth(skew(unknown, unknown).turn());
            Some(FittingTimes { times, is_clear })
        };
        let none: fn(f64) -> f64 = |s| -s.abs();
        // Factors alone, where fits agree; both together; neither. Fits alone do not show that a lidar spins.
        assert_eq!(found((1.0, 0.1), -0.5, none, 1.0), by_azimuth(true));
        assert_eq!(found(unknown, 0.0, none, 0.2), Some(FittingTimes { times: NONE, is_clear: false }));
        assert_eq!(found((0.9, 0.3), 0.0, none, 0.3), by_azimuth(true));
        assert_eq!(found((0.9, 0.3), 0.0, none, 0.7), by_azimuth(false));
        assert_eq!(found((0.9, 0.4), 0.0, none, 1.0), None);
        // Points move according to the recorded times.
        assert_eq!(found((0.5, 0.1), 0.5, |s| 1.0 - (s - 1.0).abs(), 1.0), None);
    }

    #[test]
    fn skew_factors_of_a_half_and_a_third_are_distinguished_from_one_and_zero() {
        let unknown = (7.0, f64::INFINITY);
        assert_eq!(found(0.2, (0.41, 0.09), (0.45, 0.09)), Some(2.0));
        assert_eq!(found(0.2, unknown, (0.35, 0.04)), Some(3.0));
        assert_eq!(found(0.1, (0.97, 0.1), (1.01, 0.03)), None);
        assert_eq!(found(0.1, (0.02, 0.05), unknown), None);
        // Rotation was taken out, translation was not.
        assert_eq!(found(0.2, (1.0, 0.05), (0.0, 0.05)), None);
        // Anything fits.
        assert_eq!(found(0.2, (0.5, 0.3), unknown), None);
        assert_eq!(found(0.2, unknown, unknown), None);
    }

    #[test]
    fn no_lidar_turns_thirty_times_a_second() {
        let third = (0.33, 0.02);
        assert_ne!(found(0.1, third, third), Some(3.0));
        assert_eq!(found(0.1, (0.5, 0.03), (0.5, 0.03)), Some(2.0));
        assert_eq!(found(f64::NAN, third, third), None);
    }
}
