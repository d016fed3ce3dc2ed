//! Reads logs of CoreSLAM (`.dat`): a wheeled robot with a Hokuyo URG-04LX.
//!
//! One line per scan, numbers separated by spaces: the time in microseconds, a voltage, the encoder ticks of
//! the left and of the right wheel since the start, 21 more values that mapping does not need, then 682
//! ranges in millimetres, counter-clockwise over 240°. Readings below 20 are error codes of the scanner, not
//! returns.
//!
//! The log does not contain the dimensions of the robot. Its builders published wheels of 77 mm radius, 165
//! mm from the middle of the axle, 2000 ticks per revolution, and the scanner 145 mm ahead of the axle. Scan
//! matching gives the same within a few per cent (2.2e-4 to 2.4e-4 m per tick, 7.1e-4 rad per tick of
//! difference, 0.14 m).
//!
//! This file is an example of everything that a format needs: recognise it, read it once for its topics, and
//! return [`RecordedMessage`]s in order of time. Every line that could not be used is counted.

use std::collections::VecDeque;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

use portolan_geometry::{Duration, Time, normalize_angle};

use crate::text::{Lines, TextFile};
use crate::{
    Header, LaserScan, Message, MessageReader, Odometry, Pose, RecordedMessage, Recording, RecordingError,
    TfMessage, TopicInfo, TransformStamped,
};
use portolan_issue::{Issue, IssueKind, IssueLog};

/// Columns before the ranges.
const HEADER_COLUMNS: usize = 25;
const BEAMS: usize = 682;
const METRES_PER_TICK: f64 = 2.0 * PI * 0.077 / 2000.0;
const TRACK: f64 = 2.0 * 0.165;
const LASER_AHEAD: f64 = 0.145;
/// Angle between beams, radians; beam 340 of the 682 points straight ahead.
const INCREMENT: f64 = PI / 512.0;
const START_ANGLE: f64 = -340.0 * INCREMENT;
/// Offset of the stamps, as for CARMEN logs: the clock of the log counts from the start of the robot.
const CLOCK_START: Time = Time::from_ros(1_000_000_000, 0);

/// One line of the log.
#[derive(Clone, Debug, PartialEq)]
struct Record {
    stamp: Time,
    left_ticks: i64,
    right_ticks: i64,
    ranges: Vec<f32>,
}

fn parse_line(line: &[u8]) -> Option<Record> {
    let text = std::str::from_utf8(line).ok()?;
    let mut columns = text.split_ascii_whitespace();
    let microseconds: i64 = columns.next()?.parse().ok()?;
    let _voltage: f64 = columns.next()?.parse().ok()?;
    let left_ticks = columns.next()?.parse().ok()?;
    let right_ticks = columns.next()?.parse().ok()?;
    for _ in 4..HEADER_COLUMNS {
        let _: f64 = columns.next()?.parse().ok()?;
    }
    let mut ranges = Vec::with_capacity(BEAMS);
    for column in columns {
        let millimetres: u16 = column.parse().ok()?;
        if ranges.len() == BEAMS {
            return None;
        }
        ranges.push(f32::from(millimetres) / 1000.0);
    }
    let stamp = CLOCK_START + Duration::from_ticks(microseconds.checked_mul(10)?);
    (ranges.len() == BEAMS).then_some(Record { stamp, left_ticks, right_ticks, ranges })
}

/// Whether a text begins like a CoreSLAM log.
pub fn looks_like_coreslam(prefix: &[u8]) -> bool {
    prefix.split(|b| *b == b'\n').take(3).any(|line| parse_line(line).is_some())
}

/// A CoreSLAM log.
pub struct CoreSlamLog {
    file: TextFile,
    time_range: (Time, Time),
    count: u64,
}

impl CoreSlamLog {
    /// Opens a log and reads it once. Fails if no line is one of CoreSLAM.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::of(TextFile::open(path)?)
    }

    pub(crate) fn of(file: TextFile) -> Result<Self, RecordingError> {
        let mut lines = file.lines()?;
        let mut time_range: Option<(Time, Time)> = None;
        let mut count = 0;
        while let Some(line) = lines.next_line()? {
            if let Some(record) = parse_line(line) {
                let (first, last) = time_range.unwrap_or((record.stamp, record.stamp));
                time_range = Some((first, last.max(record.stamp)));
                count += 1;
            }
        }
        let Some(time_range) = time_range else {
            return Err(RecordingError::UnknownFormat {
                path: file.path().to_owned(),
                detail: format!(
                    "no line has {HEADER_COLUMNS} values and {BEAMS} ranges as CoreSLAM logs have"
                ),
            });
        };
        Ok(Self { file, time_range, count })
    }
}

impl Recording for CoreSlamLog {
    fn format(&self) -> String {
        format!("CoreSLAM log{}", self.file.compression_name())
    }

    fn topics(&self) -> Vec<TopicInfo> {
        let info = |topic: &str, type_name: &str, count| TopicInfo {
            topic: topic.into(),
            type_name: type_name.into(),
            count: Some(count),
        };
        vec![
            info("/odom", "nav_msgs/Odometry", self.count),
            info("/scan", "sensor_msgs/LaserScan", self.count),
            info("/tf_static", "tf2_msgs/TFMessage", 1),
        ]
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        Some(self.time_range)
    }

    fn size_bytes(&self) -> u64 {
        self.file.size_bytes()
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let topics: Vec<Arc<str>> =
            self.topics().iter().filter(|t| wanted(t)).map(|t| t.topic.clone()).collect();
        let mut reader = CoreSlamReader {
            lines: self.file.lines()?,
            wanted: topics,
            wheels: Wheels::default(),
            ready: VecDeque::new(),
            newest: Time::MIN,
            issues: IssueLog::default(),
        };
        reader.give("/tf_static", self.time_range.0, laser_on_robot(self.time_range.0));
        Ok(Box::new(reader))
    }
}

struct CoreSlamReader {
    lines: Lines,
    wanted: Vec<Arc<str>>,
    wheels: Wheels,
    ready: VecDeque<RecordedMessage>,
    newest: Time,
    issues: IssueLog,
}

impl CoreSlamReader {
    fn give(&mut self, topic: &str, log_time: Time, message: Message) {
        if let Some(topic) = self.wanted.iter().find(|t| ***t == *topic) {
            self.ready.push_back(RecordedMessage { topic: topic.clone(), log_time, message });
        }
    }

    fn take_record(&mut self, record: Record) {
        if record.stamp <= self.newest {
            self.issues.add(IssueKind::LineNotLater);
            return;
        }
        self.newest = record.stamp;
        let pose = self.wheels.advance(record.left_ticks, record.right_ticks);
        self.give("/odom", record.stamp, odometry(record.stamp, pose));
        self.give("/scan", record.stamp, laser_scan(record.stamp, record.ranges));
    }
}

impl MessageReader for CoreSlamReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        loop {
            if let Some(message) = self.ready.pop_front() {
                return Ok(Some(message));
            }
            let Some(line) = self.lines.next_line()? else {
                if let Some(damage) = self.lines.damage() {
                    self.issues.add(Issue::new(IssueKind::DamagedCompressedText).with("error", damage));
                }
                return Ok(None);
            };
            let empty = line.iter().all(u8::is_ascii_whitespace);
            match parse_line(line) {
                Some(record) => self.take_record(record),
                None if empty => {}
                None => self.issues.add(IssueKind::UnreadableLine),
            }
        }
    }

    fn position_bytes(&self) -> u64 {
        self.lines.position_bytes()
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}

/// Dead reckoning with a differential drive.
#[derive(Clone, Copy, Debug, Default)]
struct Wheels {
    last_ticks: Option<(i64, i64)>,
    /// x, y (metres), heading (radians).
    pose: [f64; 3],
}

impl Wheels {
    /// The pose when the wheel encoders have reached these counts: the arc about the middle of the axle is
    /// replaced by a straight step along the mean heading.
    fn advance(&mut self, left_ticks: i64, right_ticks: i64) -> [f64; 3] {
        let (left, right) = self
            .last_ticks
            .replace((left_ticks, right_ticks))
            .map_or((0, 0), |(l, r)| (left_ticks.saturating_sub(l), right_ticks.saturating_sub(r)));
        let (left, right) = (left as f64 * METRES_PER_TICK, right as f64 * METRES_PER_TICK);
        let (forward, turn) = ((left + right) / 2.0, (right - left) / TRACK);
        let [x, y, heading] = self.pose;
        let (sin, cos) = (heading + turn / 2.0).sin_cos();
        self.pose = [x + forward * cos, y + forward * sin, normalize_angle(heading + turn)];
        self.pose
    }
}

fn pose_2d([x, y, heading]: [f64; 3]) -> Pose {
    let (sin, cos) = (heading / 2.0).sin_cos();
    Pose { position: [x, y, 0.0], orientation_xyzw: [0.0, 0.0, sin, cos] }
}

fn laser_on_robot(stamp: Time) -> Message {
    let transform = TransformStamped {
        header: Header { stamp, frame_id: "base_link".into() },
        child_frame_id: "laser".into(),
        transform: pose_2d([LASER_AHEAD, 0.0, 0.0]),
    };
    Message::Tf(TfMessage { is_static: true, transforms: vec![transform] })
}

fn odometry(stamp: Time, pose: [f64; 3]) -> Message {
    Message::Odometry(Odometry {
        header: Header { stamp, frame_id: "odom".into() },
        child_frame_id: "base_link".into(),
        pose: pose_2d(pose),
        pose_covariance: vec![0.0; 36],
        linear_velocity: [0.0; 3],
        angular_velocity: [0.0; 3],
        twist_covariance: vec![0.0; 36],
    })
}

fn laser_scan(stamp: Time, ranges: Vec<f32>) -> Message {
    Message::LaserScan(LaserScan {
        header: Header { stamp, frame_id: "laser".into() },
        angle_min: START_ANGLE as f32,
        angle_max: (START_ANGLE + (BEAMS - 1) as f64 * INCREMENT) as f32,
        angle_increment: INCREMENT as f32,
        time_increment: 0.0,
        scan_time: 0.1,
        range_min: 0.02,
        range_max: 5.6,
        ranges,
        intensities: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn line(microseconds: i64, left: i64, right: i64) -> String {
        let mut text = format!("{microseconds} 14000 {left} {right} 0.5");
        text.push_str(&" 0".repeat(HEADER_COLUMNS - 5));
        text.push_str("  0 1500");
        text.push_str(&" 7".repeat(BEAMS - 2));
        text + "\n"
    }

    fn read(text: &str) -> (Vec<RecordedMessage>, Vec<Issue>) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("exp.dat");
        std::fs::write(&path, text).unwrap();
        let mut reader = CoreSlamLog::open(&path).unwrap().read(&|_| true).unwrap();
        let messages = std::iter::from_fn(|| reader.next_message().unwrap()).collect();
        (messages, reader.issues())
    }

    #[test]
    fn a_quarter_turn_to_the_left() {
        let ticks = (PI / 2.0 * TRACK / 2.0 / METRES_PER_TICK).round() as i64;
        let text = line(100, 10, 10) + "\nnonsense\n" + &line(200, 10 - ticks, 10 + ticks) + &line(200, 0, 0);
        let (messages, issues) = read(&text);
        assert_eq!(messages.len(), 5);
        let Message::Odometry(odometry) = &messages[3].message else { panic!() };
        assert_eq!(odometry.header.stamp, Time::from_ros(1_000_000_000, 200_000));
        assert!((odometry.pose.orientation_xyzw[2] - 0.5f64.sqrt()).abs() < 1e-3);
        let Message::LaserScan(scan) = &messages[4].message else { panic!() };
        assert_eq!((scan.ranges.len(), scan.ranges[1]), (BEAMS, 1.5));
        assert_eq!(issues.iter().map(|r| r.count).sum::<u64>(), 2);
    }

    proptest! {
        #[test]
        fn random_text_never_panics(text in "([0-9. -]{0,40}\n){0,30}", cut in 0usize..4000) {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("exp.dat");
            let mut all = line(5, 1, 2) + &text + &line(9, i64::MAX, i64::MIN) + &line(i64::MAX / 10, 0, 1);
            all.truncate(cut);
            std::fs::write(&path, all).unwrap();
            if let Ok(log) = CoreSlamLog::open(&path) {
                let mut reader = log.read(&|_| true).unwrap();
                while reader.next_message().unwrap().is_some() {}
            }
        }
    }
}
