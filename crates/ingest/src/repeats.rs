//! Messages that come twice: from drivers that send again, and from recordings put together that overlap.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_recording::{
    Header, Message, MessageReader, RecordedMessage, Recording, RecordingError, TopicInfo,
};

/// Of the bytes of a cloud about so many are compared, evenly spread: two sweeps do not share them by chance.
const COMPARED_BYTES: usize = 4096;

/// One pass over a recording, without the messages of range sensors, IMUs and odometry that repeat the one before on their
/// topic: the same stamp and the same values. They are counted.
pub(crate) fn read_without_repeats(
    recording: &dyn Recording,
    wanted: &dyn Fn(&TopicInfo) -> bool,
) -> Result<Box<dyn MessageReader>, RecordingError> {
    let reader = recording.read(wanted)?;
    Ok(Box::new(WithoutRepeats { reader, last: BTreeMap::new(), issues: IssueLog::default() }))
}

struct WithoutRepeats {
    reader: Box<dyn MessageReader>,
    /// Digests of the last messages.
    last: BTreeMap<Arc<str>, u64>,
    issues: IssueLog,
}

impl WithoutRepeats {
    fn is_repeat(&mut self, message: &RecordedMessage) -> bool {
        let Some((stamp, digest)) = digest(&message.message) else { return false };
        if self.last.get(&message.topic) == Some(&digest) {
            self.issues.add(Issue::new(IssueKind::RepeatedMessage).of(message.topic.clone()).at(stamp));
            return true;
        }
        match self.last.get_mut(&message.topic) {
            Some(last) => *last = digest,
            None => drop(self.last.insert(message.topic.clone(), digest)),
        }
        false
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

/// The stamp, and a digest of it and of what was measured; none for messages without a stamp, and for other kinds.
fn digest(message: &Message) -> Option<(Time, u64)> {
    let mut digest = DefaultHasher::new();
    let header: &Header = match message {
        Message::LaserScan(scan) => {
            scan.ranges.iter().for_each(|range| range.to_bits().hash(&mut digest));
            &scan.header
        }
        Message::MultiEchoLaserScan(scan) => {
            scan.ranges.iter().flatten().for_each(|range| range.to_bits().hash(&mut digest));
            &scan.header
        }
        Message::PointCloud2(cloud) => {
            (cloud.width, cloud.height, cloud.data.len()).hash(&mut digest);
            let stride = cloud.data.len().div_ceil(COMPARED_BYTES).max(1);
            cloud.data.iter().step_by(stride).for_each(|byte| digest.write_u8(*byte));
            &cloud.header
        }
        Message::Imu(imu) => {
            let values = imu.linear_acceleration.iter().chain(&imu.angular_velocity);
            values.for_each(|value| value.to_bits().hash(&mut digest));
            &imu.header
        }
        Message::Odometry(odometry) => {
            let pose = odometry.pose.position.iter().chain(&odometry.pose.orientation_xyzw);
            let twist = odometry.linear_velocity.iter().chain(&odometry.angular_velocity);
            pose.chain(twist).for_each(|value| value.to_bits().hash(&mut digest));
            &odometry.header
        }
        _ => return None,
    };
    header.stamp.hash(&mut digest);
    (header.stamp != Time::UNIX_EPOCH).then(|| (header.stamp, digest.finish()))
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
}
