//! One pass over a CARMEN log: lines become messages in order of time.

use std::collections::BTreeSet;
use std::sync::Arc;

use portolan_geometry::Time;

use super::geometry::{MINIMUM_RANGE, scan_geometry};
use super::line::{LaserLine, Line, Pose2d, parse_line};
use super::reorder::Reorder;
use super::survey::Survey;
use super::{Layout, OdometrySource};
use crate::text::{Lines, TextFile};
use crate::{
    Header, LaserScan, Message, MessageReader, Odometry, Pose, RecordedMessage, RecordingError, TfMessage,
    TopicInfo, TransformStamped,
};
use portolan_issue::{Issue, IssueKind, IssueLog};

const MAX_UNUSED_KINDS: usize = 50;

/// A message that waits for its place in the order of time, with the index of its topic.
type Waiting = (usize, Message);

/// A topic of the log.
struct Output {
    topic: Arc<str>,
    is_wanted: bool,
    last: Option<Message>,
}

/// Index of odometry among the topics; the scanners follow.
const ODOMETRY: usize = 0;

pub(super) struct CarmenReader {
    lines: Lines,
    queue: MessageQueue,
    static_transforms: Option<RecordedMessage>,
    ended: bool,
}

/// Turns lines into messages, and holds each until its place in the order of time is certain.
struct MessageQueue {
    layout: Arc<Layout>,
    /// In the order of messages with equal times: odometry, then the scanners.
    outputs: Vec<Output>,
    frames: Frames,
    reorder: Reorder<Waiting>,
    newest: Time,
    unused: BTreeSet<String>,
    issues: IssueLog,
}

struct Frames {
    odom: Arc<str>,
    base: Arc<str>,
}

impl CarmenReader {
    pub fn new(
        file: &TextFile,
        layout: Arc<Layout>,
        wanted: &dyn Fn(&TopicInfo) -> bool,
    ) -> Result<Self, RecordingError> {
        let wanted_topics: BTreeSet<Arc<str>> =
            layout.topics().iter().filter(|t| wanted(t)).map(|t| t.topic.clone()).collect();
        let topics = std::iter::once("/odom".into()).chain(layout.scanners.iter().map(|s| s.topic.clone()));
        let output = |topic: Arc<str>| {
            let is_wanted = wanted_topics.contains(&topic);
            Output { topic, is_wanted, last: None }
        };
        let outputs: Vec<Output> = topics.map(output).collect();
        let frames = Frames { odom: "odom".into(), base: "base_link".into() };
        let static_transforms =
            if wanted_topics.contains("/tf_static") { static_transforms(&layout, &frames) } else { None };
        Ok(Self {
            lines: file.lines()?,
            ended: !outputs.iter().any(|output| output.is_wanted),
            queue: MessageQueue {
                layout,
                outputs,
                frames,
                reorder: Reorder::default(),
                newest: Time::MIN,
                unused: BTreeSet::new(),
                issues: IssueLog::default(),
            },
            static_transforms,
        })
    }

    /// Reads one line; false at the end.
    fn advance(&mut self) -> Result<bool, RecordingError> {
        if let Some(line) = self.lines.next_line()? {
            self.queue.add_line(line);
            return Ok(true);
        }
        let issues = &mut self.queue.issues;
        if let Some(damage) = self.lines.damage() {
            issues.add(Issue::new(IssueKind::DamagedCompressedText).with("error", damage));
        }
        issues.count(IssueKind::OverlongLine, self.lines.overlong());
        Ok(false)
    }
}

impl MessageQueue {
    fn add_line(&mut self, line: &[u8]) {
        match parse_line(line, true) {
            Line::Empty | Line::Param { .. } => {}
            Line::Bad => self.issues.add(IssueKind::UnreadableLine),
            Line::Unused(name) => {
                if self.unused.len() < MAX_UNUSED_KINDS {
                    self.unused.insert(name.to_owned());
                }
            }
            Line::Odometry { pose, times } => match self.layout.clock.stamp(times) {
                None => self.issues.add(IssueKind::UnreadableLineTime),
                Some(stamp) => self.add_odometry(OdometrySource::OwnLines, stamp, pose),
            },
            Line::Laser { laser, times } => match self.layout.clock.stamp(times) {
                None => self.issues.add(IssueKind::UnreadableLineTime),
                Some(stamp) => self.add_laser(stamp, laser),
            },
        }
    }

    /// Adds an odometry pose, if `source` is the chosen source.
    fn add_odometry(&mut self, source: OdometrySource, stamp: Time, pose: Pose2d) {
        if self.wants(ODOMETRY) && self.layout.odometry == Some(source) {
            let message = odometry(stamp, pose, &self.frames);
            self.push(ODOMETRY, stamp, message, 1024);
        }
    }

    fn add_laser(&mut self, stamp: Time, laser: LaserLine) {
        if let Some((_, robot)) = laser.poses {
            self.add_odometry(OdometrySource::Scans(laser.kind), stamp, robot);
        }
        match self.layout.scanners.iter().enumerate().find(|(_, s)| s.kind == laser.kind) {
            None => self.issues.add(IssueKind::ScanInOtherFormat),
            Some((index, scanner)) if self.wants(index + 1) => {
                let bytes = 256 + 4 * (laser.ranges.len() + laser.remissions.len());
                let message = laser_scan(stamp, laser, &self.layout.survey, scanner.frame.clone());
                self.push(index + 1, stamp, message, bytes);
            }
            Some(_) => {}
        }
    }

    fn wants(&self, topic: usize) -> bool {
        self.outputs.get(topic).is_some_and(|output| output.is_wanted)
    }

    fn push(&mut self, topic: usize, stamp: Time, message: Message, bytes: usize) {
        self.newest = stamp.max(self.newest);
        let time = if self.layout.in_order_of_lines { self.newest } else { stamp };
        if self.reorder.push(time, topic as u32, bytes, (topic, message)) {
            self.issues.add(IssueKind::LinesReordered);
        }
    }

    /// The next message, if its place is certain or `at_end`.
    fn pop(&mut self, at_end: bool) -> Option<RecordedMessage> {
        loop {
            let (log_time, (topic, message), too_late) = self.reorder.pop(at_end)?;
            if too_late {
                self.issues.add(IssueKind::LinesOutOfOrder);
            }
            let Some(output) = self.outputs.get_mut(topic) else { continue };
            // Clocks with a resolution of one second give several measurements the same stamp. A message is
            // only repeated if its values are the same, too.
            if output.last.as_ref() == Some(&message) {
                self.issues.add(IssueKind::RepeatedMessage);
                continue;
            }
            output.last = Some(message.clone());
            return Some(RecordedMessage { topic: output.topic.clone(), log_time, message });
        }
    }
}

impl MessageReader for CarmenReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        if let Some(message) = self.static_transforms.take() {
            return Ok(Some(message));
        }
        loop {
            if let Some(message) = self.queue.pop(self.ended) {
                return Ok(Some(message));
            }
            if self.ended {
                return Ok(None);
            }
            self.ended = !self.advance()?;
        }
    }

    fn position_bytes(&self) -> u64 {
        self.lines.position_bytes()
    }

    fn issues(&self) -> Vec<Issue> {
        let mut issues = self.queue.issues.clone();
        for kind in &self.queue.unused {
            issues.add(Issue::new(IssueKind::UnusedLines).with("kind", kind));
        }
        issues.list()
    }
}

fn static_transforms(layout: &Layout, frames: &Frames) -> Option<RecordedMessage> {
    let transforms: Vec<TransformStamped> = layout
        .scanners
        .iter()
        .filter_map(|scanner| {
            let header = Header { stamp: layout.first_time, frame_id: frames.base.clone() };
            let transform = pose_2d(scanner.mounting?);
            Some(TransformStamped { header, child_frame_id: scanner.frame.clone(), transform })
        })
        .collect();
    let message = Message::Tf(TfMessage { is_static: true, transforms: transforms.clone() });
    let topic = "/tf_static".into();
    (!transforms.is_empty()).then_some(RecordedMessage { topic, log_time: layout.first_time, message })
}

fn pose_2d([x, y, heading]: Pose2d) -> Pose {
    let (sin, cos) = (heading / 2.0).sin_cos();
    Pose { position: [x, y, 0.0], orientation_xyzw: [0.0, 0.0, sin, cos] }
}

fn odometry(stamp: Time, pose: Pose2d, frames: &Frames) -> Message {
    Message::Odometry(Odometry {
        header: Header { stamp, frame_id: frames.odom.clone() },
        child_frame_id: frames.base.clone(),
        pose: pose_2d(pose),
        pose_covariance: vec![0.0; 36],
        linear_velocity: [0.0; 3],
        angular_velocity: [0.0; 3],
        twist_covariance: vec![0.0; 36],
    })
}

fn laser_scan(stamp: Time, laser: LaserLine, survey: &Survey, frame_id: Arc<str>) -> Message {
    let geometry = scan_geometry(laser.kind, laser.config.as_ref(), laser.count, survey);
    Message::LaserScan(LaserScan {
        header: Header { stamp, frame_id },
        angle_min: geometry.start as f32,
        angle_max: geometry.end(laser.count) as f32,
        angle_increment: geometry.increment as f32,
        time_increment: 0.0,
        scan_time: 0.0,
        range_min: MINIMUM_RANGE,
        range_max: geometry.range_max,
        ranges: laser.ranges,
        intensities: laser.remissions,
    })
}

#[cfg(test)]
mod tests {
    use crate::carmen::{CarmenLog, CarmenOptions, TimeColumn};
    use portolan_issue::{Issue, IssueKind};

    use crate::{Message, RecordedMessage, Recording};

    fn read(text: &str, time_column: TimeColumn) -> (Vec<RecordedMessage>, Vec<Issue>) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.log");
        std::fs::write(&path, text).unwrap();
        let log = CarmenLog::open(&path, CarmenOptions { time_column }).unwrap();
        let topics = log.topics();
        assert!(topics.is_sorted_by(|a, b| a.topic < b.topic));
        let mut reader = log.read(&|_| true).unwrap();
        let messages = std::iter::from_fn(|| reader.next_message().unwrap()).collect();
        (messages, reader.issues())
    }

    fn topics(messages: &[RecordedMessage]) -> Vec<&str> {
        messages.iter().map(|m| &*m.topic).collect()
    }

    #[test]
    fn odometry_comes_from_scans_where_there_is_no_other() {
        let text = "FLASER 2 1.0 2.0 0.2 0 0 0.1 0 0 1300000001.5 host 1.5\n\
                    RLASER 2 1.0 2.0 0 0 3.1415926 0.1 0 0 1300000001.2 host 1.6\n\
                    FLASER 2 1.0 2.0 1.1 1.1 1.5707963 1.1 1 1.5707963 1300000002.5 host 2.5\n";
        let (messages, issues) = read(text, TimeColumn::Ipc);
        assert_eq!(topics(&messages), ["/tf_static", "/rear_scan", "/odom", "/scan", "/odom", "/scan"]);
        assert_eq!(messages[2].log_time.unix_decimal(), "1300000001.5000000");
        let Message::Tf(tf) = &messages[0].message else { panic!() };
        assert!((tf.transforms[0].transform.position[0] - 0.1).abs() < 1e-9);
        assert!((tf.transforms[1].transform.position[0] + 0.1).abs() < 1e-9);
        assert!((tf.transforms[1].transform.orientation_xyzw[2].abs() - 1.0).abs() < 1e-6);
        assert_eq!((issues.len(), issues[0].lost_data()), (1, false));
        let (messages, _) = read(text, TimeColumn::Logger);
        assert_eq!(topics(&messages), ["/tf_static", "/odom", "/scan", "/rear_scan", "/odom", "/scan"]);
        assert_eq!(messages[1].log_time.unix_decimal(), "1000000001.5000000");
    }

    #[test]
    fn the_newer_format_is_preferred_and_has_its_geometry() {
        let robot = "ROBOTLASER1 0 -2.0 4.0 2.0 8.0 0.01 1 3 1.0 8.0 9.0 3 7 8 9 0.1 0 0 0 0 0 0 0 0 0 0";
        let text = format!(
            "FLASER 3 1 2 3 0 0 0 0 0 0 5.0 host 0.0\n{robot} 5.0 host 0.0\nTRUEPOS 0 0 0 0 0 0 5.1 h 1\nbroken \u{1}\n"
        );
        let (messages, issues) = read(&text, TimeColumn::Ipc);
        assert_eq!(topics(&messages), ["/tf_static", "/odom", "/scan"]);
        let Message::LaserScan(scan) = &messages[2].message else { panic!() };
        assert_eq!((scan.angle_min, scan.angle_max, scan.angle_increment), (-2.0, 2.0, 2.0));
        assert_eq!(scan.ranges, [1.0, 8.0, 9.0]);
        assert_eq!(scan.intensities, [7.0, 8.0, 9.0]);
        assert!(scan.range_max < 8.0, "a reading of the maximum saw nothing");
        assert!(issues.iter().any(|r| r.text().contains("TRUEPOS")));
        assert!(issues.iter().any(|r| r.lost_data() && r.kind == IssueKind::UnreadableLine));
    }

    #[test]
    fn impossible_stamps_are_left_out_wherever_they_stand() {
        let odometry = |stamp: &str| format!("ODOM 1 0 0 0 0 0 {stamp} host 1.0\n");
        for [bad, good, expected] in [
            ["1e300", "1300000001.5", "1300000001.5000000"],
            ["99999999999999999", "1300000001.5", "1300000001.5000000"],
            ["-5", "1300000001.5", "1300000001.5000000"],
            ["nan", "1300000001.5", "1300000001.5000000"],
            ["1e12", "1.5", "1000000001.5000000"],
        ] {
            for lines in [[bad, good], [good, bad]] {
                let (messages, issues) = read(&lines.map(odometry).concat(), TimeColumn::Ipc);
                assert_eq!(topics(&messages), ["/odom"], "{lines:?}");
                assert_eq!(messages[0].log_time.unix_decimal(), expected, "{lines:?}");
                assert_eq!((issues.len(), issues[0].kind), (1, IssueKind::UnreadableLineTime));
            }
        }
    }

    #[test]
    fn a_log_without_a_possible_stamp_is_refused_for_that() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.log");
        std::fs::write(&path, "ODOM 1 0 0 0 0 0 -1e300 host -1\n").unwrap();
        let error = CarmenLog::open(&path, CarmenOptions::default()).err().unwrap().to_string();
        assert!(error.contains("possible time"), "{error}");
    }
}
