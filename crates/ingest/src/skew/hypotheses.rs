//! What factors that are neither 0 nor 1 mean: a turn takes less time than passes between clouds, or times of points are wrong by a factor.
//!
//! A recording may hold every other cloud of a lidar, or one in three: to save space, or because its topic was throttled. Clouds
//! without times do not say so. If all of the motion of a turn is in the points, and it is a half or a third of that
//! between clouds, so long is the turn. Times of points may count backwards, as the age of points at the end of the sweep, or be made for
//! another rate of revolution. Or they are those of other points: of another lidar, of a turn that begins elsewhere, shuffled. Where a lidar
//! spins the azimuth tells the times of its points, too.

use super::{Skew, SkewFactor};
use crate::azimuth_time::Turn;

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
/// By so much more where nothing but the factors tells, or times span one turn as they are.
const CLEAR_MARGIN: f64 = 16.0;
/// Times span a whole turn if it is one but for such a part.
const WHOLE_TURN: f64 = 0.1;
/// Times are contradicted if sweeps fit better with others by so many standard deviations.
const CONTRADICTED: f64 = 2.5;

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
    let (found, least) =
        expected.map(|factor| (factor, misfit(skew, factor))).min_by(|a, b| a.1.total_cmp(&b.1))?;
    (least < LIKELY && misfit(skew, 0.0).min(misfit(skew, 1.0)) > least + margin).then_some(found)
}

/// Squared standard deviations that those factors that are known are off from an expected one.
fn misfit(skew: &Skew, expected: f64) -> f64 {
    let factors = [skew.translation, skew.rotation];
    let known = factors.iter().filter(|f: &&SkewFactor| f.sigma.is_finite());
    known.map(|f| ((f.factor - expected) / f.sigma.hypot(SECANT_ERROR * expected)).powi(2)).sum()
}

/// What the times of points may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Times {
    /// Those that were recorded, multiplied with this; 0: they are not to be used.
    Scaled(f64),
    /// Those that follow from the azimuth, of a lidar that turns like this.
    ByAzimuth(Turn),
}

/// The times of points that factors and fits together tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FittingTimes {
    /// What they are.
    pub times: Times,
    /// Whether it is clear that this is right, not only that times are wrong as they are.
    pub is_clear: bool,
}

/// What sweeps say if the azimuth tells times, where it tells others than those recorded.
#[derive(Clone, Copy, Debug)]
pub(super) struct AzimuthWitness {
    /// Factors in units of the motion by azimuth.
    pub skew: Skew,
    /// What they are if recorded times are right.
    pub slope: f64,
}

impl AzimuthWitness {
    fn times(&self) -> Times {
        Times::ByAzimuth(self.skew.turn())
    }

    /// Squared standard deviations that factors are off if these are the times.
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

/// How sweeps fit if these are the times of points.
pub(super) trait Fits {
    /// By how many standard deviations sweeps fit better with the second ones.
    fn sigmas_better(&self, from: Times, to: Times) -> f64;

    /// How many points lie on surfaces with these.
    fn explained(&self, times: Times) -> f64;
}

/// Whether times that span such a part of the interval between clouds span a turn.
pub(super) fn is_whole_turn(duty: f64) -> bool {
    (duty - 1.0).abs() < WHOLE_TURN
}

/// What times may be wrong by that span the share `duty` of the interval between clouds, from one cloud to the next included.
fn wrong_scales(duty: f64) -> impl Iterator<Item = f64> {
    let is_new = |whole: &f64| TIME_SCALES.iter().chain(&[1.0]).all(|scale| !is_whole_turn(whole / scale));
    TIME_SCALES.into_iter().chain(Some(duty.recip()).filter(is_new))
}

/// The same, with times as they are and times not used.
pub(super) fn scales_of_times(duty: f64) -> impl Iterator<Item = f64> {
    wrong_scales(duty).chain([0.0, 1.0])
}

const AS_RECORDED: Times = Times::Scaled(1.0);
const NONE: Times = Times::Scaled(0.0);

/// What the times of points are, as factors and fits together tell; none if nothing speaks against those recorded. Factors are
/// in units of the motion during the time that times span, which is the share `duty` of the interval between clouds.
pub(super) fn times_that_fit(
    skew: &Skew,
    duty: f64,
    by_azimuth: Option<AzimuthWitness>,
    fits: &impl Fits,
) -> Option<FittingTimes> {
    // Fits alone do not tell that a lidar spins: sweeps that never repeat hardly show the same things.
    let by_azimuth = by_azimuth.filter(|witness| is_known(&witness.skew));
    let scaled = clear_scale(skew, duty, fits);
    let turned = by_azimuth.and_then(|witness| clear_by_azimuth(&witness, scaled, fits));
    if let Some(times) = turned.or(scaled) {
        // Another hypothesis that fits better, though not clearly, leaves open which is right.
        let is_rivalled = by_azimuth
            .is_some_and(|witness| turned.is_none() && fits.sigmas_better(times, witness.times()) > 0.0);
        if !is_rivalled {
            return Some(FittingTimes { times, is_clear: true });
        }
    }
    let all = || scales_of_times(duty).map(Times::Scaled).chain(by_azimuth.map(|witness| witness.times()));
    // Where sweeps tell nothing of the motion, as those that never repeat, all points at one time fit best, whatever is right.
    let is_known = is_known(skew);
    let contradicts = |times: Times| {
        fits.sigmas_better(AS_RECORDED, times) > CONTRADICTED
            && (is_known || fits.sigmas_better(NONE, times) > 0.0)
    };
    let is_contradicted = scaled.is_some() || all().any(contradicts);
    let times = all().max_by(|a, b| fits.explained(*a).total_cmp(&fits.explained(*b)))?;
    is_contradicted.then_some(FittingTimes { times, is_clear: false })
}

/// Whether a factor is known at all.
fn is_known(skew: &Skew) -> bool {
    skew.translation.sigma.is_finite() || skew.rotation.sigma.is_finite()
}

/// What recorded times are to be multiplied with, if that is clear.
fn clear_scale(skew: &Skew, duty: f64, fits: &impl Fits) -> Option<Times> {
    let evidence = |from: f64, to: f64| {
        let sigmas = fits.sigmas_better(Times::Scaled(from), Times::Scaled(to));
        misfit(skew, from) - misfit(skew, to) + sigmas * sigmas.abs()
    };
    let spans_turn = |scale: f64| is_whole_turn(scale.abs() * duty);
    // A sweep takes the time from one cloud to the next: times that span another one are doubtful by themselves.
    let margin = |scale| if spans_turn(scale) && !spans_turn(1.0) { MARGIN } else { CLEAR_MARGIN };
    let exceeds = |scale: f64| evidence(1.0, scale).min(evidence(0.0, scale)) - margin(scale);
    let likely = wrong_scales(duty).filter(|scale| misfit(skew, *scale) < LIKELY);
    let clear = likely.map(|scale| (exceeds(scale), scale)).max_by(|a, b| a.0.total_cmp(&b.0));
    clear.filter(|(exceeds, _)| *exceeds > 0.0).map(|(_, scale)| Times::Scaled(scale))
}

/// Times by azimuth, if it is clear that these are right: the clock of the sweep is taken from its points then.
fn clear_by_azimuth(witness: &AzimuthWitness, scaled: Option<Times>, fits: &impl Fits) -> Option<Times> {
    let times = witness.times();
    let evidence = |from: Times| {
        let sigmas = fits.sigmas_better(from, times);
        witness.misfit(from) - witness.misfit(times) + sigmas * sigmas.abs()
    };
    let exceeds = |from: Times| evidence(from) > CLEAR_MARGIN;
    let is_clear = exceeds(AS_RECORDED) && exceeds(NONE) && scaled.is_none_or(exceeds);
    (is_clear && witness.misfit(times) < LIKELY).then_some(times)
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

    /// How sweeps fit with times by azimuth.
    const BY_AZIMUTH: f64 = 1.0;

    #[test]
    fn fits_tell_where_factors_are_not_clear() {
        let unknown = (-0.8, f64::INFINITY);
        let told = |translation, rotation, duty, fit, error| {
            times_that_fit(&skew(translation, rotation), duty, None, &Explained(fit, error)).map(|told| {
                let Times::Scaled(scale) = told.times else { panic!("{told:?}") };
                (scale, told.is_clear)
            })
        };
        let right: fn(f64) -> f64 = |s| -(s - 1.0).abs();
        let back: fn(f64) -> f64 = |s| -(s + 1.0).abs();
        let double: fn(f64) -> f64 = |s| -(s - 2.0).abs();
        let nothing: fn(f64) -> f64 = |_| 0.0;
        // Factors know nothing: fits tell alone, or that times are wrong, or nothing.
        assert_eq!(told(unknown, unknown, 1.0, back, 0.2), Some((-1.0, true)));
        assert_eq!(told(unknown, unknown, 1.0, back, 0.7), Some((-1.0, false)));
        assert_eq!(told(unknown, unknown, 1.0, back, 1.0), None);
        assert_eq!(told(unknown, unknown, 1.0, right, 0.2), None);
        let none: fn(f64) -> f64 = |s| -s.abs();
        assert_eq!(told(unknown, unknown, 1.0, none, 0.2), None);
        assert_eq!(told((0.3, 0.4), unknown, 1.0, none, 0.3), Some((0.0, false)));
        // A sweep of half of the interval between clouds, whose factors leave open what fits do not tell.
        let factors = ((1.58, 0.21), (1.64, 0.25));
        assert_eq!(told(factors.0, factors.1, 0.5, nothing, 1.0), Some((2.0, true)));
        assert_eq!(told(factors.0, factors.1, 1.0, nothing, 1.0), None);
        assert_eq!(told(factors.0, factors.1, 1.0, double, 0.3), Some((2.0, true)));
        assert_eq!(told(factors.0, factors.1, 0.5, right, 0.2), None);
    }

    #[test]
    fn times_by_azimuth_must_fit_better_than_all_others() {
        let unknown = (7.0, f64::INFINITY);
        let told = |by_azimuth, slope, fit, error| {
            let witness = AzimuthWitness { skew: skew(by_azimuth, unknown), slope };
            times_that_fit(&skew((0.1, 0.2), (0.0, 0.2)), 1.0, Some(witness), &Explained(fit, error))
        };
        let by_azimuth = |is_clear| {
            let times = Times::ByAzimuth(skew(unknown, unknown).turn());
            Some(FittingTimes { times, is_clear })
        };
        let none: fn(f64) -> f64 = |s| -s.abs();
        // Factors alone, where fits agree; both together; neither. Fits alone do not tell that a lidar spins.
        assert_eq!(told((1.0, 0.1), -0.5, none, 1.0), by_azimuth(true));
        assert_eq!(told(unknown, 0.0, none, 0.2), Some(FittingTimes { times: NONE, is_clear: false }));
        assert_eq!(told((0.9, 0.3), 0.0, none, 0.3), by_azimuth(true));
        assert_eq!(told((0.9, 0.3), 0.0, none, 0.7), by_azimuth(false));
        assert_eq!(told((0.9, 0.4), 0.0, none, 1.0), None);
        // Points move as recorded times say.
        assert_eq!(told((0.5, 0.1), 0.5, |s| 1.0 - (s - 1.0).abs(), 1.0), None);
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
