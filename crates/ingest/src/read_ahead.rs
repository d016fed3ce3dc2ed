//! Delays messages a little, so that their transforms are known.

use std::collections::VecDeque;

use portolan_geometry::{Duration, Time};
use portolan_issue::Issue;
use portolan_recording::{Message, MessageReader, RecordedMessage, RecordingError};

use crate::tf::{TfInput, TfTree};

/// Time by which transforms may be recorded later than the data that need them.
const AHEAD: Duration = Duration::from_ticks(10_000_000);
/// Time for which moving transforms are kept.
const KEPT: Duration = Duration::from_ticks(10 * 10_000_000);
/// Maximum size of the messages that are read ahead, bytes.
const MAX_BYTES: usize = 1 << 30;
/// Maximum number of messages that are read ahead.
const MAX_MESSAGES: usize = 1_000_000;

/// Maximum number of messages of one time that are put in order of topic.
const MAX_TIES: usize = 1000;

/// Reads messages, inserts transforms into the tree at once and returns everything 1 s later (but all of it
/// at the end). Messages recorded at the same time are returned in order of topic, so that the order does not
/// depend on the format.
pub(crate) struct ReadAhead {
    reader: Box<dyn MessageReader>,
    ahead: Duration,
    waiting: VecDeque<(usize, RecordedMessage)>,
    waiting_bytes: usize,
    newest: Time,
    ended: bool,
    pub tree: TfTree,
    pub tf: TfInput,
}

impl ReadAhead {
    /// Without `wait_for_transforms` messages are returned as soon as a later one has been read.
    pub fn new(reader: Box<dyn MessageReader>, tree: TfTree, tf: TfInput, wait_for_transforms: bool) -> Self {
        let ahead = if wait_for_transforms { AHEAD } else { Duration::ZERO };
        Self {
            reader,
            ahead,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            newest: Time::MIN,
            ended: false,
            tree,
            tf,
        }
    }

    /// The next message; transforms among them are in the tree already.
    ///
    /// # Errors
    /// If the recording cannot be read.
    pub fn next(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        loop {
            if let Some(message) = self.pop_ready() {
                return Ok(Some(message));
            }
            if self.ended {
                return Ok(None);
            }
            match self.reader.next_message()? {
                Some(message) => self.push(message),
                None => self.ended = true,
            }
        }
    }

    fn push(&mut self, message: RecordedMessage) {
        self.newest = self.newest.max(message.log_time);
        if let Message::Tf(transforms) = &message.message {
            // Static ones were all read beforehand.
            if !transforms.is_static {
                self.tf.insert(&mut self.tree, transforms);
            }
        }
        let bytes = bytes_of(&message.message);
        self.waiting_bytes += bytes;
        let stands_before = |(_, waiting): &&(usize, RecordedMessage)| {
            waiting.log_time == message.log_time && waiting.topic > message.topic
        };
        let passed = self.waiting.iter().rev().take(MAX_TIES).take_while(stands_before).count();
        self.waiting.insert(self.waiting.len() - passed, (bytes, message));
    }

    fn pop_ready(&mut self) -> Option<RecordedMessage> {
        let (_, front) = self.waiting.front()?;
        let settled = front.log_time + self.ahead < self.newest;
        let full = self.waiting_bytes > MAX_BYTES || self.waiting.len() > MAX_MESSAGES;
        if !(settled || full || self.ended) {
            return None;
        }
        let (bytes, message) = self.waiting.pop_front()?;
        self.waiting_bytes -= bytes;
        if matches!(message.message, Message::Tf(_)) {
            self.tree.forget_before(message.log_time - KEPT);
        }
        Some(message)
    }

    /// Bytes of the file consumed so far.
    pub fn position_bytes(&self) -> u64 {
        self.reader.position_bytes()
    }

    /// Issues that the format repaired.
    pub fn issues(&self) -> Vec<Issue> {
        self.reader.issues()
    }
}

/// Rough size of a message in memory.
fn bytes_of(message: &Message) -> usize {
    let content = match message {
        Message::LaserScan(m) => 4 * (m.ranges.len() + m.intensities.len()),
        Message::MultiEchoLaserScan(m) => {
            m.ranges.iter().chain(&m.intensities).map(|e| 24 + 4 * e.len()).sum()
        }
        Message::PointCloud2(m) => m.data.len(),
        Message::Tf(m) => 128 * m.transforms.len(),
        Message::LandmarkList(m) => 128 * m.landmarks.len(),
        _ => 1024,
    };
    256 + content
}
