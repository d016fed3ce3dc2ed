//! Detects whether the stamps of a sensor are its times of measurement.

use portolan_geometry::Time;
use portolan_numeric::quantile;

/// Maximum number of intervals over which the mean interval is taken.
const MEAN_OVER: usize = 50;
/// Maximum ratio of the longest to the shortest mean interval (95 % and 5 % quantiles) of a sensor with a
/// steady rate.
const STEADY: f64 = 2.0;
/// Fraction of messages in bursts, or with an earlier stamp than the message before, above which stamps are
/// rejected. Real logs with good stamps have at most 0.03 in any window (odometry of aces), intel 0.17 to
/// 0.87.
const MOST_IN_BURSTS: f64 = 0.1;
/// Maximum period of a sensor with a steady rate, seconds. Slower sensors are triggered or thinned out and
/// have no expected rate.
const LONGEST_PERIOD: f64 = 1.0;

/// Statistics of the stamps of one sensor, in order of arrival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampPattern {
    /// Usual interval, seconds.
    pub period: f64,
    /// Fraction of messages in bursts or with an earlier stamp than the message before.
    pub disturbed: f64,
    /// Causes of the variation of intervals.
    pub noise: StampNoise,
}

/// Why the intervals of a sensor vary: stamps `s_k = t_k + n_k` of times `t_(k+1) = t_k + period + w_k`. An
/// error of one stamp makes the interval before it longer and the one after it shorter; jitter of the sensor
/// itself has no such effect. So the negated covariance of neighbouring intervals is the variance of the
/// stamps, and the rest of the variance of the intervals comes from the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StampNoise {
    /// Standard deviation of stamps, seconds.
    pub of_stamps: f64,
    /// Standard deviation of the intervals between measurements, seconds.
    pub of_intervals: f64,
}

impl StampNoise {
    /// From stamps in order of arrival. Deviations from the usual interval are clamped to one period.
    fn of(stamps: &[Time], period: f64) -> Self {
        let intervals = stamps.iter().zip(stamps.iter().skip(1));
        let off: Vec<f64> =
            intervals.map(|(a, b)| (b.seconds_since(*a) - period).clamp(-period, period)).collect();
        let mean = off.iter().sum::<f64>() / off.len().max(1) as f64;
        let product = |lag: usize| {
            let products = off.iter().zip(off.iter().skip(lag)).map(|(a, b)| (a - mean) * (b - mean));
            products.sum::<f64>() / off.len().saturating_sub(lag).max(1) as f64
        };
        let (variance, covariance) = (product(0), product(1));
        let of_stamps = (-covariance).clamp(0.0, 0.5 * variance);
        Self { of_stamps: of_stamps.sqrt(), of_intervals: (variance - 2.0 * of_stamps).max(0.0).sqrt() }
    }
}

impl StampPattern {
    /// Minimum number of stamps for an estimate.
    pub const ENOUGH: usize = 60;
    /// Fraction of the period; messages closer than this came in a burst.
    pub const BURST: f64 = 0.25;

    /// Statistics of a sensor that measures at a steady rate; none for other sensors, and for too few stamps.
    pub fn of(stamps: &[Time]) -> Option<Self> {
        let mean_over = MEAN_OVER.min(stamps.len() / 4);
        if stamps.len() < Self::ENOUGH {
            return None;
        }
        let mut means: Vec<f64> = stamps
            .iter()
            .zip(stamps.iter().skip(mean_over))
            .map(|(first, last)| last.seconds_since(*first) / mean_over as f64)
            .collect();
        let [fast, period, slow] = [0.05, 0.5, 0.95].map(|share| quantile(&mut means, share).unwrap_or(0.0));
        if fast <= 0.0 || slow > STEADY * fast || period > LONGEST_PERIOD {
            return None;
        }
        let intervals = stamps.len() as f64 - 1.0;
        let backward = stamps.iter().zip(stamps.iter().skip(1)).filter(|(a, b)| b < a).count();
        let mut sorted = stamps.to_vec();
        sorted.sort_unstable();
        let close = |(a, b): &(&Time, &Time)| b.seconds_since(**a) < Self::BURST * period;
        let bunched = sorted.iter().zip(sorted.iter().skip(1)).filter(close).count();
        let disturbed = (backward + bunched) as f64 / intervals;
        Some(Self { period, disturbed, noise: StampNoise::of(stamps, period) })
    }

    /// Whether the stamps are too disturbed to be times of measurement.
    pub fn is_disturbed(&self) -> bool {
        self.disturbed > MOST_IN_BURSTS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(seconds: impl Fn(u32) -> f64) -> Option<StampPattern> {
        let stamps: Vec<Time> = (0..200).map(|k| Time::from_unix_seconds(1e9 + seconds(k))).collect();
        StampPattern::of(&stamps)
    }

    #[test]
    fn bursts_and_backward_steps_are_distinguished_from_steady_stamps() {
        let steady = pattern(|k| 0.2 * f64::from(k) + 0.003 * f64::from(k % 7)).unwrap();
        assert!((steady.period - 0.2).abs() < 0.001 && !steady.is_disturbed(), "{steady:?}");
        let bursts = pattern(|k| (0.2 * f64::from(k) / 0.9).ceil() * 0.9 + 0.001 * f64::from(k % 5)).unwrap();
        assert!((bursts.period - 0.2).abs() < 0.02 && bursts.is_disturbed(), "{bursts:?}");
        // A clock with a resolution of one second.
        let coarse = pattern(|k| (0.2 * f64::from(k)).floor()).unwrap();
        assert!((coarse.period - 0.2).abs() < 0.001 && coarse.is_disturbed(), "{coarse:?}");
        assert_eq!(pattern(|k| 4.0 * f64::from(k)), None);
        assert_eq!(StampPattern::of(&[Time::UNIX_EPOCH; StampPattern::ENOUGH - 1]), None);
    }
}
