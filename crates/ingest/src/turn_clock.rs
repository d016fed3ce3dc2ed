//! Estimates the times of the turns of a spinning lidar from stamps that jitter.
//!
//! The head of a spinning lidar has inertia: one revolution takes as long as the last one. Deviations of the
//! stamps come from the source of the stamps: a camera that triggers, a clock of 10 ms, a busy computer. A
//! turn whose points get their times from its stamp must not begin before the last one ended. So stamps are
//! smoothed by a filter of time and period with growing, then fading memory (Morrison 1969, Introduction to
//! Sequential Smoothing and Prediction, polynomial filters of degree 1).

use portolan_geometry::{Duration, Time};

/// Maximum memory of the filter, turns.
const MEMORY: f64 = 30.0;
/// Deviation of a stamp, as a fraction of a revolution, above which it belongs to another revolution, or to a
/// real change. The filter then restarts.
const JITTER: f64 = 0.25;
/// Number of missing turns from which the filter restarts.
const MAX_MISSING: f64 = 20.0;

/// Time and period of revolutions.
#[derive(Clone, Debug)]
pub(crate) struct TurnClock {
    /// Seconds of a revolution.
    period: f64,
    last: Option<Time>,
    turns: f64,
}

impl TurnClock {
    /// `period`: approximate duration of a turn, seconds.
    pub fn new(period: f64) -> Self {
        Self { period, last: None, turns: 0.0 }
    }

    /// Current estimate of the duration of a revolution, seconds.
    pub fn period(&self) -> f64 {
        self.period
    }

    /// Smoothed time of the turn that has this stamp.
    pub fn smooth(&mut self, stamp: Time) -> Time {
        let since = self.last.map_or(f64::INFINITY, |last| stamp.seconds_since(last));
        let passed = (since / self.period).round();
        let late = since - passed * self.period;
        if !(1.0..=MAX_MISSING).contains(&passed) || late.abs() > JITTER * self.period {
            (self.last, self.turns) = (Some(stamp), 1.0);
            return stamp;
        }
        self.turns = (self.turns + 1.0).min(MEMORY);
        let n = self.turns;
        let of_time = 2.0 * (2.0 * n - 1.0) / (n * (n + 1.0));
        let of_period = 6.0 / (n * (n + 1.0));
        let time = stamp - Duration::from_seconds((1.0 - of_time) * late);
        // The first interval says less about the period than the many intervals from which it was known
        // before reading.
        if n > 2.0 {
            self.period += of_period * late / passed;
        }
        self.last = Some(time);
        time
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Time {
        Time::from_unix_seconds(1e9) + Duration::from_seconds(seconds)
    }

    #[test]
    fn jitter_is_smoothed_and_turns_remain_separate() {
        // Stamps of a clock of 10 ms.
        let mut clock = TurnClock::new(0.1);
        for k in 0..300 {
            let truth = 0.1034 * f64::from(k);
            let stamp = (truth * 100.0).floor() / 100.0;
            let error = clock.smooth(at(stamp)).seconds_since(at(truth - 0.005));
            assert!(error.abs() < if k < 20 { 0.0055 } else { 0.002 }, "{k}: {error}");
        }
        assert!((clock.period() - 0.1034).abs() < 2e-4, "{}", clock.period());
    }

    #[test]
    fn lost_turns_and_gaps_are_kept() {
        let mut clock = TurnClock::new(0.1);
        let turns = (0..50).chain(53..100).chain(500..550);
        for k in turns {
            let time = clock.smooth(at(0.1 * f64::from(k)));
            assert!((time.seconds_since(at(0.1 * f64::from(k)))).abs() < 1e-6, "{k}");
        }
    }

    #[test]
    fn a_change_of_speed_is_followed() {
        let mut clock = TurnClock::new(0.1);
        let mut truth = 0.0;
        for k in 0..400 {
            truth += if k < 200 { 0.1 } else { 0.102 };
            let error = clock.smooth(at(truth)).seconds_since(at(truth));
            assert!(error.abs() < 0.02, "{k}: {error}");
        }
        assert!((clock.period() - 0.102).abs() < 1e-5);
    }
}
