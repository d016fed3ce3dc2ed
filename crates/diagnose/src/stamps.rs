//! Checks the time stamps and recording times of one topic (checks 9, 10, 11, 14 and 15 of `spec/tools.md`
//! §2.6).

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_ingest::LONGEST_PAUSE;
use portolan_issue::Severity;
use portolan_recording::{Header, Message};

use crate::finding::{Findings, Kind};
use crate::histogram::Histogram;

const BACKWARD: Kind = Kind {
    name: "backward",
    severity: Severity::Error,
    effect: "messages that are not later than the one before are left out",
    to_do: "record in the order in which the sensor measures; look for two publishers on one topic",
};
const REPEATED: Kind = Kind {
    name: "repeated stamp",
    severity: Severity::Warning,
    effect: "the second message is left out; nothing is lost if it is the same",
    to_do: "look for two publishers on one topic, or a driver that repeats itself",
};
const UNSET: Kind = Kind {
    name: "unset stamp",
    severity: Severity::Error,
    effect: "the time of recording is used instead, which jitters",
    to_do: "let the driver fill in header.stamp",
};
const LATE: Kind = Kind {
    name: "late",
    severity: Severity::Warning,
    effect: "measurements are placed by poses of the robot that much earlier or later than they were made: rotation blurs the map, prediction and scans disagree",
    to_do: "see that the clocks of the sensors and of the computer agree (PTP, NTP); stamps should be the time of measurement",
};
const VERY_LATE: Kind =
    Kind { name: "very late", severity: Severity::Error, effect: LATE.effect, to_do: LATE.to_do };
const JUMP: Kind = Kind {
    name: "jump",
    severity: Severity::Error,
    effect: "messages far from their time are left out; the jump of a clock that was set is removed from the stamps",
    to_do: "synchronise clocks before recording, not during it",
};
const RANGE_GAP: Kind = Kind {
    name: "range gap",
    severity: Severity::Warning,
    effect: "between two scans the motion is guessed from odometry, IMU or the speed before",
    to_do: "use odometry or an IMU if the sensor is slow; look for dropped messages if it is not",
};
const SLOW: Kind =
    Kind { name: "slow", severity: Severity::Info, effect: RANGE_GAP.effect, to_do: RANGE_GAP.to_do };
const LARGE_RANGE_GAP: Kind = Kind {
    name: "large range gap",
    severity: Severity::Error,
    effect: "the robot may have moved unseen; the map may break here",
    to_do: "look for dropped messages while recording (disk, network, queue sizes)",
};
const IMU_GAP: Kind = Kind {
    name: "IMU gap",
    severity: Severity::Warning,
    effect: "rotation and level are guessed over the gap",
    to_do: "look for dropped messages while recording",
};
const ODOMETRY_GAP: Kind = Kind {
    name: "odometry gap",
    severity: Severity::Warning,
    effect: "motion is guessed over the gap",
    to_do: "look for dropped messages while recording",
};

const SILENT: Kind = Kind {
    name: "silent",
    severity: Severity::Error,
    effect: "from there on the map is made without this sensor; what only it saw is missing",
    to_do: "look for what happened then (cable, power, driver, disk); the rest can be mapped",
};
const LATE_START: Kind = Kind {
    name: "late start",
    severity: Severity::Warning,
    effect: "until then the map is made without this sensor",
    to_do: "start recording when all sensors run",
};
/// Interval between IMU samples above which there is a gap, seconds.
const LONG_INTERVAL: f64 = 0.05;
/// Minimum time at the beginning or the end without a sensor that is reported, seconds.
const SILENCE: f64 = 2.0;
/// Minimum number of usual intervals without a sensor that is reported.
const SILENT_INTERVALS: f64 = 20.0;
/// Ratio of an interval of an IMU to the usual one above which the interval is a gap.
const GAP_INTERVALS: f64 = 5.0;

/// Kind of sensor of a stream, as needed to judge gaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StreamKind {
    Range,
    Imu,
    Odometry,
    Other,
}

impl StreamKind {
    pub fn of(message: &Message) -> Self {
        match message {
            Message::LaserScan(_) | Message::MultiEchoLaserScan(_) | Message::PointCloud2(_) => Self::Range,
            Message::Imu(_) => Self::Imu,
            Message::Odometry(_) => Self::Odometry,
            _ => Self::Other,
        }
    }
}

/// Stamps of one topic.
#[derive(Debug)]
pub(crate) struct Stamps {
    kind: StreamKind,
    frame: Arc<str>,
    first_log_time: Time,
    last_log_time: Time,
    last: Option<Time>,
    /// The latest stamp; it is later than the last one after a jump backwards.
    latest: Time,
    /// Number of intervals longer than a twentieth of a second, and their sum, seconds.
    long_intervals: (u64, f64),
    intervals: Histogram,
    lags: Histogram,
    count: u64,
}

impl Stamps {
    pub fn new(message: &Message, header: &Header, log_time: Time) -> Self {
        Self {
            kind: StreamKind::of(message),
            frame: header.frame_id.clone(),
            first_log_time: log_time,
            last_log_time: log_time,
            last: None,
            latest: Time::MIN,
            long_intervals: (0, 0.0),
            intervals: Histogram::default(),
            lags: Histogram::default(),
            count: 0,
        }
    }

    /// Takes the next message, whose last point was measured at `end`.
    pub fn add(
        &mut self,
        topic: &str,
        (header, end): (&Header, Time),
        log_time: Time,
        findings: &mut Findings,
    ) {
        self.count += 1;
        let stamp = header.stamp;
        let frame = &header.frame_id;
        let log_interval = log_time.seconds_since(self.last_log_time);
        self.last_log_time = log_time;
        if stamp == Time::UNIX_EPOCH && log_time.unix_seconds() > 100.0 {
            return findings.add(&UNSET, topic, || format!("messages of frame_id \"{frame}\" have no stamp"));
        }
        self.lags.add(lag(stamp, end, log_time));
        let latest = self.latest;
        self.latest = latest.max(stamp);
        let Some(last) = self.last.replace(stamp) else { return };
        let interval = stamp.seconds_since(last);
        if (interval - log_interval).abs() > 10.0 && !(0.0..10.0).contains(&interval) {
            findings.add(&JUMP, topic, || {
                format!(
                    "the stamp jumps by {interval:.3} s at {last}, while {log_interval:.3} s were recorded"
                )
            });
            self.latest = stamp;
            return;
        }
        if interval.min(log_interval) > LONGEST_PAUSE {
            // This is no gap: the clock of all stamps was set, which is a finding of the whole recording.
            return;
        }
        if interval < 0.0 {
            findings.add(&BACKWARD, topic, || {
                format!(
                    "sensor with frame_id \"{frame}\" jumps backwards in time, i.e. timestamps are not strictly increasing: {stamp} comes after {last}"
                )
            });
        } else if interval == 0.0 {
            findings.add(&REPEATED, topic, || {
                format!("two messages of frame_id \"{frame}\" have the stamp {stamp}")
            });
        } else {
            // After a stamp that was too early, the gap is counted only from the latest stamp.
            let interval = if stamp > latest { stamp.seconds_since(latest) } else { interval };
            self.intervals.add(interval);
            if interval > LONG_INTERVAL {
                self.long_intervals.0 += 1;
                self.long_intervals.1 += interval;
            }
        }
    }

    /// Median of recording time minus stamp.
    pub fn lag(&self) -> Option<f64> {
        self.lags.median()
    }

    /// First and last recording time, of sensors that measure continuously.
    pub fn span(&self) -> Option<(Time, Time)> {
        (self.kind != StreamKind::Other).then_some((self.first_log_time, self.last_log_time))
    }

    /// Checks whether the sensor is missing at the beginning or the end of the recording.
    pub fn check_span(&self, topic: &str, (start, end): (Time, Time), findings: &mut Findings) {
        if self.kind == StreamKind::Other {
            return;
        }
        let usual = self.intervals.median().unwrap_or(0.0);
        let least = SILENCE.max(SILENT_INTERVALS * usual);
        let silent = end.seconds_since(self.last_log_time);
        if silent > least {
            let lived = self.last_log_time.seconds_since(start);
            findings.add(&SILENT, topic, || {
                format!("the sensor falls silent {lived:.1} s after the start, {silent:.1} s before the end")
            });
        }
        let late = self.first_log_time.seconds_since(start);
        if late > least {
            findings.add(&LATE_START, topic, || format!("the sensor begins {late:.1} s after the start"));
        }
    }

    /// Adds findings about the whole topic. `common_lag` is the lag that all topics of the recording share.
    pub fn finish(&self, topic: &str, common_lag: f64, findings: &mut Findings) {
        if let Some(lag) = self.lag() {
            let differing = lag - common_lag;
            let kind = if differing.abs() > 0.5 { &VERY_LATE } else { &LATE };
            if differing.abs() > 0.1 {
                let frame = &self.frame;
                findings.add(kind, topic, || {
                    format!("frame_id \"{frame}\": serialization time and sensor time differ by {lag:.3} s, those of the other sensors by {common_lag:.3} s")
                });
            }
        }
        let (Some(largest), Some(median)) = (self.intervals.max(), self.intervals.median()) else { return };
        let frame = &self.frame;
        let text = |name: &str, recommended: &str| {
            format!(
                "{name} (frame_id: \"{frame}\") has a large gap, largest is {largest:.3} s ({median:.3} s is usual), recommended is {recommended} s with no jitter"
            )
        };
        match self.kind {
            StreamKind::Range if largest > 1f64.max(5.0 * median) => {
                findings.add(&LARGE_RANGE_GAP, topic, || text("point data", "[0.0005, 0.05]"));
            }
            StreamKind::Range if largest > 0.1 => {
                // A slow sensor without gaps gets no warning.
                let kind = if largest < 1.5 * median { &SLOW } else { &RANGE_GAP };
                findings.add(kind, topic, || text("point data", "[0.0005, 0.05]"));
            }
            StreamKind::Imu if largest > LONG_INTERVAL => {
                let (count, seconds) = self.long_intervals;
                let all = if median * GAP_INTERVALS > LONG_INTERVAL {
                    String::new()
                } else {
                    let gaps = if count == 1 { "gap" } else { "gaps" };
                    format!("; {count} {gaps}, {seconds:.2} s in all")
                };
                findings.add(&IMU_GAP, topic, || text("IMU data", "[0.0005, 0.005]") + &all);
            }
            StreamKind::Odometry if largest > 1f64.max(5.0 * median) => {
                findings.add(&ODOMETRY_GAP, topic, || text("odometry", "[0.005, 0.1]"));
            }
            _ => {}
        }
    }

    /// The distribution of intervals as text for the user.
    pub fn histogram_text(&self, topic: &str) -> Option<String> {
        (!self.intervals.is_empty()).then(|| {
            format!(
                "Time delta histogram for consecutive messages on topic \"{topic}\" (frame_id: \"{}\"):\n{}",
                self.frame,
                self.intervals.to_text()
            )
        })
    }
}

/// Delay from measuring to recording, seconds; 0 if it was recorded during the measurement.
fn lag(stamp: Time, end: Time, log_time: Time) -> f64 {
    log_time.seconds_since(log_time.clamp(stamp.min(end), end.max(stamp)))
}

const SEVERAL_TOPICS: Kind = Kind {
    name: "several topics",
    severity: Severity::Warning,
    effect: "the same scans would count twice; only one of the topics is used unless another is named",
    to_do: "name the topic to use with --scan or --points",
};

/// Finds frames that come on more than one topic of a kind.
pub(crate) fn check_frames<'a>(topics: impl Iterator<Item = (&'a str, &'a Stamps)>, findings: &mut Findings) {
    let mut by_frame: BTreeMap<(&str, u8), Vec<&str>> = BTreeMap::new();
    for (topic, stamps) in topics {
        if stamps.kind != StreamKind::Other && stamps.kind != StreamKind::Odometry {
            by_frame.entry((&stamps.frame, stamps.kind as u8)).or_default().push(topic);
        }
    }
    for (key, topics) in by_frame {
        if topics.len() > 1 {
            findings.add(&SEVERAL_TOPICS, topics[0], || {
                format!("frame_id \"{}\" is sent on multiple topics: {}", key.0, topics.join(", "))
            });
        }
    }
}
