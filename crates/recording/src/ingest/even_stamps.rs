//! Stamps that say when a message was handed on instead of when it was measured.
//!
//! A scanner measures at a steady rate. A busy computer between it and the recording stamps several of its
//! messages in one go, after some time of nothing, and may even mix up their stamps: the order of arrival
//! is right, the stamps are true times plus a delay that is never negative. The true time of message `k` is
//! then at most `min over j >= k of (stamp_j - (j - k) * period)`, and close to that wherever one of the
//! next messages came without delay (the lower envelope of Moon, Skelly and Towsley 1999 for clocks of
//! networks, with the order of arrival as the device's own clock).

use std::collections::VecDeque;

use portolan_geometry::{Duration, Time};

use super::statistics::quantile;
use crate::RecordedMessage;

/// How stamps of scanners and odometry are taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum StampPolicy {
    /// As they are, unless they come in bursts or go back.
    #[default]
    Auto,
    /// As they are.
    AsIs,
    /// Always as a steady rate and the order of arrival tell.
    Regular,
}

/// So many stamps of the recent past decide whether they are steady.
const WINDOW: usize = 200;
/// Fewer do not.
const ENOUGH: usize = 60;
/// The mean interval is taken over so many messages.
const MEAN_OVER: usize = 50;
/// Means that differ by more than this factor are of no steady sensor.
const STEADY: f64 = 2.0;
/// Messages closer than this share of the period came in a burst.
const BURST: f64 = 0.25;
/// Share of messages in bursts, or with earlier stamps than the one before, from which stamps are not believed.
/// Real logs with good stamps have at most 0.03 in any window (odometry of aces), intel 0.17 to 0.87.
const MOST_IN_BURSTS: f64 = 0.1;
/// Slower sensors are triggered or thinned out: no rate is to be expected of them, seconds.
const LONGEST_PERIOD: f64 = 1.0;
/// Later messages of so many seconds are looked at for one that came without delay, but not more than so many.
/// (Other sensors are waited for up to 2 s.)
const LOOK_AHEAD: f64 = 1.5;
const MOST_AHEAD: usize = 64;
/// Times are taken to be this much closer than the mean interval, since some messages are lost.
const FASTER_THAN_MEAN: f64 = 0.97;

/// What the stamps of one sensor are like, in order of arrival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StampPattern {
    /// Usual interval, seconds.
    pub period: f64,
    /// Share of messages in bursts or with earlier stamps than the one before.
    pub disturbed: f64,
}

impl StampPattern {
    /// Of a sensor that measures at a steady rate; none for others, and for too few stamps.
    pub fn of(stamps: &[Time]) -> Option<Self> {
        let mean_over = MEAN_OVER.min(stamps.len() / 4);
        if stamps.len() < ENOUGH {
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
        let close = |(a, b): &(&Time, &Time)| b > a && b.seconds_since(**a) < BURST * period;
        let bunched = sorted.iter().zip(sorted.iter().skip(1)).filter(close).count();
        Some(Self { period, disturbed: (backward + bunched) as f64 / intervals })
    }

    /// Whether stamps like these do not tell when it was measured.
    pub fn is_disturbed(&self) -> bool {
        self.disturbed > MOST_IN_BURSTS
    }
}

/// Follows the stamps of one sensor and, while they do not tell when it was measured, makes them even.
#[derive(Debug)]
pub(crate) struct EvenStamps {
    policy: StampPolicy,
    /// The newest stamps as they came.
    recent: VecDeque<Time>,
    since_judged: usize,
    /// Seconds between messages, once stamps are not believed any more.
    period: Option<f64>,
    waiting: VecDeque<(Time, RecordedMessage)>,
    last: Option<Time>,
}

impl EvenStamps {
    pub fn new(policy: StampPolicy) -> Self {
        Self {
            policy,
            recent: VecDeque::new(),
            since_judged: 0,
            period: None,
            waiting: VecDeque::new(),
            last: None,
        }
    }

    /// Takes the stamp of a message. False if it can be used as it is at once; else the message waits.
    pub fn holds(&mut self, stamp: Time, message: &RecordedMessage) -> bool {
        if self.policy == StampPolicy::AsIs {
            return false;
        }
        self.recent.push_back(stamp);
        if self.recent.len() > WINDOW {
            self.recent.pop_front();
        }
        self.since_judged += 1;
        if self.since_judged >= ENOUGH / 2 {
            self.since_judged = 0;
            self.judge();
        }
        if self.period.is_none() {
            self.last = self.last.max(Some(stamp));
            return false;
        }
        // A repeated message is not another measurement.
        if self.waiting.back().is_none_or(|(last, _)| *last != stamp) {
            self.waiting.push_back((stamp, message.clone()));
        }
        true
    }

    /// Once in doubt, stamps stay in doubt: good ones lie on the envelope and are not changed much.
    fn judge(&mut self) {
        let Some(pattern) = StampPattern::of(self.recent.make_contiguous()) else { return };
        if self.period.is_some() || pattern.is_disturbed() || self.policy == StampPolicy::Regular {
            self.period = Some(FASTER_THAN_MEAN * pattern.period);
        }
    }

    /// The next message whose time is known, with the stamp that it came with and its time.
    pub fn pop(&mut self, at_end: bool) -> Option<(RecordedMessage, Time, Time)> {
        let period = self.period?;
        let ahead = MOST_AHEAD.min((LOOK_AHEAD / period) as usize + 1);
        if self.waiting.is_empty() || (self.waiting.len() < ahead && !at_end) {
            return None;
        }
        let latest = (0u32..)
            .zip(self.waiting.iter().take(ahead))
            .map(|(later, (stamp, _))| *stamp - Duration::from_seconds(f64::from(later) * period));
        let latest = latest.min()?;
        let (stamp, message) = self.waiting.pop_front()?;
        let earliest = self.last.map_or(Time::MIN, |last| last + Duration::from_seconds(BURST * period));
        let time = latest.max(earliest);
        self.last = Some(time);
        Some((message, stamp, time))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use proptest::prelude::*;

    use super::*;
    use crate::{Message, TfMessage};

    fn at(seconds: f64) -> Time {
        Time::from_unix_seconds(1e9) + Duration::from_seconds(seconds)
    }

    fn message() -> RecordedMessage {
        let message = Message::Tf(TfMessage { is_static: false, transforms: Vec::new() });
        RecordedMessage { topic: Arc::from("/scan"), log_time: at(0.0), message }
    }

    /// Times as they come out, for messages with these stamps.
    fn even(stamps: &[Time], policy: StampPolicy) -> Vec<Time> {
        let mut even = EvenStamps::new(policy);
        let mut times = Vec::new();
        for stamp in stamps {
            if !even.holds(*stamp, &message()) {
                times.push(*stamp);
            }
            times.extend(std::iter::from_fn(|| even.pop(false)).map(|(_, _, time)| time));
        }
        times.extend(std::iter::from_fn(|| even.pop(true)).map(|(_, _, time)| time));
        times
    }

    /// A computer that hands on what has come by then now and then.
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
    fn steady_stamps_with_gaps_and_rests_stay_as_they_are() {
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
        fn times_ascend_and_nothing_is_lost(delays in prop::collection::vec(0.0f64..1.5, 100..600)) {
            let stamps: Vec<Time> =
                delays.iter().enumerate().map(|(k, delay)| at(0.1 * k as f64 + delay)).collect();
            prop_assert_eq!(even(&stamps, StampPolicy::Regular).len(), stamps.len());
            let mut even = EvenStamps::new(StampPolicy::Regular);
            let mut times = Vec::new();
            for (i, stamp) in stamps.iter().enumerate() {
                even.holds(*stamp, &message());
                let at_end = i + 1 == stamps.len();
                times.extend(std::iter::from_fn(|| even.pop(at_end)).map(|(_, _, time)| time));
            }
            prop_assert!(times.is_sorted_by(|a, b| a < b));
        }
    }
}
