//! Several recordings read as one, for bags that were recorded in parts.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

use portolan_geometry::Time;

use crate::{MessageReader, RecordedMessage, Recording, RecordingError, TopicInfo};
use portolan_issue::{Issue, IssueLog};

/// Recordings merged by log time; at equal times the earlier part comes first. A part is opened when its
/// first message may be due. Parts whose time range is not known follow the part before them.
pub(crate) struct MergedRecording {
    parts: Parts,
    info: MergedInfo,
    /// Repairs made while the parts were found.
    issues: Vec<Issue>,
}

/// Shared with readers, which open one part after the other.
type Parts = Arc<Mutex<Vec<Box<dyn Recording>>>>;

struct MergedInfo {
    format: String,
    topics: Vec<TopicInfo>,
    /// Time range of every part.
    time_ranges: Vec<Option<(Time, Time)>>,
    sizes_bytes: Vec<u64>,
}

impl MergedRecording {
    pub(crate) fn new(parts: Vec<Box<dyn Recording>>, issues: Vec<Issue>) -> Self {
        let formats: BTreeSet<String> = parts.iter().map(|part| part.format()).collect();
        let formats = formats.into_iter().collect::<Vec<_>>().join(", ");
        let mut topics: BTreeMap<(Arc<str>, Arc<str>), Option<u64>> = BTreeMap::new();
        for info in parts.iter().flat_map(|part| part.topics()) {
            let sum = topics.entry((info.topic, info.type_name)).or_insert(Some(0));
            *sum = sum.zip(info.count).map(|(a, b)| a.saturating_add(b));
        }
        let info = |((topic, type_name), count)| TopicInfo { topic, type_name, count };
        let info = MergedInfo {
            format: if parts.len() == 1 { formats } else { format!("{formats} in {} files", parts.len()) },
            topics: topics.into_iter().map(info).collect(),
            time_ranges: parts.iter().map(|part| part.time_range()).collect(),
            sizes_bytes: parts.iter().map(|part| part.size_bytes()).collect(),
        };
        Self { parts: Arc::new(Mutex::new(parts)), info, issues }
    }
}

impl Recording for MergedRecording {
    fn format(&self) -> String {
        self.info.format.clone()
    }

    fn topics(&self) -> Vec<TopicInfo> {
        self.info.topics.clone()
    }

    /// Parts without messages have no time range; if there are messages, at least one part has one.
    fn time_range(&self) -> Option<(Time, Time)> {
        let ranges = self.info.time_ranges.iter().flatten();
        let first = ranges.clone().map(|range| range.0).min()?;
        let last = ranges.map(|range| range.1).max()?;
        Some((first, last))
    }

    fn size_bytes(&self) -> u64 {
        self.info.sizes_bytes.iter().sum()
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let wanted = self.info.topics.iter().filter(|topic| wanted(topic));
        let wanted = wanted.map(|topic| (topic.topic.clone(), topic.type_name.clone())).collect();
        let mut issues = IssueLog::default();
        issues.merge(&self.issues);
        let mut latest_start = Time::MIN;
        let mut waiting = Vec::new();
        for (number, range) in self.info.time_ranges.iter().enumerate() {
            latest_start = range.map_or(latest_start, |(first, _)| first);
            waiting.push((latest_start, number, range.is_some()));
        }
        waiting.sort();
        Ok(Box::new(MergedReader {
            parts: self.parts.clone(),
            wanted,
            waiting: waiting.into(),
            open: BTreeMap::new(),
            queue: BinaryHeap::new(),
            sizes_bytes: self.info.sizes_bytes.clone(),
            finished_bytes: 0,
            issues,
        }))
    }
}

struct OpenPart {
    reader: Box<dyn MessageReader>,
    next: Option<RecordedMessage>,
}

struct MergedReader {
    parts: Parts,
    wanted: BTreeSet<(Arc<str>, Arc<str>)>,
    /// Start time, number, and whether the start time is known, of parts that are not open yet, in order.
    waiting: VecDeque<(Time, usize, bool)>,
    open: BTreeMap<usize, OpenPart>,
    /// Log time of the next message and number of every open part.
    queue: BinaryHeap<Reverse<(Time, usize)>>,
    sizes_bytes: Vec<u64>,
    finished_bytes: u64,
    issues: IssueLog,
}

impl MergedReader {
    /// Opens every part that may hold a message at or before the next one in the queue.
    fn open_due_parts(&mut self) -> Result<(), RecordingError> {
        while let Some((start, number, known)) = self.waiting.front().copied() {
            let next = self.queue.peek().map(|Reverse((next, _))| *next);
            if next.is_some_and(|next| !known || start > next) {
                break;
            }
            self.waiting.pop_front();
            // The list of parts never changes, so a panic in another thread cannot leave it inconsistent.
            let parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
            let Some(part) = parts.get(number) else { continue };
            let wanted =
                |info: &TopicInfo| self.wanted.contains(&(info.topic.clone(), info.type_name.clone()));
            let reader = part.read(&wanted)?;
            drop(parts);
            self.open.insert(number, OpenPart { reader, next: None });
            self.advance(number)?;
        }
        Ok(())
    }

    /// Reads the next message of a part and puts it into the queue, or closes the part.
    fn advance(&mut self, number: usize) -> Result<(), RecordingError> {
        let Some(part) = self.open.get_mut(&number) else { return Ok(()) };
        part.next = part.reader.next_message()?;
        match &part.next {
            Some(message) => self.queue.push(Reverse((message.log_time, number))),
            None => {
                self.issues.merge(&part.reader.issues());
                self.finished_bytes += self.sizes_bytes.get(number).copied().unwrap_or_default();
                self.open.remove(&number);
            }
        }
        Ok(())
    }
}

impl MessageReader for MergedReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        self.open_due_parts()?;
        let Some(Reverse((_, number))) = self.queue.pop() else { return Ok(None) };
        let message = self.open.get_mut(&number).and_then(|part| part.next.take());
        self.advance(number)?;
        Ok(message)
    }

    fn position_bytes(&self) -> u64 {
        self.finished_bytes + self.open.values().map(|part| part.reader.position_bytes()).sum::<u64>()
    }

    fn issues(&self) -> Vec<Issue> {
        let mut all = self.issues.clone();
        self.open.values().for_each(|part| all.merge(&part.reader.issues()));
        all.list()
    }
}
