//! Finds the segments of a bag that hold its messages.
//!
//! The file is always read record by record. An intact index at its end only avoids reading the entries of
//! the index records after each chunk. So intact and damaged bags are opened by the same code.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::record::{BagFormat, Head, Op, parse_head, peek_head};
use super::tail::{Tail, TailState, parse_connection, read_connection};
use crate::RecordingError;
use crate::container::{
    ChunkIndex, ChunkInspector, Compression, FileBytes, LooseRun, MAX_SEGMENT_BYTES, RecordFormat, Segment,
};
use portolan_issue::IssueKind;

/// Finds all segments between `start` and the index.
pub(crate) fn scan(file: &mut FileBytes, start: u64, tail: Tail) -> Result<ChunkIndex, RecordingError> {
    let mut scan = Scan {
        file,
        index: ChunkIndex { connections: tail.connections, ..ChunkIndex::default() },
        chunks: tail.chunks,
        chunks_end: tail.chunks_end,
        loose: LooseRun::default(),
        pending: None,
        inspector: ChunkInspector::default(),
        visited_chunks: 0,
    };
    match tail.state {
        TailState::Whole => {}
        TailState::Missing => scan.index.issues.add(IssueKind::MissingIndex),
        TailState::Damaged => {
            scan.index.issues.add(IssueKind::DamagedIndex);
        }
    }
    scan.run(start)?;
    let mut index = scan.index;
    index.sort();
    Ok(index)
}

struct Scan<'a> {
    file: &'a mut FileBytes,
    index: ChunkIndex,
    chunks: BTreeMap<u64, super::tail::ChunkInfo>,
    chunks_end: u64,
    loose: LooseRun,
    pending: Option<PendingChunk>,
    inspector: ChunkInspector,
    visited_chunks: usize,
}

/// A chunk whose index records are being read.
struct PendingChunk {
    segment: Segment,
    /// Messages per connection.
    counts: BTreeMap<u32, u64>,
    /// Whether its index records are valid.
    sound: bool,
    /// Whether the index at the end of the file describes it completely.
    known: bool,
}

/// Maximum size of the index of one chunk, bytes (millions of messages); larger ones are taken as damage.
const MAX_INDEX_BYTES: u64 = 1 << 26;

impl Scan<'_> {
    fn run(&mut self, start: u64) -> Result<(), RecordingError> {
        let mut at = start;
        while at < self.chunks_end {
            let Some(head) = peek_head(self.file, at)? else {
                at = self.skip_unreadable(at)?;
                continue;
            };
            if head.op != Op::Index {
                self.finish_pending()?;
            }
            at = self.record(at, &head)?;
        }
        self.finish_pending()?;
        self.loose.flush(&mut self.index);
        if self.visited_chunks < self.chunks.len() {
            self.index.issues.add(IssueKind::MissingIndexedChunks);
        }
        Ok(())
    }

    /// Offset at which reading continues after bytes at `at` that are not a record.
    fn skip_unreadable(&mut self, at: u64) -> Result<u64, RecordingError> {
        let next_chunk = self.next_known_chunk(at);
        if self.pending.as_ref().is_some_and(|pending| pending.known) {
            self.index.issues.add(IssueKind::DamagedChunkIndex);
            return Ok(next_chunk);
        }
        let next = self.find_record(at + 1)?;
        self.index.issues.add(match next {
            Some(_) => IssueKind::UnreadableBytes,
            None => IssueKind::CutRecord,
        });
        Ok(next.unwrap_or(self.chunks_end).min(next_chunk))
    }

    /// Offset of the next chunk after `at` in the index, or the end of the chunks.
    fn next_known_chunk(&self, at: u64) -> u64 {
        self.chunks.range(at + 1..).next().map_or(self.chunks_end, |(offset, _)| *offset)
    }

    /// Processes one record; returns the offset of the next one.
    fn record(&mut self, at: u64, head: &Head) -> Result<u64, RecordingError> {
        let end = at + head.record_bytes();
        let fits = end <= self.chunks_end;
        match head.op {
            Op::Chunk => return self.chunk(at, head),
            Op::Index => return self.index_record(at, head),
            Op::Message if !fits => {}
            Op::Message => {
                self.loose.add(&mut self.index, (at, head.record_bytes()), (head.connection, head.time));
            }
            Op::Connection if fits => {
                if !read_connection(self.file, at, head, &mut self.index.connections)? {
                    self.index.issues.add(IssueKind::MalformedTopic);
                }
            }
            Op::Connection | Op::BagHeader | Op::ChunkInfo => {}
        }
        if fits {
            return Ok(end);
        }
        // Its length is wrong, or the file ends here: search for records after its header.
        let next = self.find_record(at + head.data_start)?;
        self.index.issues.add(IssueKind::TooLongRecord);
        Ok(next.unwrap_or(self.chunks_end).min(self.next_known_chunk(at)))
    }

    fn chunk(&mut self, at: u64, head: &Head) -> Result<u64, RecordingError> {
        let data = at + head.data_start;
        let mut stored_bytes = head.data_bytes;
        let Some(compression) = head.compression else {
            self.index.issues.add(IssueKind::UnknownChunkCompression);
            return Ok((at + head.record_bytes()).min(self.chunks_end));
        };
        let next_chunk = self.next_known_chunk(at);
        let is_wrong = data + stored_bytes > next_chunk
            || (compression == Compression::None && stored_bytes != u64::from(head.size));
        if compression == Compression::None && (is_wrong || stored_bytes > MAX_SEGMENT_BYTES) {
            // An uncompressed chunk needs no boundary: its records can be read as if they were outside of it.
            if is_wrong {
                self.index.issues.add(IssueKind::WrongChunkLength);
            }
            return Ok(data);
        }
        if is_wrong {
            stored_bytes = self.find_record(data)?.unwrap_or(self.chunks_end).min(next_chunk) - data;
        }
        let segment = Segment {
            offset: data,
            stored_bytes,
            unpacked_bytes: u64::from(head.size), // the same as stored if it is not compressed
            compression,
            crc: 0,
            first: u64::MAX,
            last: 0,
            connections: None,
        };
        let mut pending = PendingChunk { segment, counts: BTreeMap::new(), sound: !is_wrong, known: false };
        let info = self.chunks.get(&at);
        self.visited_chunks += usize::from(info.is_some());
        if let Some(info) = info.filter(|_| !is_wrong) {
            pending.known = true;
            (pending.segment.first, pending.segment.last) = (info.first, info.last);
            pending.counts = info.counts.iter().map(|(id, messages)| (*id, u64::from(*messages))).collect();
        }
        self.pending = Some(pending);
        Ok(data + stored_bytes)
    }

    /// Processes the index record of one connection of the chunk before it.
    fn index_record(&mut self, at: u64, head: &Head) -> Result<u64, RecordingError> {
        let data = at + head.data_start;
        let entry_bytes = 12 * u64::from(head.count);
        let mut end = data + head.data_bytes;
        if entry_bytes != head.data_bytes {
            // Some recorders wrote a wrong length: use the end at which a record follows.
            let right = data + entry_bytes;
            let follows = right == self.chunks_end || peek_head(self.file, right)?.is_some();
            if follows {
                end = right;
            }
            self.index.issues.add(IssueKind::WrongIndexLength);
        }
        end = end.min(self.next_known_chunk(at));
        let Some(pending) = self.pending.as_mut().filter(|pending| !pending.known) else { return Ok(end) };
        let mut entries = Vec::new();
        if entry_bytes <= MAX_INDEX_BYTES {
            self.file.read(data, entry_bytes.min(end.saturating_sub(data)), &mut entries)?;
        }
        if entries.len() as u64 != entry_bytes {
            pending.sound = false;
        }
        for time in entries.chunks_exact(12).filter_map(|entry| super::record::time_value(entry.get(..8)?)) {
            pending.segment.first = pending.segment.first.min(time);
            pending.segment.last = pending.segment.last.max(time);
        }
        *pending.counts.entry(head.connection).or_default() += u64::from(head.count);
        Ok(end)
    }

    /// Completes the chunk before the current record. If its index records are missing or not valid, or name
    /// unknown connections, the chunk is decompressed to find out what is in it.
    fn finish_pending(&mut self) -> Result<(), RecordingError> {
        let Some(mut pending) = self.pending.take() else { return Ok(()) };
        let known = |id: &u32| self.index.connections.contains_key(id);
        let complete = pending.sound && !pending.counts.is_empty() && pending.counts.keys().all(known);
        if !pending.known && !complete {
            self.look_inside(&mut pending)?;
        }
        if !pending.counts.is_empty() {
            self.push(pending.segment, &pending.counts);
        }
        Ok(())
    }

    fn look_inside(&mut self, pending: &mut PendingChunk) -> Result<(), RecordingError> {
        let ChunkIndex { connections, issues, .. } = &mut self.index;
        let describe = |bytes: &[u8]| {
            let described = parse_head(bytes).and_then(|head| {
                let connection = parse_connection(&head.topic, bytes.get(head.data_start as usize..)?)?;
                Some((head.connection, connection))
            });
            if let Some((id, connection)) = described {
                connections.entry(id).or_insert(connection);
            }
        };
        pending.counts =
            self.inspector.inspect(&mut pending.segment, self.file, &BagFormat, issues, describe)?;
        Ok(())
    }

    fn push(&mut self, mut segment: Segment, counts: &BTreeMap<u32, u64>) {
        let counts = counts.iter().filter(|(_, messages)| **messages > 0);
        let connections: Arc<[u32]> = counts.clone().map(|(id, _)| *id).collect();
        counts.for_each(|(id, messages)| self.index.count(*id, *messages));
        if !connections.is_empty() {
            segment.connections = Some(connections);
            self.index.push(segment);
        }
    }

    /// Offset of the next record that looks valid, at or after `from`.
    fn find_record(&mut self, from: u64) -> Result<Option<u64>, RecordingError> {
        // Blocks overlap by more than a header. They grow, because the next record is usually near.
        const OVERLAP: u64 = 1 << 11;
        let mut block_bytes = 1 << 13;
        let mut block = Vec::new();
        let mut at = from;
        while at < self.chunks_end {
            self.file.read(at, self.chunks_end.saturating_sub(at).min(block_bytes), &mut block)?;
            if let Some(found) = BagFormat.find_record(&block, 0) {
                return Ok(Some(at + found as u64));
            }
            at += block_bytes - OVERLAP;
            block_bytes = (2 * block_bytes).min(1 << 18);
        }
        Ok(None)
    }
}
