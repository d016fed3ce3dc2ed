//! Reads the messages of a container in order of log time with bounded memory.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::sync::Arc;

use portolan_geometry::Time;

use super::loader::{Entry, LoadedSegment, Loader, Plan};
use super::{ChunkIndex, MessageDecoder, RecordFormat, Segment, Source};
use crate::{MessageReader, RecordedMessage, Recording, RecordingError, TopicInfo};
use portolan_issue::{Issue, IssueKind, IssueLog};

/// A bag or MCAP file whose index has been read.
pub(crate) struct ChunkedRecording {
    pub(crate) source: Source,
    pub(crate) size_bytes: u64,
    /// Format and compressions.
    pub(crate) description: String,
    pub(crate) format: Arc<dyn RecordFormat>,
    pub(crate) index: Arc<ChunkIndex>,
}

impl Recording for ChunkedRecording {
    fn format(&self) -> String {
        self.description.clone()
    }

    fn topics(&self) -> Vec<TopicInfo> {
        self.index.topics()
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        self.index.time_range().map(|(first, last)| (time(first), time(last)))
    }

    fn size_bytes(&self) -> u64 {
        self.size_bytes
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let topics = self.topics();
        let chosen: BTreeSet<_> = topics
            .iter()
            .filter(|topic| wanted(topic))
            .map(|topic| (&topic.topic, &topic.type_name))
            .collect();
        let connections = self.index.connections.iter();
        let wanted =
            connections.filter(|(_, c)| chosen.contains(&(&c.topic, &c.type_name))).map(|(id, _)| *id);
        let plan = Plan {
            source: self.source.clone(),
            format: self.format.clone(),
            index: self.index.clone(),
            wanted: wanted.collect(),
        };
        Ok(Box::new(ChunkReader {
            loader: Loader::new(plan)?,
            index: self.index.clone(),
            cursor: 0,
            open: BTreeMap::new(),
            queue: BinaryHeap::new(),
            resident_bytes: 0,
            last_time: 0,
            position_bytes: 0,
            decoder: MessageDecoder::default(),
            issues: self.index.issues.clone(),
        }))
    }
}

/// Log time from nanoseconds since the Unix epoch.
pub(crate) fn time(nanoseconds: u64) -> Time {
    Time::from_unix_nanoseconds(i64::try_from(nanoseconds).unwrap_or(i64::MAX))
}

/// A segment with messages that have not been delivered yet.
struct OpenSegment {
    /// In order of log time.
    entries: Vec<Entry>,
    next: usize,
    /// Dropped when memory is short, and loaded again when its next message is due.
    data: Option<Vec<u8>>,
}

/// Maximum total size of decompressed chunks that overlap in time, bytes.
const MAX_RESIDENT_BYTES: usize = 256 << 20;

/// Merges segments. They are opened in order of their first log time, each as soon as it may hold the next
/// message, so that usually only one or two are in memory.
struct ChunkReader {
    loader: Loader,
    index: Arc<ChunkIndex>,
    /// Next segment to open.
    cursor: usize,
    open: BTreeMap<usize, OpenSegment>,
    /// Log time of the next message, offset in the file, and number of every open segment.
    queue: BinaryHeap<Reverse<(u64, u64, usize)>>,
    resident_bytes: usize,
    last_time: u64,
    position_bytes: u64,
    decoder: MessageDecoder,
    issues: IssueLog,
}

impl MessageReader for ChunkReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        loop {
            self.open_due_segments()?;
            let Some(Reverse((nanoseconds, _, number))) = self.queue.pop() else {
                self.position_bytes = self.loader.file_bytes();
                return Ok(None);
            };
            let message = self.decode_next(number)?;
            self.advance(number);
            let Some(message) = message else { continue };
            if nanoseconds < self.last_time {
                self.issues.add(IssueKind::LaterThanIndexed);
            }
            self.last_time = self.last_time.max(nanoseconds);
            return Ok(Some(message));
        }
    }

    fn position_bytes(&self) -> u64 {
        self.position_bytes
    }

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}

impl ChunkReader {
    /// Opens every segment that may hold a message at or before the next one in the queue.
    fn open_due_segments(&mut self) -> Result<(), RecordingError> {
        let index = self.index.clone();
        while let Some(segment) = index.segments.get(self.cursor) {
            if self.queue.peek().is_some_and(|Reverse((next, ..))| segment.first > *next) {
                break;
            }
            let number = self.cursor;
            self.cursor += 1;
            self.position_bytes = self.position_bytes.max(segment.offset + segment.stored_bytes);
            if self.loader.plan().needs(segment) {
                self.open_segment(number, segment)?;
            }
        }
        Ok(())
    }

    fn open_segment(&mut self, number: usize, segment: &Segment) -> Result<(), RecordingError> {
        let LoadedSegment { data, entries, damage } = self.loader.next(number)?;
        self.issues.merge(&damage.list());
        let Some(first) = entries.first().map(|entry| entry.nanoseconds) else {
            self.loader.recycle(data);
            return Ok(());
        };
        self.queue.push(Reverse((first, segment.offset, number)));
        self.resident_bytes += data.capacity();
        self.open.insert(number, OpenSegment { entries, next: 0, data: Some(data) });
        self.make_room(number);
        Ok(())
    }

    /// Decodes the next message of an open segment.
    fn decode_next(&mut self, number: usize) -> Result<Option<RecordedMessage>, RecordingError> {
        self.reload(number)?;
        let Some(open) = self.open.get(&number) else { return Ok(None) };
        let Some(entry) = open.entries.get(open.next) else { return Ok(None) };
        let Some(connection) = self.index.connections.get(&entry.connection) else { return Ok(None) };
        let range = entry.payload.start as usize..entry.payload.end as usize;
        let Some(payload) = open.data.as_ref().and_then(|data| data.get(range)) else {
            self.issues.add(IssueKind::FileChanged);
            return Ok(None);
        };
        let message = self.decoder.decode(connection, payload, &mut self.issues);
        Ok(message.map(|message| RecordedMessage {
            topic: connection.topic.clone(),
            log_time: time(entry.nanoseconds),
            message,
        }))
    }

    /// Puts an open segment into the queue for its next message, or closes it.
    fn advance(&mut self, number: usize) {
        let Some(open) = self.open.get_mut(&number) else { return };
        open.next += 1;
        if let (Some(entry), Some(segment)) = (open.entries.get(open.next), self.index.segments.get(number)) {
            self.queue.push(Reverse((entry.nanoseconds, segment.offset, number)));
            return;
        }
        if let Some(data) = self.open.remove(&number).and_then(|closed| closed.data) {
            self.resident_bytes -= data.capacity();
            self.loader.recycle(data);
        }
    }

    /// Loads the bytes of an open segment again if they were dropped.
    fn reload(&mut self, number: usize) -> Result<(), RecordingError> {
        let Some(open) = self.open.get_mut(&number) else { return Ok(()) };
        if open.data.is_some() {
            return Ok(());
        }
        // Its damage was counted when it was loaded for the first time.
        let data = self.loader.load_now(number)?.data;
        self.resident_bytes += data.capacity();
        open.data = Some(data);
        self.make_room(number);
        Ok(())
    }

    /// Drops the bytes of the segments whose next message is latest, until the rest fits; `keep` is not
    /// dropped.
    fn make_room(&mut self, keep: usize) {
        while self.resident_bytes > MAX_RESIDENT_BYTES {
            let next_time = |open: &OpenSegment| open.entries.get(open.next).map(|entry| entry.nanoseconds);
            let others =
                self.open.iter_mut().filter(|(number, open)| **number != keep && open.data.is_some());
            let Some((_, last)) = others.max_by_key(|(_, open)| next_time(open)) else { break };
            if let Some(data) = last.data.take() {
                self.resident_bytes -= data.capacity();
            }
        }
    }
}
