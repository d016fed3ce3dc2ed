//! Messages of several sensors, merged in order of time and made while they are read.

use std::collections::VecDeque;

use portolan_geometry::{Rigid3, Time};
use portolan_issue::Issue;
use portolan_recording::{
    Header, Message, MessageReader, Pose, RecordedMessage, RecordingError, TfMessage, TransformStamped,
};
use rayon::prelude::*;

use crate::sensors::{Clock, FaultFilter, MessageStream};

/// Topic of the transforms between the robot and its sensors.
pub(crate) const STATIC_TRANSFORMS: &str = "/tf_static";
/// Frame of the platform.
pub(crate) const ROBOT_FRAME: &str = "base_link";

/// One pass over the messages of a simulation.
pub(crate) struct MergedReader {
    /// In ascending order of topic; ties in time go to the first.
    streams: Vec<Merged>,
    position_bytes: u64,
}

/// One topic with its next message.
pub(crate) struct Merged {
    stream: Box<dyn MessageStream>,
    filter: Option<FaultFilter>,
    clock: Clock,
    message_bytes: u64,
    next: Option<RecordedMessage>,
}

impl Merged {
    /// Starts a topic; the filter adds its faults.
    pub fn start(
        stream: Box<dyn MessageStream>,
        filter: Option<FaultFilter>,
        clock: Clock,
        message_bytes: u64,
    ) -> Self {
        let mut merged = Self { stream, filter, clock, message_bytes, next: None };
        merged.advance();
        merged
    }

    /// Gives the next message, and replaces it by the one after it.
    fn advance(&mut self) -> Option<RecordedMessage> {
        let after = loop {
            let Some(message) = self.stream.next_message() else { break None };
            let Some(filter) = &mut self.filter else { break Some(message) };
            // True time of the measurement: the stamp, before any faults.
            let seconds = message.message.header().map_or(0.0, |header| self.clock.seconds(header.stamp));
            if let Some(spoiled) = filter.apply(message, seconds) {
                break Some(spoiled);
            }
        };
        std::mem::replace(&mut self.next, after)
    }
}

impl MergedReader {
    /// Merges topics, given in ascending order.
    pub fn new(streams: Vec<Merged>) -> Self {
        Self { streams, position_bytes: 0 }
    }
}

impl MessageReader for MergedReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        let with_next = self.streams.iter_mut().filter(|merged| merged.next.is_some());
        let earliest = with_next.min_by_key(|merged| merged.next.as_ref().map(|next| next.log_time));
        let Some(earliest) = earliest else { return Ok(None) };
        self.position_bytes += earliest.message_bytes;
        Ok(earliest.advance())
    }

    fn position_bytes(&self) -> u64 {
        self.position_bytes
    }

    fn issues(&self) -> Vec<Issue> {
        Vec::new()
    }
}

/// Messages that do not depend on each other; some are made ahead of the reader, in parallel. Each has its
/// own random numbers, so the result does not depend on the thread that makes it.
pub(crate) struct AheadStream<F> {
    make: F,
    count: u64,
    ahead: u64,
    next: u64,
    ready: VecDeque<RecordedMessage>,
}

impl<F: Fn(u64) -> Option<RecordedMessage> + Send + Sync> AheadStream<F> {
    /// Makes messages number 0 to `count` − 1, `ahead` at a time.
    pub fn new(count: u64, ahead: u64, make: F) -> Self {
        Self { make, count, ahead, next: 0, ready: VecDeque::new() }
    }
}

impl<F: Fn(u64) -> Option<RecordedMessage> + Send + Sync> MessageStream for AheadStream<F> {
    fn next_message(&mut self) -> Option<RecordedMessage> {
        if self.ready.is_empty() {
            let end = self.count.min(self.next + self.ahead);
            let made: Vec<RecordedMessage> =
                (self.next..end).into_par_iter().filter_map(&self.make).collect();
            self.ready.extend(made);
            self.next = end;
        }
        self.ready.pop_front()
    }
}

/// The static transforms as one message at the start.
pub(crate) struct TransformStream {
    message: Option<RecordedMessage>,
}

impl TransformStream {
    /// Publishes transforms at a time.
    pub fn new(transforms: Vec<TransformStamped>, log_time: Time) -> Self {
        let transforms = TfMessage { is_static: true, transforms };
        let message =
            RecordedMessage { topic: STATIC_TRANSFORMS.into(), log_time, message: Message::Tf(transforms) };
        Self { message: Some(message) }
    }
}

impl MessageStream for TransformStream {
    fn next_message(&mut self) -> Option<RecordedMessage> {
        self.message.take()
    }
}

/// The transform from the robot to one of its sensors.
pub(crate) fn sensor_transform(stamp: Time, frame: &str, base_from_sensor: &Rigid3) -> TransformStamped {
    TransformStamped {
        header: Header { stamp, frame_id: ROBOT_FRAME.into() },
        child_frame_id: frame.into(),
        transform: pose_message(base_from_sensor),
    }
}

/// A pose in the form of messages.
pub(crate) fn pose_message(pose: &Rigid3) -> Pose {
    let q = pose.rotation.quaternion();
    Pose { position: pose.translation.vector.into(), orientation_xyzw: [q.i, q.j, q.k, q.w] }
}
