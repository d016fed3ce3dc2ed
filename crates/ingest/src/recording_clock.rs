//! Detects jumps of the clock that a recording was made with.

use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind};

/// Longest pause of a recording, seconds: a day. Computers without a battery for their clock start in 1970
/// and are corrected once there is a network.
pub const LONGEST_PAUSE: f64 = 86_400.0;
/// Seconds of a year (Gregorian calendar) and of a day.
const YEAR: (f64, &str) = (31_556_952.0, "year");
const DAY: (f64, &str) = (86_400.0, "day");

/// Checks the times of recording of the messages of sensors.
#[derive(Clone, Copy, Debug, Default)]
pub struct RecordingClock {
    last: Option<Time>,
    messages: u64,
}

impl RecordingClock {
    /// Takes the time of recording of the next message; returns an issue if the clock jumped.
    pub fn take(&mut self, log_time: Time) -> Option<Issue> {
        self.messages += 1;
        let last = self.last.replace(log_time)?;
        let seconds = log_time.seconds_since(last);
        (seconds.abs() > LONGEST_PAUSE).then(|| {
            let back = if seconds < 0.0 { "back " } else { "" };
            Issue::new(IssueKind::RecordingClockJump)
                .with("by", format_args!("{back}by {}", in_words(seconds.abs())))
                .with_number("message", self.messages)
                .with("time", log_time)
                .with("before", last)
                .at(log_time)
        })
    }
}

/// A long time in years, a shorter one in days.
fn in_words(seconds: f64) -> String {
    let (length, name) = if seconds >= YEAR.0 { YEAR } else { DAY };
    let count = (seconds / length).round();
    format!("{count} {name}{}", if count == 1.0 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_that_begins_in_1970_is_named_and_a_pause_of_hours_is_not() {
        let mut clock = RecordingClock::default();
        let at = |seconds| Time::from_ros(seconds, 0);
        assert_eq!(clock.take(at(170)), None);
        assert_eq!(clock.take(at(40_000)), None);
        let text = clock.take(at(1_780_000_000)).unwrap().to_string();
        assert!(text.starts_with("the clock of the recording jumps by 56 years at message 3"), "{text}");
        assert!(clock.take(at(1_779_700_000)).unwrap().to_string().contains("back by 3 days at message 4"));
    }
}
