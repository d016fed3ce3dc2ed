//! Stamps of sweeps whose points have times of their own, where these stamps jitter.
//!
//! The head of a spinning lidar begins a revolution when it has ended the last one. Sweeps that overlap in time therefore
//! show that their stamps are off, as those of computers are that stamp what arrives: each of them is moved to where the
//! steady turning of the head puts it.

use portolan_geometry::{Duration, Time};

use crate::turn_clock::TurnClock;

/// A sweep covers at least this fraction of a revolution, or nothing can be said.
const WHOLE: f64 = 0.8;
/// Sweeps overlap if they do so by more than this fraction of a revolution; less is rounding, or a head that
/// turns a bit farther than once.
const OVERLAP: f64 = 0.02;
/// So many overlaps, and in so large a fraction of sweeps, are no accident.
const ENOUGH: u32 = 3;
const OFTEN: f64 = 0.1;

/// Follows the sweeps of one lidar.
#[derive(Clone, Debug)]
pub(crate) struct SweepStamps {
    clock: TurnClock,
    last_end: Option<Time>,
    sweeps: u32,
    overlaps: u32,
    jitters: bool,
}

impl SweepStamps {
    /// Of a lidar that turns once in about so many seconds.
    pub fn new(period: f64) -> Self {
        Self { clock: TurnClock::new(period), last_end: None, sweeps: 0, overlaps: 0, jitters: false }
    }

    /// What is to be added to the times of the points of the next sweep, which last from `begin` to `end` by its stamp; none
    /// while stamps are believed.
    pub fn correction(&mut self, stamp: Time, begin: Time, end: Time) -> Option<Duration> {
        let smooth = self.clock.smooth(stamp);
        let period = self.clock.period();
        let is_whole = end.seconds_since(begin) >= WHOLE * period;
        let overlap = self.last_end.replace(end).map_or(0.0, |last| last.seconds_since(begin));
        self.sweeps += 1;
        // What overlaps by more than half of a turn came twice, or its clock went back.
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

    /// By how much corrected stamps of sweeps that last so many seconds are off, and whether they were corrected; they came off
    /// by up to `jitter` seconds.
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
    fn stamps_of_sweeps_that_follow_each_other_are_believed() {
        assert!(corrected(0.0995, 0.0005).iter().all(|(_, is_corrected)| !is_corrected));
    }

    #[test]
    fn a_driver_that_cuts_sweeps_longer_than_a_turn_changes_no_times() {
        assert!(corrected(0.11, 0.0).iter().all(|(error, _)| error.abs() < 1e-6));
    }
}
