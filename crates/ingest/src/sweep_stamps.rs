//! Corrects jittering stamps of sweeps whose points have times of their own.
//!
//! The head of a spinning lidar begins a revolution when it has ended the last one. Sweeps that overlap in
//! time therefore show that their stamps are wrong, like those of computers that stamp messages on arrival.
//! Each stamp is then moved to the time that follows from the steady rotation of the head.

use portolan_geometry::{Duration, Time};

use crate::turn_clock::TurnClock;

/// Minimum fraction of a revolution that a sweep covers for its overlap to count.
const WHOLE: f64 = 0.8;
/// Overlap of sweeps, as a fraction of a revolution, above which it counts; less is rounding, or a head that
/// turns a little more than once.
const OVERLAP: f64 = 0.02;
/// Minimum number of overlaps before stamps are corrected.
const ENOUGH: u32 = 3;
/// Minimum fraction of sweeps that overlap before stamps are corrected.
const OFTEN: f64 = 0.1;

/// Checks the sweeps of one lidar.
#[derive(Clone, Debug)]
pub(crate) struct SweepStamps {
    clock: TurnClock,
    last_end: Option<Time>,
    sweeps: u32,
    overlaps: u32,
    jitters: bool,
}

impl SweepStamps {
    /// `period`: approximate duration of a revolution, seconds.
    pub fn new(period: f64) -> Self {
        Self { clock: TurnClock::new(period), last_end: None, sweeps: 0, overlaps: 0, jitters: false }
    }

    /// Correction to be added to the times of the points of the next sweep, which lasts from `begin` to `end`
    /// by its stamp; none while stamps are trusted.
    pub fn correction(&mut self, stamp: Time, begin: Time, end: Time) -> Option<Duration> {
        let smooth = self.clock.smooth(stamp);
        let period = self.clock.period();
        let is_whole = end.seconds_since(begin) >= WHOLE * period;
        let overlap = self.last_end.replace(end).map_or(0.0, |last| last.seconds_since(begin));
        self.sweeps += 1;
        // An overlap of more than half of a turn comes from a repeated sweep or a clock that went back.
        self.overlaps += u32::from(is_whole && (OVERLAP * period..0.5 * period).contains(&overlap));
        self.jitters |= self.overlaps >= ENOUGH && f64::from(self.overlaps) >= OFTEN * f64::from(self.sweeps);
        self.jitters.then(|| smooth - stamp)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Time {
        Time::from_unix_seconds(1e9) + Duration::from_seconds(seconds)
    }

    /// Errors of the corrected stamps of sweeps that last `seconds`, and whether they were corrected; the stamps came
    /// with errors of up to `jitter` seconds.
    fn corrected(seconds: f64, jitter: f64) -> Vec<(f64, bool)> {
        let mut stamps = SweepStamps::new(0.1);
        let off = |k: u32| jitter * (f64::from(k * 7919 % 101) / 50.0 - 1.0);
        let next = |k: u32| {
            let stamp = 0.1 * f64::from(k) + off(k);
            let correction = stamps.correction(at(stamp), at(stamp), at(stamp + seconds));
            (stamp + correction.map_or(0.0, |c| c.seconds()) - 0.1 * f64::from(k), correction.is_some())
        };
        (0..200).map(next).collect()
    }

    #[test]
    fn sweeps_that_overlap_are_put_where_the_head_turns_steadily() {
        let corrected = corrected(0.0995, 0.015);
        assert!(corrected.iter().skip(20).all(|(_, is_corrected)| *is_corrected));
        let worst = corrected.iter().skip(40).map(|(error, _)| error.abs()).fold(0.0, f64::max);
        assert!(worst < 0.005, "{worst}");
    }

    #[test]
    fn stamps_of_consecutive_sweeps_are_kept() {
        assert!(corrected(0.0995, 0.0005).iter().all(|(_, is_corrected)| !is_corrected));
    }

    #[test]
    fn a_driver_that_cuts_sweeps_longer_than_a_turn_changes_no_times() {
        assert!(corrected(0.11, 0.0).iter().all(|(error, _)| error.abs() < 1e-6));
    }
}
