//! A recording in memory, made by a program instead of read from a file.

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::Time;

use crate::{Message, MessageReader, RecordedMessage, Recording, RecordingError, TopicInfo};
use portolan_issue::Issue;

/// A recording whose messages are in memory.
#[derive(Clone, Debug, Default)]
pub struct MemoryRecording {
    messages: Arc<[RecordedMessage]>,
}

impl MemoryRecording {
    /// Takes messages in any order and sorts them by log time (the order of equal times is kept).
    pub fn new(mut messages: Vec<RecordedMessage>) -> Self {
        messages.sort_by_key(|m| m.log_time);
        Self { messages: messages.into() }
    }
}

impl FromIterator<RecordedMessage> for MemoryRecording {
    fn from_iter<I: IntoIterator<Item = RecordedMessage>>(messages: I) -> Self {
        Self::new(messages.into_iter().collect())
    }
}

impl Recording for MemoryRecording {
    fn format(&self) -> String {
        "messages in memory".to_owned()
    }

    fn topics(&self) -> Vec<TopicInfo> {
        let mut topics: BTreeMap<&Arc<str>, (&Message, u64)> = BTreeMap::new();
        for message in self.messages.iter() {
            topics.entry(&message.topic).or_insert((&message.message, 0)).1 += 1;
        }
        let info = |(topic, (message, count)): (&Arc<str>, (&Message, u64))| TopicInfo {
            topic: topic.clone(),
            type_name: message.type_name().into(),
            count: Some(count),
        };
        topics.into_iter().map(info).collect()
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        Some((self.messages.first()?.log_time, self.messages.last()?.log_time))
    }

    fn size_bytes(&self) -> u64 {
        self.messages.len() as u64
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let topics = self.topics().into_iter().filter(|t| wanted(t)).map(|t| t.topic).collect();
        Ok(Box::new(MemoryReader { messages: self.messages.clone(), topics, next: 0 }))
    }
}

struct MemoryReader {
    messages: Arc<[RecordedMessage]>,
    topics: Vec<Arc<str>>,
    next: usize,
}

impl MessageReader for MemoryReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        while let Some(message) = self.messages.get(self.next) {
            self.next += 1;
            if self.topics.contains(&message.topic) {
                return Ok(Some(message.clone()));
            }
        }
        Ok(None)
    }

    fn position_bytes(&self) -> u64 {
        self.next as u64
    }

    fn issues(&self) -> Vec<Issue> {
        Vec::new()
    }
}
