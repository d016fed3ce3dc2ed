//! Times at which sensors measure, and the interface of all sources of messages.

use portolan_geometry::{Duration, Time};
use portolan_recording::RecordedMessage;

const TICKS_PER_SECOND: f64 = 1e7;

/// A source of messages in ascending order of log time.
pub(crate) trait MessageStream: Send {
    /// The next message, or none at the end.
    fn next_message(&mut self) -> Option<RecordedMessage>;
}

/// True time: converts between seconds of the walk and times.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    pub start: Time,
}

impl Clock {
    pub fn moment(&self, since_start: Duration) -> Time {
        self.start + since_start
    }

    pub fn seconds(&self, moment: Time) -> f64 {
        moment.seconds_since(self.start)
    }
}

/// Measurements at a constant rate from the start of the walk.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Schedule {
    first: f64,
    rate: f64,
    count: u64,
}

impl Schedule {
    /// As many measurements as begin at 0 or later and take `each` seconds within `duration`.
    pub fn new(rate: f64, duration: f64, each: f64) -> Self {
        Self::starting_at(0.0, rate, duration, each)
    }

    /// The same with the first one at `first` seconds.
    pub fn starting_at(first: f64, rate: f64, duration: f64, each: f64) -> Self {
        let available = duration - first - each;
        let count = if available < 0.0 { 0 } else { (available * rate + 1e-6).floor() as u64 + 1 };
        Self { first, rate, count }
    }

    pub fn count(&self) -> u64 {
        self.count
    }

    /// Time at which measurement `index` begins, to the nearest tick: sensors measure exactly at their
    /// stamps.
    pub fn time_of(&self, index: u64) -> Duration {
        let seconds = self.first * TICKS_PER_SECOND + index as f64 * TICKS_PER_SECOND / self.rate;
        Duration::from_ticks(seconds.round() as i64)
    }
}

/// The measurements of a sensor one after the other: number, seconds since the start, true time.
#[derive(Clone, Debug)]
pub(crate) struct Ticks {
    clock: Clock,
    schedule: Schedule,
    next: u64,
}

impl Ticks {
    pub fn new(clock: Clock, schedule: Schedule) -> Self {
        Self { clock, schedule, next: 0 }
    }
}

impl Iterator for Ticks {
    type Item = (u64, f64, Time);

    fn next(&mut self) -> Option<Self::Item> {
        let index = self.next;
        (index < self.schedule.count()).then(|| {
            self.next += 1;
            let since_start = self.schedule.time_of(index);
            (index, since_start.seconds(), self.clock.moment(since_start))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schedules_fill_the_duration() {
        let schedule = Schedule::new(10.0, 300.0, 0.1);
        assert_eq!(schedule.count(), 3000);
        assert_eq!(schedule.time_of(7).ticks(), 7_000_000);
        assert_eq!(Schedule::new(3.0, 1.0, 0.0).count(), 4);
        assert_eq!(Schedule::new(3.0, 1.0, 0.0).time_of(1).ticks(), 3_333_333);
        assert_eq!(Schedule::new(10.0, 0.05, 0.1).count(), 0);
    }
}
