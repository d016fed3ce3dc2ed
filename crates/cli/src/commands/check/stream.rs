//! Times of one topic: order, gaps, overlaps, repetitions, clock.

use portolan_geometry::Time;
use portolan_recording::{Header, LaserScan, Message, RecordedMessage};

use super::finding::{Findings, Kind, Severity};
use super::fingerprint::fingerprint;

const BACKWARDS: Kind = Kind {
    name: "backwards",
    severity: Severity::Error,
    effect: "messages that come after later ones cannot be used and are left out",
    advice: "sort the recording by stamp, or mend the clock of the driver",
};
const SAME_STAMP: Kind = Kind {
    name: "same stamp",
    severity: Severity::Warning,
    effect: "of messages with the same stamp only one can be used",
    advice: "look for a driver that runs twice, or stamps in too large steps",
};
const REPEATED: Kind = Kind {
    name: "repeated",
    severity: Severity::Warning,
    effect: "the sensor seems to stand still, which pulls the map out of shape",
    advice: "record the sensor itself instead of a node that repeats its last message",
};
const OFTEN_REPEATED: Kind = Kind { name: "often repeated", severity: Severity::Error, ..REPEATED };
const OVERLAP: Kind = Kind {
    name: "overlap",
    severity: Severity::Warning,
    effect: "motion during a sweep is undone with wrong times",
    advice: "check time_increment (or the times of points) against the speed of the scanner",
};
const UNSET: Kind = Kind {
    name: "unset",
    severity: Severity::Warning,
    effect: "the time of recording is used instead, which jitters",
    advice: "let the driver stamp its messages",
};
const JITTER: Kind = Kind {
    name: "jitter",
    severity: Severity::Warning,
    effect: "stamps or the times of recording are unreliable; measurements may be placed at wrong times",
    advice: "let the driver stamp by the clock of the sensor, and look for a busy computer or network",
};
const GAP: Kind = Kind {
    name: "gap",
    severity: Severity::Warning,
    effect: "the motion over the gap has to be guessed",
    advice: "look for lost messages: a full disk, a slow network, a small queue",
};
const MEAN_ACCELERATION: Kind = Kind {
    name: "mean acceleration",
    severity: Severity::Error,
    effect: "the direction of gravity, which everything in space hangs on, is wrong",
    advice: "the acceleration must include gravity and be in m/s^2; in the plane leave the IMU out (--no-imu)",
};
/// Seconds.
const MAX_JITTER: f64 = 0.5;
/// More repeated measurements than this share are an error.
const OFTEN: f64 = 0.01;

/// What a stream carries.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Content {
    Range,
    Imu,
    #[default]
    Other,
}

/// One topic.
#[derive(Default)]
pub struct Stream {
    content: Content,
    count: u64,
    first: Option<Time>,
    last: Option<Time>,
    /// When the last sweep ended.
    sweep_end: Option<Time>,
    /// Seconds.
    longest_overlap: f64,
    /// Longest time between stamps and when it began, seconds.
    longest_gap: Option<(f64, Time)>,
    fingerprint: Option<u64>,
    /// When a measurement first came again, and how many did.
    repeated: Option<(Time, u64)>,
    lag: Lag,
    /// Sum of the lengths of accelerations, m/s², and their number.
    acceleration: (f64, u64),
}

impl Stream {
    /// Mean time from stamp to recording, seconds; none for streams without stamps.
    pub fn mean_lag(&self) -> Option<f64> {
        self.lag.mean()
    }

    /// Whether it carries scans or clouds.
    pub fn is_range(&self) -> bool {
        self.content == Content::Range
    }

    /// Takes a message of the topic.
    pub fn add(
        &mut self,
        recorded: &RecordedMessage,
        header: &Header,
        message: &Message,
        findings: &mut Findings,
    ) {
        let topic = &*recorded.topic;
        self.content = match message {
            Message::Imu(_) => Content::Imu,
            Message::LaserScan(_) | Message::MultiEchoLaserScan(_) | Message::PointCloud2(_) => {
                Content::Range
            }
            _ => Content::Other,
        };
        if let Message::Imu(imu) = message {
            self.acceleration.0 += imu.linear_acceleration.iter().map(|a| a * a).sum::<f64>().sqrt();
            self.acceleration.1 += 1;
        }
        if header.stamp == Time::UNIX_EPOCH {
            findings.add(&UNSET, topic, || format!("messages on {topic} have no stamp"));
            return;
        }
        self.lag.add(recorded.log_time.seconds_since(header.stamp));
        let is_later = self.check_order(topic, header.stamp, findings);
        if self.is_range() {
            self.check_repetition(header.stamp, message);
            if is_later {
                self.check_overlap(header.stamp, message);
            }
        }
        if is_later {
            self.count += 1;
            self.first.get_or_insert(header.stamp);
            self.last = Some(header.stamp);
        }
    }

    /// Whether the stamp is after the last one.
    fn check_order(&mut self, topic: &str, stamp: Time, findings: &mut Findings) -> bool {
        let Some(last) = self.last else { return true };
        let gap = stamp.seconds_since(last);
        if gap < 0.0 {
            let what = || format!("{topic} jumps back by {:.3} s at {}", -gap, stamp.unix_decimal());
            findings.add(&BACKWARDS, topic, what);
        } else if gap == 0.0 {
            findings
                .add(&SAME_STAMP, topic, || format!("{topic} repeats the stamp {}", stamp.unix_decimal()));
        } else if self.longest_gap.is_none_or(|(longest, _)| gap > longest) {
            self.longest_gap = Some((gap, last));
        }
        gap > 0.0
    }

    fn check_repetition(&mut self, stamp: Time, message: &Message) {
        let fingerprint = fingerprint(message);
        if fingerprint.is_some() && fingerprint == self.fingerprint {
            let (_, count) = self.repeated.get_or_insert((stamp, 0));
            *count += 1;
        }
        self.fingerprint = fingerprint;
    }

    fn check_overlap(&mut self, stamp: Time, message: &Message) {
        if let Some(end) = self.sweep_end {
            self.longest_overlap = self.longest_overlap.max(end.seconds_since(stamp));
        }
        let sweep = match message {
            Message::LaserScan(scan) => sweep_seconds(scan),
            _ => 0.0,
        };
        self.sweep_end = Some(stamp + portolan_geometry::Duration::from_seconds(sweep));
    }

    /// Tells what only the whole stream shows.
    pub fn finish(&self, topic: &str, findings: &mut Findings) {
        if self.longest_overlap > 1e-4 {
            findings.add(&OVERLAP, topic, || {
                format!("sweeps on {topic} end up to {:.4} s after the next one begins", self.longest_overlap)
            });
        }
        let spread = self.lag.spread();
        if spread > MAX_JITTER {
            let what = || format!("the time from stamp to recording of {topic} varies by {spread:.3} s");
            findings.add(&JITTER, topic, what);
        }
        if let Some((at, count)) = self.repeated {
            let often = count as f64 > OFTEN * self.count as f64;
            findings.add(if often { &OFTEN_REPEATED } else { &REPEATED }, topic, || {
                format!(
                    "{count} of {} measurements on {topic} are exactly those before, the first at {}",
                    self.count,
                    at.unix_decimal()
                )
            });
        }
        self.check_mean_acceleration(topic, findings);
        self.check_gap(topic, findings);
    }

    fn check_mean_acceleration(&self, topic: &str, findings: &mut Findings) {
        let (sum, count) = self.acceleration;
        let mean = sum / count as f64;
        if count > 0 && !(9.5..=10.5).contains(&mean) {
            findings.add(&MEAN_ACCELERATION, topic, || {
                format!("{topic} measures {mean:.3} m/s^2 on average; 9.5 to 10.5 m/s^2 are plausible")
            });
        }
    }

    fn check_gap(&self, topic: &str, findings: &mut Findings) {
        let (Some((gap, at)), Some(first), Some(last)) = (self.longest_gap, self.first, self.last) else {
            return;
        };
        if self.count < 3 {
            return;
        }
        let usual = (last.seconds_since(first) - gap) / (self.count - 2) as f64;
        let limit = if self.content == Content::Imu { 0.05 } else { 0.1 };
        // What a slow sensor does all the time is no gap.
        if gap < limit || gap < 2.5 * usual {
            return;
        }
        findings.add(&GAP, topic, || {
            format!(
                "{topic} has a gap of {gap:.3} s after {}; usually a message comes every {usual:.3} s",
                at.unix_decimal()
            )
        });
    }
}

/// Times from stamp to recording, seconds.
#[derive(Default)]
struct Lag {
    count: u64,
    sum: f64,
    bounds: Option<(f64, f64)>,
}

impl Lag {
    fn add(&mut self, lag: f64) {
        self.count += 1;
        self.sum += lag;
        let (low, high) = self.bounds.unwrap_or((lag, lag));
        self.bounds = Some((low.min(lag), high.max(lag)));
    }

    fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }

    fn spread(&self) -> f64 {
        self.bounds.map_or(0.0, |(low, high)| high - low)
    }
}

/// Seconds from the first to the last beam; zero for what makes no sense.
fn sweep_seconds(scan: &LaserScan) -> f64 {
    let seconds = f64::from(scan.time_increment) * scan.ranges.len().saturating_sub(1) as f64;
    if (0.0..1e3).contains(&seconds) { seconds } else { 0.0 }
}
