//! Finds the segments of an MCAP file that hold its messages.
//!
//! As with bags, the file is always read record by record. An intact summary only avoids reading the message
//! indexes after each chunk.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::record::{
    CHANNEL, CHUNK, Channels, ChunkHead, DATA_END, FOOTER, MESSAGE, MESSAGE_HEAD_BYTES, MESSAGE_INDEX,
    McapFormat, PeekedRecord, RECORD_HEAD_BYTES, SCHEMA, Text, peek,
};
use super::summary::{ChunkPlace, Summary, SummaryState};
use crate::RecordingError;
use crate::container::{
    ChunkIndex, ChunkInspector, Compression, FileBytes, LooseRun, MAX_SEGMENT_BYTES, RecordFormat, Segment,
};
use portolan_issue::IssueKind;

/// Bytes of a record that are read to find out what it is.
const PEEK_BYTES: usize = 256;
/// Maximum size of a schema or channel record, bytes; larger ones are taken as damage.
const MAX_DESCRIPTION_BYTES: u64 = 1 << 24;

/// Finds all segments between `start` and the summary; also returns the channels that exist.
pub(crate) fn scan(
    file: &mut FileBytes,
    start: u64,
    summary: Summary,
) -> Result<(ChunkIndex, BTreeSet<u16>), RecordingError> {
    // Counts of all channels come from the statistics, or from every message index.
    let trusted = summary.statistics.as_ref().is_some_and(|statistics| {
        let counted: u64 = statistics.counts.values().fold(0, |sum, n| sum.saturating_add(*n));
        statistics.chunk_count as usize == summary.chunks.len() && counted == statistics.message_count
    });
    let mut scan = Scan {
        file,
        index: ChunkIndex::default(),
        end: summary.data_end,
        summary,
        trusted,
        loose: LooseRun::default(),
        pending: None,
        inspector: ChunkInspector::default(),
        visited_chunks: 0,
    };
    match scan.summary.state {
        SummaryState::Whole | SummaryState::Absent => {}
        SummaryState::CutOff => {
            scan.index.issues.add(IssueKind::MissingSummary);
        }
        SummaryState::Damaged => {
            scan.index.issues.add(IssueKind::DamagedSummary);
        }
    }
    scan.run(start)?;
    let Scan { mut index, summary, .. } = scan;
    index.connections = summary.channels.connections;
    if let (true, Some(statistics)) = (trusted, summary.statistics) {
        index.counts = statistics.counts;
    }
    index.sort();
    let channels = index.connections.keys().filter_map(|id| u16::try_from(*id).ok()).collect();
    Ok((index, channels))
}

struct Scan<'a> {
    file: &'a mut FileBytes,
    index: ChunkIndex,
    summary: Summary,
    trusted: bool,
    end: u64,
    loose: LooseRun,
    pending: Option<PendingChunk>,
    inspector: ChunkInspector,
    visited_chunks: usize,
}

/// The bounds of a chunk's records. The chunk contains its length twice: in an intact chunk both agree with
/// each other and with the next record.
struct ChunkBounds {
    /// Start of the records.
    data: u64,
    /// End of the records, from the length of the records.
    data_end: u64,
    /// End of the records, from the length of the chunk.
    record_end: u64,
    /// Start of the next chunk in the summary; the end of the messages if there is none.
    next_chunk: u64,
}

impl ChunkBounds {
    fn contradict(&self) -> bool {
        self.data_end != self.record_end || self.data_end > self.next_chunk
    }
}

/// A chunk whose message indexes are being read.
struct PendingChunk {
    segment: Segment,
    counts: BTreeMap<u32, u64>,
    sound: bool,
}

impl Scan<'_> {
    fn run(&mut self, start: u64) -> Result<(), RecordingError> {
        let mut at = start;
        while at < self.end {
            let record = peek(self.file, at, PEEK_BYTES)?;
            let left = self.end - at;
            let known = |op| (1..=DATA_END).contains(&op) || op >= 0x80;
            let record = match record.filter(|record| known(record.op)) {
                Some(record) if record.op == CHUNK || record.record_bytes <= left => record,
                _ => match self.find_record(at + 1)? {
                    Some(next) => {
                        self.index.issues.add(IssueKind::UnreadableBytes);
                        at = next;
                        continue;
                    }
                    None => {
                        self.index.issues.add(IssueKind::CutRecord);
                        break;
                    }
                },
            };
            if record.op != MESSAGE_INDEX {
                self.finish_pending()?;
            }
            if matches!(record.op, DATA_END | FOOTER) {
                break;
            }
            at = self.record(at, &record)?;
        }
        self.finish_pending()?;
        self.loose.flush(&mut self.index);
        if self.visited_chunks < self.summary.chunks.len() {
            self.index.issues.add(IssueKind::MissingSummarizedChunks);
        }
        Ok(())
    }

    /// Processes one record; returns the offset of the next one.
    fn record(&mut self, at: u64, record: &PeekedRecord) -> Result<u64, RecordingError> {
        let end = at.saturating_add(record.record_bytes);
        match record.op {
            CHUNK => return self.chunk(at, record),
            MESSAGE_INDEX => self.message_index(record),
            SCHEMA | CHANNEL => {
                let length = record.record_bytes - RECORD_HEAD_BYTES as u64;
                let mut content = Vec::new();
                if length <= MAX_DESCRIPTION_BYTES {
                    self.file.read(at + RECORD_HEAD_BYTES as u64, length, &mut content)?;
                }
                let channels = &mut self.summary.channels;
                let sound = if record.op == SCHEMA {
                    channels.add_schema(&content)
                } else {
                    channels.add_channel(&content)
                };
                if !sound {
                    self.index.issues.add(IssueKind::MalformedTopic);
                }
            }
            MESSAGE => {
                let mut text = Text::new(&record.content);
                match (text.u16(), text.u32(), text.u64(), text.u64()) {
                    (Some(channel), Some(_), Some(time), Some(_)) => {
                        let place = (at, record.record_bytes);
                        self.loose.add(&mut self.index, place, (u32::from(channel), time));
                    }
                    _ => self.index.issues.add(IssueKind::DamagedRecords),
                }
            }
            _ => {} // attachments, metadata
        }
        Ok(end)
    }

    /// Processes a chunk; returns the offset of the next record.
    fn chunk(&mut self, at: u64, record: &PeekedRecord) -> Result<u64, RecordingError> {
        let Some(head) = ChunkHead::parse(&record.content) else {
            self.index.issues.add(IssueKind::UnreadableBytes);
            return Ok(self.find_record(at + 1)?.unwrap_or(self.end));
        };
        let place = self.summary.chunks.get(&at).cloned();
        self.visited_chunks += usize::from(place.is_some());
        let bounds = self.chunk_bounds(at, record, &head);
        let is_wrong = bounds.contradict();
        let Some(compression) = head.compression else {
            self.index.issues.add(IssueKind::UnknownChunkCompression);
            return Ok(bounds.record_end.min(bounds.next_chunk));
        };
        if compression == Compression::None && (is_wrong || head.records_bytes > MAX_SEGMENT_BYTES) {
            // An uncompressed chunk needs no boundary: its records can be read as if they were outside of it.
            if is_wrong {
                self.index.issues.add(IssueKind::WrongChunkLength);
            }
            return Ok(bounds.data);
        }
        let data_end = if is_wrong { self.likely_data_end(&bounds)? } else { bounds.data_end };
        let segment = Segment {
            offset: bounds.data,
            stored_bytes: data_end - bounds.data,
            unpacked_bytes: head.unpacked_bytes,
            compression,
            crc: head.crc,
            first: head.first,
            last: head.last,
            connections: None,
        };
        let is_sound = |place: &ChunkPlace| !is_wrong && self.is_as_summarized(record, &head, place);
        if let Some(place) = place.filter(is_sound) {
            let next = data_end.saturating_add(place.message_index_bytes);
            // Without message indexes the channels of a chunk are not known.
            let connections = (!place.channels.is_empty()).then(|| Arc::from(place.channels));
            if next <= bounds.next_chunk {
                self.index.push(Segment { connections, ..segment });
                return Ok(next);
            }
        }
        self.pending = Some(PendingChunk { segment, counts: BTreeMap::new(), sound: !is_wrong });
        Ok(data_end)
    }

    fn chunk_bounds(&self, at: u64, record: &PeekedRecord, head: &ChunkHead) -> ChunkBounds {
        let data = at + RECORD_HEAD_BYTES as u64 + head.records_start;
        ChunkBounds {
            data,
            data_end: data.saturating_add(head.records_bytes),
            record_end: at.saturating_add(record.record_bytes),
            next_chunk: self.summary.chunks.range(at + 1..).next().map_or(self.end, |(offset, _)| *offset),
        }
    }

    /// The likely end of the records of a chunk whose lengths contradict each other: the first possible end,
    /// or where a record follows.
    fn likely_data_end(&mut self, bounds: &ChunkBounds) -> Result<u64, RecordingError> {
        let possible = bounds.data..=bounds.next_chunk;
        let ends = [bounds.data_end, bounds.record_end].into_iter();
        match ends.filter(|end| possible.contains(end)).min() {
            Some(end) => Ok(end),
            None => Ok(self.find_record(bounds.data)?.unwrap_or(self.end).min(bounds.next_chunk)),
        }
    }

    /// Whether a chunk matches its entry in a trusted summary, and all of its channels are known.
    fn is_as_summarized(&self, record: &PeekedRecord, head: &ChunkHead, place: &ChunkPlace) -> bool {
        // A chunk without messages has no times.
        let has_times = head.last > 0;
        let known = |id: &u32| self.summary.channels.connections.contains_key(id);
        self.trusted
            && place.chunk_bytes == record.record_bytes
            && (has_times || !place.channels.is_empty())
            && match (place.channels.as_slice(), &self.summary.statistics) {
                // Without message indexes it may have messages of any channel.
                ([], Some(statistics)) => statistics.counts.keys().all(known),
                (channels, _) => channels.iter().all(known),
            }
    }

    /// Processes the message index of one channel of the chunk before it.
    fn message_index(&mut self, record: &PeekedRecord) {
        let Some(pending) = &mut self.pending else { return };
        let mut text = Text::new(&record.content);
        let content_bytes = record.record_bytes - RECORD_HEAD_BYTES as u64;
        match (text.u16(), text.u32()) {
            (Some(channel), Some(bytes)) if u64::from(bytes) + 6 == content_bytes && bytes % 16 == 0 => {
                *pending.counts.entry(u32::from(channel)).or_default() += u64::from(bytes) / 16;
            }
            _ => pending.sound = false,
        }
    }

    /// Completes the chunk before the current record. If its message indexes are missing or not valid, or
    /// name unknown channels, the chunk is decompressed to find out what is in it.
    fn finish_pending(&mut self) -> Result<(), RecordingError> {
        let Some(mut pending) = self.pending.take() else { return Ok(()) };
        let known = |id: &u32| self.summary.channels.connections.contains_key(id);
        if !pending.sound || pending.counts.is_empty() || !pending.counts.keys().all(known) {
            self.look_inside(&mut pending)?;
        }
        let counts = pending.counts.iter().filter(|(_, messages)| **messages > 0);
        let connections: Arc<[u32]> = counts.clone().map(|(id, _)| *id).collect();
        counts.for_each(|(id, messages)| self.index.count(*id, *messages));
        if !connections.is_empty() {
            pending.segment.connections = Some(connections);
            self.index.push(pending.segment);
        }
        Ok(())
    }

    fn look_inside(&mut self, pending: &mut PendingChunk) -> Result<(), RecordingError> {
        let channels = &mut self.summary.channels;
        let describe = |bytes: &[u8]| _ = channels.add_record(bytes);
        let format = McapFormat { channels: BTreeSet::new() };
        let issues = &mut self.index.issues;
        pending.counts =
            self.inspector.inspect(&mut pending.segment, self.file, &format, issues, describe)?;
        Ok(())
    }

    /// Offset of the next record that looks valid, at or after `from`.
    fn find_record(&mut self, from: u64) -> Result<Option<u64>, RecordingError> {
        const OVERLAP: u64 = 1 << 10;
        let mut block_bytes = 1 << 13;
        let mut block = Vec::new();
        let mut at = from;
        while at < self.end {
            let left = self.end.saturating_sub(at);
            self.file.read(at, left.min(block_bytes), &mut block)?;
            let connections = self.summary.channels.connections.keys();
            let channels = connections.filter_map(|id| u16::try_from(*id).ok()).collect();
            let format = McapFormat { channels };
            let mut places = suffixes(&block).enumerate();
            let found = places.find(|(place, bytes)| plausible(bytes, left - *place as u64, &format));
            if let Some((found, _)) = found {
                return Ok(Some(at + found as u64));
            }
            at += block_bytes - OVERLAP;
            block_bytes = (2 * block_bytes).min(1 << 18);
        }
        Ok(None)
    }
}

/// The suffixes of `bytes` at every position.
fn suffixes(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    (0..bytes.len()).filter_map(|place| bytes.get(place..))
}

/// Whether bytes outside of chunks look like the start of a record, if `left` bytes of the file remain.
fn plausible(bytes: &[u8], left: u64, format: &McapFormat) -> bool {
    let mut text = Text::new(bytes);
    let Some([op @ SCHEMA..=MESSAGE_INDEX | op @ DATA_END]) = text.take(1) else { return false };
    let Some(length) = text.u64().filter(|length| *length <= left.saturating_sub(RECORD_HEAD_BYTES as u64))
    else {
        return false;
    };
    match *op {
        CHUNK => ChunkHead::parse(text.rest()).is_some_and(|head| {
            head.compression.is_some()
                && head.first <= head.last
                && head.records_start.saturating_add(head.records_bytes) == length
        }),
        MESSAGE_INDEX => {
            let (channel, bytes) = (text.u16(), text.u32());
            channel.is_some() && bytes.is_some_and(|bytes| u64::from(bytes) + 6 == length && bytes % 16 == 0)
        }
        DATA_END => length == 4,
        MESSAGE => {
            let known = text.u16().is_some_and(|channel| format.channels.contains(&channel));
            known
                && length >= MESSAGE_HEAD_BYTES as u64
                && format.record(bytes, 0).is_none_or(|record| {
                    matches!(bytes.get(record.end), None | Some(&(SCHEMA..=MESSAGE_INDEX | DATA_END)))
                })
        }
        _ => matches!(format.record(bytes, 0), Some(record) if Channels::default()
            .add_record(bytes.get(..record.end).unwrap_or_default())),
    }
}
