//! Corrects stamps that give the time when a message was handed on instead of when it was measured.
//!
//! A scanner measures at a steady rate. A busy computer between it and the recording stamps several of its
//! messages at once, after some time without messages, and may even mix up their stamps: the order of arrival
//! is right, the stamps are true times plus a delay that is never negative. The true time of message `k` is
//! then at most `min over j >= k of (stamp_j - (j - k) * period)`, and close to that wherever one of the next
//! messages came without delay (the lower envelope of Moon, Skelly and Towsley 1999 for clocks of networks,
//! with the order of arrival as the device's own clock).

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use portolan_geometry::{Duration, Time};
use portolan_recording::{RecordedMessage, Recording, RecordingError, StampPattern};

use crate::repeats::read_without_repeats;
use crate::steady_clock::{LOOK_AHEAD, StampJitter, SteadyClock, messages_ahead};

/// Treatment of the stamps of scanners and odometry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum StampPolicy {
    /// Unchanged, unless they come in bursts, go back, certainly jitter or make sweeps of a lidar overlap.
    #[default]
    Auto,
    /// Unchanged.
    AsIs,
    /// Always replaced by times from a steady rate and the order of arrival.
    Regular,
}

/// Number of recent stamps from which it is decided whether they are steady.
const WINDOW: usize = 200;
/// Factor for the mean interval between messages, which is too long since some messages are lost.
const FASTER_THAN_MEAN: f64 = 0.97;

/// Seconds between messages for those of these topics whose first stamps, from a time of recording on, are
/// not measurement times. Without this look ahead they would be trusted until they are seen to be wrong.
pub(crate) fn disturbed_beginnings(
    recording: &dyn Recording,
    topics: &[Arc<str>],
    start: Time,
) -> Result<BTreeMap<Arc<str>, f64>, RecordingError> {
    let mut stamps: BTreeMap<Arc<str>, Vec<Time>> = BTreeMap::new();
    if topics.is_empty() {
        return Ok(BTreeMap::new());
    }
    let mut reader = read_without_repeats(recording, &|topic| topics.contains(&topic.topic))?;
    while let Some(message) = reader.next_message()? {
        let Some(header) = message.message.header().filter(|_| message.log_time >= start) else { continue };
        let seen = stamps.entry(message.topic).or_default();
        seen.push(header.stamp);
        if seen.len() >= WINDOW {
            break;
        }
    }
    let disturbed = |stamps: &Vec<Time>| StampPattern::of(stamps).filter(StampPattern::is_disturbed);
    Ok(stamps
        .into_iter()
        .filter_map(|(topic, stamps)| disturbed(&stamps).map(|pattern| (topic, pattern.period)))
        .collect())
}

/// Fault of the stamps of a sensor.
#[derive(Debug)]
enum StampFault {
    /// No fault.
    None,
    /// They come in bursts or go back; a period, seconds, that is a bit shorter than that of the messages.
    Bursts(f64),
    /// They jitter.
    Jitter(SteadyClock),
}

/// Follows the stamps of one sensor and makes them even while they are not measurement times.
#[derive(Debug)]
pub(crate) struct EvenStamps {
    policy: StampPolicy,
    /// The newest stamps as they came.
    recent: VecDeque<Time>,
    since_judged: usize,
    fault: StampFault,
    waiting: VecDeque<(Time, RecordedMessage)>,
    last: Option<Time>,
}

impl EvenStamps {
    pub fn new(policy: StampPolicy) -> Self {
        Self {
            policy,
            recent: VecDeque::new(),
            since_judged: 0,
            fault: StampFault::None,
            waiting: VecDeque::new(),
            last: None,
        }
    }

    /// With stamps that are not trusted from the beginning, if a period, seconds, is given.
    pub fn with_disturbed_period(mut self, period: Option<f64>) -> Self {
        if self.policy != StampPolicy::AsIs {
            self.fault =
                period.map_or(StampFault::None, |period| StampFault::Bursts(FASTER_THAN_MEAN * period));
        }
        self
    }

    /// With stamps that jitter like this.
    pub fn with_jitter(mut self, jitter: Option<&StampJitter>) -> Self {
        if let (Some(jitter), true) = (jitter, self.policy != StampPolicy::AsIs) {
            self.fault = StampFault::Jitter(SteadyClock::new(jitter));
        }
        self
    }

    /// Takes the stamp of a message. Returns false if the message can be used with it at once; otherwise the
    /// message waits.
    pub fn holds(&mut self, stamp: Time, message: &RecordedMessage) -> bool {
        if self.policy == StampPolicy::AsIs {
            return false;
        }
        self.recent.push_back(stamp);
        if self.recent.len() > WINDOW {
            self.recent.pop_front();
        }
        self.since_judged += 1;
        if self.since_judged >= StampPattern::ENOUGH / 2 {
            self.since_judged = 0;
            self.judge();
        }
        if matches!(self.fault, StampFault::None) {
            self.last = self.last.max(Some(stamp));
            return false;
        }
        self.waiting.push_back((stamp, message.clone()));
        true
    }

    /// Whether the first waiting message is older than the look-ahead at this time of the recording, so that
    /// messages of other sensors, which are not held back, would overtake it: its sensor has stopped sending.
    pub fn has_waited_long(&self, now: Time) -> bool {
        self.waiting.front().is_some_and(|(_, message)| now.seconds_since(message.log_time) > LOOK_AHEAD)
    }

    /// Stamps once found faulty stay so: good ones are on the envelope and are hardly changed.
    fn judge(&mut self) {
        let Some(pattern) = StampPattern::of(self.recent.make_contiguous()) else { return };
        let is_regular = self.policy == StampPolicy::Regular;
        match self.fault {
            StampFault::None if !pattern.is_disturbed() && !is_regular => {}
            StampFault::None | StampFault::Bursts(_) => {
                self.fault = StampFault::Bursts(FASTER_THAN_MEAN * pattern.period)
            }
            StampFault::Jitter(_) => {}
        }
    }

    /// The next message whose time is determined at this time of the recording, with the stamp that it came
    /// with and its time.
    pub fn pop(&mut self, now: Time) -> Option<(RecordedMessage, Time, Time)> {
        let period = match &self.fault {
            StampFault::None => return None,
            StampFault::Bursts(period) => *period,
            StampFault::Jitter(clock) => clock.period(),
        };
        let ahead = messages_ahead(period);
        let ((first, _), (newest, _)) = (self.waiting.front()?, self.waiting.back()?);
        // Messages after a gap do not constrain the times of those before it.
        let is_old = newest.seconds_since(*first) > LOOK_AHEAD;
        if self.waiting.len() < ahead && !is_old && !self.has_waited_long(now) {
            return None;
        }
        let stamps: Vec<Time> = self.waiting.iter().take(ahead).map(|(stamp, _)| *stamp).collect();
        let time = match &mut self.fault {
            StampFault::Jitter(clock) => clock.time(&stamps)?,
            _ => latest_of_first(&stamps, period)?,
        };
        let (stamp, message) = self.waiting.pop_front()?;
        let earliest =
            self.last.map_or(Time::MIN, |last| last + Duration::from_seconds(StampPattern::BURST * period));
        let time = time.max(earliest);
        self.last = Some(time);
        Some((message, stamp, time))
    }
}

/// Upper bound for the measurement time of the first of these messages, with `period` seconds between
/// measurements.
fn latest_of_first(stamps: &[Time], period: f64) -> Option<Time> {
    let numbered = (0u32..).zip(stamps);
    numbered.map(|(later, stamp)| *stamp - Duration::from_seconds(f64::from(later) * period)).min()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use portolan_recording::{Message, TfMessage};

    fn at(seconds: f64) -> Time {
        Time::from_unix_seconds(1e9) + Duration::from_seconds(seconds)
    }

    fn message() -> RecordedMessage {
        let message = Message::Tf(TfMessage { is_static: false, transforms: Vec::new() });
        RecordedMessage { topic: Arc::from("/scan"), log_time: at(0.0), message }
    }

    /// Corrected times of messages with these stamps.
    fn even(stamps: &[Time], policy: StampPolicy) -> Vec<Time> {
        let mut even = EvenStamps::new(policy);
        let mut times = Vec::new();
        for stamp in stamps {
            if !even.holds(*stamp, &message()) {
                times.push(*stamp);
            }
            times.extend(std::iter::from_fn(|| even.pop(Time::MIN)).map(|(_, _, time)| time));
        }
        times.extend(std::iter::from_fn(|| even.pop(Time::MAX)).map(|(_, _, time)| time));
        times
    }

    /// Stamps and true times of a computer that hands on its messages in bursts.
    fn in_bursts(count: u32, period: f64) -> (Vec<Time>, Vec<Time>) {
        let truth: Vec<f64> = (0..count).map(|k| f64::from(k) * period).collect();
        let stamps = truth.iter().enumerate().map(|(k, t)| {
            let busy_until = (t / 0.9).ceil() * 0.9;
            at(busy_until + 0.001 * (k % 5) as f64)
        });
        (stamps.collect(), truth.iter().map(|t| at(*t)).collect())
    }

    #[test]
    fn bursts_become_even() {
        let (stamps, truth) = in_bursts(1000, 0.2);
        let times = even(&stamps, StampPolicy::Auto);
        assert_eq!(times.len(), stamps.len());
        for (time, truth) in times.iter().zip(&truth).skip(200) {
            let error = time.seconds_since(*truth);
            assert!(error.abs() < 0.25, "{error}");
        }
        let steps: Vec<f64> = times.windows(2).skip(200).map(|w| w[1].seconds_since(w[0])).collect();
        assert!(steps.iter().all(|s| (0.1..0.4).contains(s)), "{steps:?}");
    }

    #[test]
    fn a_clock_of_whole_seconds_keeps_all_messages() {
        let stamps: Vec<Time> = (0..1000).map(|k| at((0.2 * f64::from(k)).floor())).collect();
        let mut even = EvenStamps::new(StampPolicy::Auto).with_disturbed_period(Some(0.2));
        assert!(stamps.iter().all(|stamp| even.holds(*stamp, &message())));
        let times: Vec<Time> = std::iter::from_fn(|| even.pop(Time::MAX)).map(|(_, _, time)| time).collect();
        assert!(times.len() == stamps.len() && times.is_sorted_by(|a, b| a < b));
        assert!(times.iter().zip(&stamps).all(|(time, stamp)| time.seconds_since(*stamp).abs() < 1.0));
    }

    #[test]
    fn a_sensor_that_falls_silent_does_not_keep_its_last_messages() {
        let mut even = EvenStamps::new(StampPolicy::Auto).with_disturbed_period(Some(0.2));
        assert!(even.holds(at(0.0), &message()) && even.holds(at(0.2), &message()));
        assert!(even.pop(at(LOOK_AHEAD)).is_none());
        let mut left = || std::iter::from_fn(|| even.pop(at(LOOK_AHEAD + 0.1))).count();
        assert_eq!((left(), left()), (2, 0));
    }

    #[test]
    fn steady_stamps_with_gaps_and_rests_are_kept() {
        let mut stamps: Vec<Time> =
            (0..2000).map(|k| at(0.2 * f64::from(k) + 0.003 * f64::from(k % 7))).collect();
        stamps.drain(300..420);
        stamps.drain(900..903);
        assert_eq!(even(&stamps, StampPolicy::Auto), stamps);
        let thinned: Vec<Time> = (0..500).map(|k| at(4.0 * f64::from(k) + 3.5 * f64::from(k % 2))).collect();
        assert_eq!(even(&thinned, StampPolicy::Regular), thinned);
        let (bursts, _) = in_bursts(500, 0.2);
        assert_eq!(even(&bursts, StampPolicy::AsIs), bursts);
    }

    proptest! {
        #[test]
        fn times_ascend_and_no_message_is_lost(delays in prop::collection::vec(0.0f64..1.5, 100..600)) {
            let stamps: Vec<Time> =
                delays.iter().enumerate().map(|(k, delay)| at(0.1 * k as f64 + delay)).collect();
            prop_assert_eq!(even(&stamps, StampPolicy::Regular).len(), stamps.len());
            let mut even = EvenStamps::new(StampPolicy::Regular);
            let mut times = Vec::new();
            for (i, stamp) in stamps.iter().enumerate() {
                even.holds(*stamp, &message());
                let now = if i + 1 == stamps.len() { Time::MAX } else { Time::MIN };
                times.extend(std::iter::from_fn(|| even.pop(now)).map(|(_, _, time)| time));
            }
            prop_assert!(times.is_sorted_by(|a, b| a < b));
        }
    }
}
