//! Times of one topic: order, gaps, overlaps, repetitions, clock.

use portolan_geometry::Time;
use portolan_recording::{Header, LaserScan, Message, RecordedMessage};

use super::finding::{Findings, Kind, Severity};

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
    severity: Severity::Error,
    effect: "the sensor seems to stand still, which pulls the map out of shape",
    advice: "record the sensor itself instead of a node that repeats its last message",
};
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
const LATE: Kind = Kind {
    name: "late",
    severity: Severity::Warning,
    effect: "sensors of other clocks do not fit in time",
    advice: "synchronise the clocks of sensor and computer",
};
const VERY_LATE: Kind = Kind { name: "very late", severity: Severity::Error, ..LATE };
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
const LONG_GAP: Kind = Kind { name: "long gap", severity: Severity::Error, ..GAP };

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
    /// Sum of the lengths of accelerations, m/s², and their number.
    acceleration: (f64, u64),
}

impl Stream {
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
        self.check_clock(topic, recorded.log_time, header.stamp, findings);
        let is_later = self.check_order(topic, header.stamp, findings);
        if self.is_range() {
            self.check_repetition(topic, header.stamp, message, findings);
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

    fn check_clock(&self, topic: &str, log_time: Time, stamp: Time, findings: &mut Findings) {
        let difference = log_time.seconds_since(stamp);
        let kind = match difference.abs() {
            d if d > 0.5 => &VERY_LATE,
            d if d > 0.1 => &LATE,
            _ => return,
        };
        findings.add(kind, topic, || {
            format!(
                "{topic} was stamped {difference:.3} s before it was recorded (at {})",
                stamp.unix_decimal()
            )
        });
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

    fn check_repetition(&mut self, topic: &str, stamp: Time, message: &Message, findings: &mut Findings) {
        let fingerprint = fingerprint(message);
        if fingerprint.is_some() && fingerprint == self.fingerprint {
            findings.add(&REPEATED, topic, || {
                format!("{topic} sends exactly the same measurement again at {}", stamp.unix_decimal())
            });
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
        let (short, long) = match self.content {
            Content::Imu => (0.05, 0.5),
            Content::Range | Content::Other => (0.1, 1.0),
        };
        // What a slow sensor does all the time is no gap.
        let kind = match gap {
            gap if gap > long && gap > 5.0 * usual => &LONG_GAP,
            gap if gap > short && gap > 2.5 * usual => &GAP,
            _ => return,
        };
        findings.add(kind, topic, || {
            format!(
                "{topic} has a gap of {gap:.3} s after {}; usually a message comes every {usual:.3} s",
                at.unix_decimal()
            )
        });
    }
}

/// Seconds from the first to the last beam; zero for what makes no sense.
fn sweep_seconds(scan: &LaserScan) -> f64 {
    let seconds = f64::from(scan.time_increment) * scan.ranges.len().saturating_sub(1) as f64;
    if (0.0..1e3).contains(&seconds) { seconds } else { 0.0 }
}

/// A number that equal measurements share (FNV-1a); none for a measurement without any return, which may
/// well come again.
fn fingerprint(message: &Message) -> Option<u64> {
    let mut hash = Fingerprint::default();
    match message {
        Message::LaserScan(scan) => scan.ranges.iter().for_each(|range| hash.range(*range)),
        Message::MultiEchoLaserScan(scan) => {
            scan.ranges.iter().flatten().for_each(|range| hash.range(*range));
        }
        Message::PointCloud2(cloud) => {
            hash.returns = cloud.data.iter().any(|byte| *byte != 0);
            let words = cloud.data.chunks(8);
            words.for_each(|word| hash.word(word.iter().fold(0, |all, byte| all << 8 | u64::from(*byte))));
        }
        _ => return None,
    }
    hash.returns.then_some(hash.hash)
}

struct Fingerprint {
    hash: u64,
    returns: bool,
}

impl Default for Fingerprint {
    fn default() -> Self {
        Self { hash: 0xcbf2_9ce4_8422_2325, returns: false }
    }
}

impl Fingerprint {
    fn word(&mut self, word: u64) {
        self.hash = (self.hash ^ word).wrapping_mul(0x0100_0000_01b3);
        self.hash ^= self.hash >> 29;
    }

    fn range(&mut self, range: f32) {
        self.returns |= range.is_finite() && range > 0.0;
        self.word(u64::from(range.to_bits()));
    }
}
