//! Checks the stamps of one sensor: unset, repeated, backward and jumping ones.

use portolan_geometry::{Duration, Time};

/// Difference between a stamp and its time by the recording's own clock above which it is a jump.
const JUMP: Duration = Duration::from_ticks(10 * 10_000_000);
/// Difference within which two jumps agree.
const AGREEMENT: Duration = Duration::from_ticks(10_000_000);
/// Number of messages in a row with the same jump after which the clock counts as set.
const JUMPS_OF_A_SET_CLOCK: u32 = 3;

/// What to do with a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stamp {
    /// Use it with this stamp.
    Good(Time),
    /// Its stamp was not set: use it with this one, the time of recording.
    Unset(Time),
    /// The clock was set before this message: use it with this stamp, which goes on as before.
    ClockSet(Time),
    /// Its stamp jumped; leave it out.
    Jump,
}

/// Compares the stamps of one sensor with the times of recording.
#[derive(Clone, Debug)]
pub(crate) struct SensorClock {
    /// Added to every stamp.
    shift: Duration,
    /// Time of recording minus stamp, of the last good message.
    lag: Option<Duration>,
    /// Last good stamp.
    last: Option<Time>,
    /// Lag of the last jump and how many in a row had it.
    jump: Option<(Duration, u32)>,
}

impl SensorClock {
    /// `shift` is added to stamps; `usual_lag` is the time of recording minus the shifted stamp, if known
    /// beforehand. Stamps of zero count as unset where that is not their usual lag.
    pub fn new(shift: Duration, usual_lag: Option<Duration>) -> Self {
        Self { shift, lag: usual_lag, last: None, jump: None }
    }

    /// Checks the next stamp.
    pub fn judge(&mut self, stamp: Time, log_time: Time) -> Stamp {
        let is_zero = stamp == Time::UNIX_EPOCH;
        let stamp = stamp + self.shift;
        let lag = log_time - stamp;
        if let (true, Some(usual)) = (is_zero, self.lag)
            && !near(lag, usual, JUMP)
        {
            return Stamp::Unset(log_time - usual);
        }
        let usual = *self.lag.get_or_insert(lag);
        // Stamps that go on as before are good even if the recording paused or ran at another speed.
        let continues = self.last.is_some_and(|last| stamp >= last && stamp - last <= JUMP);
        if continues || near(lag, usual, JUMP) {
            (self.lag, self.last, self.jump) = (Some(lag), Some(stamp), None);
            return Stamp::Good(stamp);
        }
        let count = match self.jump {
            Some((jump, count)) if near(jump, lag, AGREEMENT) => count + 1,
            _ => 1,
        };
        self.jump = Some((lag, count));
        if count < JUMPS_OF_A_SET_CLOCK {
            return Stamp::Jump;
        }
        // From here on stamps count from the new time of that clock.
        let correction = lag - usual;
        self.shift = self.shift + correction;
        (self.last, self.jump) = (Some(stamp + correction), None);
        Stamp::ClockSet(stamp + correction)
    }
}

fn near(a: Duration, b: Duration, tolerance: Duration) -> bool {
    let difference = a - b;
    difference <= tolerance && difference >= Duration::ZERO - tolerance
}

/// Keeps the times of a sensor strictly ascending.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Ascending(Option<Time>);

/// How a time compares with the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Order {
    /// Later.
    Later,
    /// The same.
    Same,
    /// Earlier.
    Backward,
}

impl Ascending {
    /// Compares `time` with the latest time so far; a later one becomes the latest.
    pub fn check(&mut self, time: Time) -> Order {
        match self.0 {
            Some(last) if time < last => Order::Backward,
            Some(last) if time == last => Order::Same,
            _ => {
                self.0 = Some(time);
                Order::Later
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: i64) -> Time {
        Time::from_ros(1_700_000_000 + seconds, 0)
    }

    #[test]
    fn a_single_jump_is_left_out() {
        let mut clock = SensorClock::new(Duration::ZERO, None);
        assert_eq!(clock.judge(at(0), at(0)), Stamp::Good(at(0)));
        assert_eq!(clock.judge(at(1_000_000_000), at(1)), Stamp::Jump);
        assert_eq!(clock.judge(at(-5000), at(2)), Stamp::Jump);
        assert_eq!(clock.judge(at(3), at(3)), Stamp::Good(at(3)));
        assert_eq!(clock.judge(Time::from_ros(0, 0), at(4)), Stamp::Unset(at(4)));
        assert_eq!(clock.judge(at(1005), at(1005)), Stamp::Good(at(1005)));
    }

    #[test]
    fn stamps_continue_after_a_clock_was_set() {
        let mut clock = SensorClock::new(Duration::ZERO, None);
        clock.judge(at(0), at(0));
        let verdicts: Vec<Stamp> = (1..6).map(|s| clock.judge(at(s - 3600), at(s))).collect();
        assert_eq!(
            verdicts,
            [Stamp::Jump, Stamp::Jump, Stamp::ClockSet(at(3)), Stamp::Good(at(4)), Stamp::Good(at(5))]
        );
    }

    #[test]
    fn a_pause_of_the_recording_is_no_jump() {
        let mut clock = SensorClock::new(Duration::ZERO, None);
        clock.judge(at(0), at(0));
        assert_eq!(clock.judge(at(1), at(3601)), Stamp::Good(at(1)));
        assert_eq!(clock.judge(at(2), at(3602)), Stamp::Good(at(2)));
    }

    #[test]
    fn a_known_lag_catches_a_wrong_first_stamp() {
        let mut clock = SensorClock::new(Duration::ZERO, Some(Duration::ZERO));
        assert_eq!(clock.judge(at(90_000_000), at(0)), Stamp::Jump);
        assert_eq!(clock.judge(at(1), at(1)), Stamp::Good(at(1)));
    }

    #[test]
    fn times_ascend() {
        let mut order = Ascending::default();
        let orders = [5, 5, 4, 6].map(|s| order.check(at(s)));
        assert_eq!(orders, [Order::Later, Order::Same, Order::Backward, Order::Later]);
    }
}
