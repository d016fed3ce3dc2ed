//! Drops repeated messages, and old scans under new stamps. Repeats come from drivers that send a message
//! again, and from merged recordings that overlap.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_recording::{
    Header, LaserScan, Message, MessageReader, RecordedMessage, Recording, RecordingError, TopicInfo,
};

/// Approximate number of bytes of a cloud that are compared, evenly spread: two sweeps do not share them by
/// chance.
const COMPARED_BYTES: usize = 4096;
/// Number of readings different from their neighbours above which a scan does not repeat by chance, even at
/// rest: readings have noise.
const READINGS_THAT_DIFFER: usize = 10;

/// One pass over a recording, without the messages of range sensors, IMUs and odometry that repeat the one
/// before on their topic: the same stamp and the same values. They are counted. Scans and clouds with the
/// values of the one before and another stamp are dropped and counted, too: they hold no new measurement.
pub fn read_without_repeats(
    recording: &dyn Recording,
    wanted: &dyn Fn(&TopicInfo) -> bool,
) -> Result<Box<dyn MessageReader>, RecordingError> {
    let reader = recording.read(wanted)?;
    Ok(Box::new(WithoutRepeats { reader, last: BTreeMap::new(), issues: IssueLog::default() }))
}

struct WithoutRepeats {
    reader: Box<dyn MessageReader>,
    last: BTreeMap<Arc<str>, Digests>,
    issues: IssueLog,
}

/// Hashes by which messages are compared.
struct Digests {
    stamp: Time,
    /// Hash of stamp and values; none where stamps are not set.
    message: Option<u64>,
    /// Hash of the values of a scan or a cloud; none where they may be equal by chance.
    scan: Option<u64>,
}

impl WithoutRepeats {
    fn is_repeat(&mut self, message: &RecordedMessage) -> bool {
        let Some(this) = digests(&message.message) else { return false };
        let stamp = this.stamp;
        let last = match self.last.get_mut(&message.topic) {
            Some(last) => std::mem::replace(last, this),
            None => return self.last.insert(message.topic.clone(), this).is_some(),
        };
        let Some(this) = self.last.get(&message.topic) else { return false };
        let kind = if last.message.is_some() && last.message == this.message {
            IssueKind::RepeatedMessage
        } else if last.scan.is_some() && last.scan == this.scan {
            IssueKind::RepeatedScan
        } else {
            return false;
        };
        self.issues.add(Issue::new(kind).of(message.topic.clone()).at(stamp));
        true
    }
}

impl MessageReader for WithoutRepeats {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        loop {
            match self.reader.next_message()? {
                Some(message) if self.is_repeat(&message) => {}
                next => return Ok(next),
            }
        }
    }

    fn position_bytes(&self) -> u64 {
        self.reader.position_bytes()
    }

    fn issues(&self) -> Vec<Issue> {
        let mut issues = self.issues.clone();
        issues.merge(&self.reader.issues());
        issues.list()
    }
}

/// Hashes of the values and of the stamp; none for messages without a stamp, and for other kinds.
fn digests(message: &Message) -> Option<Digests> {
    let mut digest = DefaultHasher::new();
    let (header, is_scan): (&Header, bool) = match message {
        Message::LaserScan(scan) => {
            scan.ranges.iter().for_each(|range| range.to_bits().hash(&mut digest));
            (&scan.header, has_readings(scan))
        }
        Message::MultiEchoLaserScan(scan) => {
            scan.ranges.iter().flatten().for_each(|range| range.to_bits().hash(&mut digest));
            (&scan.header, false)
        }
        Message::PointCloud2(cloud) => {
            (cloud.width, cloud.height, cloud.data.len()).hash(&mut digest);
            let stride = cloud.data.len().div_ceil(COMPARED_BYTES).max(1);
            cloud.data.iter().step_by(stride).for_each(|byte| digest.write_u8(*byte));
            (&cloud.header, cloud.data.len() > COMPARED_BYTES)
        }
        Message::Imu(imu) => {
            let values = imu.linear_acceleration.iter().chain(&imu.angular_velocity);
            values.for_each(|value| value.to_bits().hash(&mut digest));
            (&imu.header, false)
        }
        Message::Odometry(odometry) => {
            let pose = odometry.pose.position.iter().chain(&odometry.pose.orientation_xyzw);
            let twist = odometry.linear_velocity.iter().chain(&odometry.angular_velocity);
            pose.chain(twist).for_each(|value| value.to_bits().hash(&mut digest));
            (&odometry.header, false)
        }
        _ => return None,
    };
    let stamp = header.stamp;
    let scan = is_scan.then(|| digest.finish());
    stamp.hash(&mut digest);
    let message = (stamp != Time::UNIX_EPOCH).then(|| digest.finish());
    Some(Digests { stamp, message, scan })
}

/// Whether a scan has readings with noise, unlike a scan without returns.
fn has_readings(scan: &LaserScan) -> bool {
    let differ = scan
        .ranges
        .windows(2)
        .filter(|two| matches!(two, [a, b] if a.is_finite() && b.is_finite() && a != b));
    differ.take(READINGS_THAT_DIFFER).count() >= READINGS_THAT_DIFFER
}

#[cfg(test)]
mod tests {
    use portolan_recording::{MemoryRecording, RecordingError};

    use super::*;
    use crate::test_messages::{at, named, scan};

    #[test]
    fn the_second_copy_is_left_out_and_counted() -> Result<(), RecordingError> {
        let message = |log: f64, seconds: f64, range: f32| {
            let mut message = scan(seconds, "laser");
            if let Message::LaserScan(scan) = &mut message {
                scan.ranges[7] = range;
                scan.ranges[8] = f32::NAN;
            }
            named("/scan", log, message)
        };
        let messages =
            [(1.0, 1.0, 3.0), (1.01, 1.0, 3.0), (1.02, 1.0, 3.5), (1.1, 1.1, 3.5), (1.11, 1.1, 3.5)];
        let recording =
            MemoryRecording::new(messages.map(|(log, time, range)| message(log, time, range)).into());
        let mut reader = read_without_repeats(&recording, &|_| true)?;
        let mut seen = Vec::new();
        while let Some(message) = reader.next_message()? {
            seen.push(message.log_time);
        }
        assert_eq!(seen, [at(1.0), at(1.02), at(1.1)]);
        let counted: Vec<_> = reader.issues().iter().map(|issue| (issue.kind, issue.count)).collect();
        assert_eq!(counted, [(IssueKind::RepeatedMessage, 2)]);
        Ok(())
    }

    #[test]
    fn an_old_scan_under_a_new_stamp_is_left_out() -> Result<(), RecordingError> {
        let message = |seconds: f64, readings: &dyn Fn(usize) -> f32| {
            let mut message = scan(seconds, "laser");
            if let Message::LaserScan(scan) = &mut message {
                scan.ranges = (0..100).map(readings).collect();
            }
            named("/scan", seconds, message)
        };
        let (room, other) = (|i: usize| 2.0 + 0.1 * i as f32, |i: usize| 2.1 + 0.1 * i as f32);
        let no_return = |_: usize| 80.0;
        let recording = MemoryRecording::new(vec![
            message(1.0, &room),
            message(1.1, &room),
            message(1.2, &room),
            message(1.3, &other),
            message(1.4, &no_return),
            message(1.5, &no_return),
            message(1.6, &room),
        ]);
        let mut reader = read_without_repeats(&recording, &|_| true)?;
        let mut seen = Vec::new();
        while let Some(message) = reader.next_message()? {
            seen.push(message.log_time);
        }
        assert_eq!(seen, [at(1.0), at(1.3), at(1.4), at(1.5), at(1.6)]);
        let counted: Vec<_> = reader.issues().iter().map(|issue| (issue.kind, issue.count)).collect();
        assert_eq!(counted, [(IssueKind::RepeatedScan, 2)]);
        Ok(())
    }
}
