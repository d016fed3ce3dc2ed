//! Estimates the measurement times of a sensor with a steady rate from stamps that jitter.
//!
//! Time and period of its measurements are the state of a Kalman filter. From one measurement to the next,
//! time advances by the period and by the irregularity of the sensor itself, and each stamp is the time with
//! noise. Later messages improve the times of earlier ones, too (smoothing with a fixed lag: Rauch, Tung and
//! Striebel 1965, Maximum likelihood estimates of linear dynamic systems, over the messages at hand).

use portolan_geometry::nalgebra::{Matrix2, Vector2};
use portolan_geometry::{Duration, Time};
use portolan_recording::StampNoise;

/// Initial standard deviation of the period, as a fraction of it.
const PERIOD_KNOWN: f64 = 0.02;
/// Change of the period from measurement to measurement, as a fraction of it (standard deviation).
const PERIOD_CHANGES: f64 = 1e-4;
/// Standard deviation of the time of the next measurement after missing ones, as a fraction of the period.
const OPEN_AFTER_GAP: f64 = 0.3;
/// Number of messages that decide whether measurements are missing before them, or the first one came late.
const GAP_STAMPS: usize = 6;
/// Number of standard deviations above which a stamp has less weight (Huber).
const INLIER: f64 = 2.0;

/// Time, seconds since the last one, and period of measurements with their covariance.
#[derive(Clone, Copy, Debug)]
struct Phase {
    mean: Vector2<f64>,
    covariance: Matrix2<f64>,
}

/// One step of the filter.
struct Step {
    transition: Matrix2<f64>,
    predicted: Phase,
    updated: Phase,
}

/// Time span of later messages that are used, seconds. (Other sensors are waited for up to 2 s.)
pub(crate) const LOOK_AHEAD: f64 = 1.5;
/// Maximum number of later messages that are used.
const MOST_AHEAD: usize = 64;

/// Number of messages, `period` seconds apart, that are used to find the time of the first.
pub(crate) fn messages_ahead(period: f64) -> usize {
    MOST_AHEAD.min((LOOK_AHEAD / period) as usize + 1)
}

/// Stamps of a sensor with a steady rate that jitter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampJitter {
    /// Seconds between measurements.
    pub period: f64,
    /// Standard deviations of stamps and of intervals.
    pub noise: StampNoise,
}

impl StampJitter {
    /// Times of measurements with these stamps, in order of arrival; none where they cannot be determined.
    pub fn times(&self, stamps: &[Time]) -> Option<Vec<Time>> {
        let mut clock = SteadyClock::new(self);
        let ahead = messages_ahead(self.period);
        let from = |k: usize| stamps.get(k..stamps.len().min(k + ahead));
        (0..stamps.len()).map(|k| clock.time(from(k)?)).collect()
    }
}

/// Estimates the times of one sensor.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SteadyClock {
    noise: StampNoise,
    /// Time of the last measurement as known then, and the filter's state there.
    last: Option<(Time, Phase)>,
    /// Seconds.
    usual_period: f64,
}

impl SteadyClock {
    /// `jitter`: noise and period of the sensor.
    pub fn new(jitter: &StampJitter) -> Self {
        Self { noise: jitter.noise, last: None, usual_period: jitter.period }
    }

    /// Current estimate of the seconds between measurements.
    pub fn period(&self) -> f64 {
        self.last.map_or(self.usual_period, |(_, phase)| phase.mean.y)
    }

    /// Time of the first of these stamps, which are in order of arrival and follow the one before; none
    /// without stamps.
    pub fn time(&mut self, stamps: &[Time]) -> Option<Time> {
        let first = *stamps.first()?;
        let base = self.last.map_or(first, |(time, _)| time);
        let since: Vec<f64> = stamps.iter().map(|stamp| stamp.seconds_since(base)).collect();
        let steps = self.filter(&since);
        let filtered = steps.first()?.updated;
        let mut smooth = steps.last()?.updated.mean;
        for (step, next) in steps.iter().zip(steps.iter().skip(1)).rev() {
            let gain = next.predicted.covariance.try_inverse().map_or_else(Matrix2::zeros, |information| {
                step.updated.covariance * next.transition.transpose() * information
            });
            smooth = step.updated.mean + gain * (smooth - next.predicted.mean);
        }
        let mut left = filtered;
        left.mean.x = 0.0;
        self.last = Some((base + Duration::from_seconds(filtered.mean.x), left));
        Some(base + Duration::from_seconds(smooth.x))
    }

    /// The filter over stamps, seconds since the last measurement.
    fn filter(&self, since: &[f64]) -> Vec<Step> {
        let mut steps: Vec<Step> = Vec::with_capacity(since.len());
        let mut last = self.last.map(|(_, phase)| phase);
        for (k, stamp) in since.iter().enumerate() {
            let (transition, predicted) = match last {
                Some(last) => self.predict(&last, since.get(k..).unwrap_or_default()),
                None => (Matrix2::identity(), self.beginning(*stamp)),
            };
            let updated = self.update(&predicted, *stamp);
            steps.push(Step { transition, predicted, updated });
            last = Some(updated);
        }
        steps
    }

    /// Initial state: only the rate is known.
    fn beginning(&self, stamp: f64) -> Phase {
        let spread = Vector2::new(OPEN_AFTER_GAP, PERIOD_KNOWN) * self.usual_period;
        let covariance = Matrix2::from_diagonal(&spread.component_mul(&spread));
        Phase { mean: Vector2::new(stamp, self.usual_period), covariance }
    }

    /// Predicts the next measurement, from its stamp and the ones that follow it.
    fn predict(&self, last: &Phase, stamps: &[f64]) -> (Matrix2<f64>, Phase) {
        let (time, period) = (last.mean.x, last.mean.y);
        let late = (1u32..).zip(stamps.iter().take(GAP_STAMPS));
        let late = late.map(|(k, stamp)| stamp - time - f64::from(k) * period);
        let missing = (late.fold(f64::INFINITY, f64::min) / period).round().clamp(0.0, 1e6);
        let transition = Matrix2::new(1.0, 1.0 + missing, 0.0, 1.0);
        let open = if missing > 0.0 { OPEN_AFTER_GAP * period } else { 0.0 };
        let spread = Vector2::new(self.noise.of_intervals.hypot(open), PERIOD_CHANGES * period);
        let covariance = transition * last.covariance * transition.transpose()
            + Matrix2::from_diagonal(&spread.component_mul(&spread));
        (transition, Phase { mean: transition * last.mean, covariance })
    }

    fn update(&self, predicted: &Phase, stamp: f64) -> Phase {
        let column = predicted.covariance.column(0).into_owned();
        let off = stamp - predicted.mean.x;
        let mut variance = self.noise.of_stamps.powi(2);
        let standard = off.abs() / (column.x + variance).sqrt().max(f64::MIN_POSITIVE);
        if standard > INLIER {
            variance *= standard / INLIER;
        }
        let gain = column / (column.x + variance).max(f64::MIN_POSITIVE);
        Phase {
            mean: predicted.mean + gain * off,
            covariance: predicted.covariance - gain * column.transpose(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Time {
        Time::from_unix_seconds(1e9) + Duration::from_seconds(seconds)
    }

    /// Root mean square errors of stamps and of estimated times, seconds. `truth` are the times of the measurements,
    /// `off` the errors of their stamps.
    fn errors(truth: &[f64], off: impl Fn(usize) -> f64, noise: StampNoise) -> (f64, f64) {
        let stamps: Vec<Time> = truth.iter().enumerate().map(|(k, t)| at(t + off(k))).collect();
        let times = StampJitter { period: 0.2, noise }.times(&stamps).unwrap();
        let rms = |times: &[Time]| {
            let squares = times.iter().zip(truth).map(|(time, truth)| time.seconds_since(at(*truth)).powi(2));
            (squares.sum::<f64>() / truth.len() as f64).sqrt()
        };
        (rms(&stamps), rms(&times))
    }

    /// Noise without mean, spread evenly from −1 to 1.
    fn random(k: usize) -> f64 {
        (k * 7919 % 1009) as f64 / 504.0 - 1.0
    }

    #[test]
    fn jitter_of_a_steady_sensor_is_removed() {
        let noise = StampNoise { of_stamps: 0.03, of_intervals: 0.001 };
        let truth: Vec<f64> = (0..500).filter(|k| k % 97 > 3).map(|k| 0.2031 * f64::from(k)).collect();
        let (before, after) = errors(&truth, |k| 0.05 * random(k), noise);
        assert!(after < 0.35 * before, "{before} {after}");
    }

    #[test]
    fn stamps_of_an_irregular_sensor_are_kept() {
        let noise = StampNoise { of_stamps: 0.003, of_intervals: 0.04 };
        let truth: Vec<f64> = (0..500).map(|k| 0.2 * k as f64 + 0.06 * random(k)).collect();
        let (_, after) = errors(&truth, |_| 0.0, noise);
        assert!(after < 0.002, "{after}");
    }
}
