//! Index of a container: which messages are in which part of the file.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::connection::topics;
use super::{Compression, Connection, Decompressor, FileBytes, most_unpacked};
use crate::{RecordingError, TopicInfo};
use portolan_issue::{IssueKind, IssueLog};

/// A chunk, or a run of records outside of chunks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Segment {
    /// Offset of its (compressed) bytes in the file.
    pub(crate) offset: u64,
    /// Number of (compressed) bytes.
    pub(crate) stored_bytes: u64,
    /// Size after decompression, as stated in the file, bytes.
    pub(crate) unpacked_bytes: u64,
    pub(crate) compression: Compression,
    /// CRC-32 of the decompressed bytes; zero if there is none.
    pub(crate) crc: u32,
    /// Log time of its earliest message, nanoseconds since the Unix epoch.
    pub(crate) first: u64,
    /// Log time of its latest message.
    pub(crate) last: u64,
    /// Connections with messages in it, ascending; `None` if not known.
    pub(crate) connections: Option<Arc<[u32]>>,
}

/// Maximum size of a segment, bytes; larger ones are not loaded, so that a wrong size cannot exhaust the
/// memory. Uncompressed data only form a larger segment if a single message is larger.
pub(crate) const MAX_SEGMENT_BYTES: u64 = 1 << 30;

/// Everything that is known about a container before its messages are read.
#[derive(Debug, Default)]
pub(crate) struct ChunkIndex {
    pub(crate) connections: BTreeMap<u32, Connection>,
    /// Messages per connection.
    pub(crate) counts: BTreeMap<u32, u64>,
    /// Sorted by first log time (ties in file order), once opening is complete.
    pub(crate) segments: Vec<Segment>,
    pub(crate) issues: IssueLog,
}

impl ChunkIndex {
    /// Adds a segment; equal lists of connections are stored once.
    pub(crate) fn push(&mut self, mut segment: Segment) {
        if let (Some(list), Some(Segment { connections: Some(previous), .. })) =
            (&mut segment.connections, self.segments.last())
            && list == previous
        {
            *list = previous.clone();
        }
        self.segments.push(segment);
    }

    /// Adds to the message count of a connection.
    pub(crate) fn count(&mut self, connection: u32, messages: u64) {
        let count = self.counts.entry(connection).or_default();
        *count = count.saturating_add(messages);
    }

    /// Puts segments into reading order.
    pub(crate) fn sort(&mut self) {
        self.segments.sort_by_key(|segment| (segment.first, segment.offset));
    }

    /// First and last log time.
    pub(crate) fn time_range(&self) -> Option<(u64, u64)> {
        let first = self.segments.iter().map(|segment| segment.first).min()?;
        let last = self.segments.iter().map(|segment| segment.last).max()?;
        Some((first, last))
    }

    /// Topics in ascending order.
    pub(crate) fn topics(&self) -> Vec<TopicInfo> {
        topics(
            self.connections
                .iter()
                .map(|(id, connection)| (connection, Some(self.counts.get(id).copied().unwrap_or_default()))),
        )
    }

    /// The compressions in use, for the description of the format.
    pub(crate) fn compressions(&self) -> String {
        let kinds: BTreeSet<Compression> = self.segments.iter().map(|s| s.compression).collect();
        kinds.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
    }
}

/// Collects messages outside of chunks into segments of bounded size.
#[derive(Default)]
pub(crate) struct LooseRun {
    current: Option<Segment>,
    connections: BTreeSet<u32>,
}

/// Size at which a run of loose messages becomes a segment, bytes.
const LOOSE_SEGMENT_BYTES: u64 = 1 << 20;

impl LooseRun {
    /// Adds the message record at `offset` of the file.
    pub(crate) fn add(
        &mut self,
        index: &mut ChunkIndex,
        (offset, bytes): (u64, u64),
        (connection, nanoseconds): (u32, u64),
    ) {
        let fits = self.current.as_ref().is_some_and(|run| {
            run.offset + run.stored_bytes == offset && run.stored_bytes < LOOSE_SEGMENT_BYTES
        });
        if !fits {
            self.flush(index);
        }
        let run = self.current.get_or_insert(Segment {
            offset,
            stored_bytes: 0,
            unpacked_bytes: 0,
            compression: Compression::None,
            crc: 0,
            first: u64::MAX,
            last: 0,
            connections: None,
        });
        run.stored_bytes += bytes;
        run.unpacked_bytes = run.stored_bytes;
        run.first = run.first.min(nanoseconds);
        run.last = run.last.max(nanoseconds);
        self.connections.insert(connection);
        index.count(connection, 1);
    }

    /// Ends the current run.
    pub(crate) fn flush(&mut self, index: &mut ChunkIndex) {
        let connections = std::mem::take(&mut self.connections);
        if let Some(mut run) = self.current.take() {
            run.connections = Some(connections.into_iter().collect());
            index.push(run);
        }
    }
}

/// Loads segments; reuses its memory.
#[derive(Default)]
pub(crate) struct SegmentLoader {
    packed: Vec<u8>,
    decompressor: Decompressor,
}

impl SegmentLoader {
    /// Reads and decompresses a segment into `into`. Damage is counted; all readable bytes are kept.
    pub(crate) fn load(
        &mut self,
        segment: &Segment,
        file: &mut FileBytes,
        into: &mut Vec<u8>,
        issues: &mut IssueLog,
    ) -> Result<(), RecordingError> {
        into.clear();
        if segment.stored_bytes.max(segment.unpacked_bytes) > MAX_SEGMENT_BYTES {
            issues.add(IssueKind::HugeChunk);
            return Ok(());
        }
        let mut sound = true;
        if segment.compression == Compression::None {
            file.read(segment.offset, segment.stored_bytes, into)?;
        } else {
            file.read(segment.offset, segment.stored_bytes, &mut self.packed)?;
            let limit = segment.unpacked_bytes.min(most_unpacked(segment.stored_bytes));
            if limit < segment.unpacked_bytes {
                issues.add(IssueKind::HighChunkCompression);
            }
            let compression = segment.compression;
            sound = self.decompressor.decompress(compression, &self.packed, limit, into).is_ok();
        }
        if !sound {
            issues.add(IssueKind::DamagedChunkCompression);
        } else if (into.len() as u64) < segment.unpacked_bytes {
            issues.add(IssueKind::ShortChunk);
        } else if segment.crc != 0 && crc32fast::hash(into) != segment.crc {
            issues.add(IssueKind::WrongChunkChecksum);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::Source;
    use super::*;

    #[test]
    fn a_few_bytes_do_not_take_all_memory() {
        let claimed = 200 << 20;
        let packed = zstd::stream::encode_all(std::io::Read::take(std::io::repeat(0), claimed), 1).unwrap();
        let segment = Segment {
            offset: 0,
            stored_bytes: packed.len() as u64,
            unpacked_bytes: claimed,
            compression: Compression::Zstd,
            crc: 0,
            first: 0,
            last: 0,
            connections: None,
        };
        let (mut data, mut issues) = (Vec::new(), IssueLog::default());
        let source = Source::Memory { name: std::path::Path::new("chunk").into(), bytes: packed.into() };
        let mut file = source.open().unwrap();
        SegmentLoader::default().load(&segment, &mut file, &mut data, &mut issues).unwrap();
        assert_eq!(data.len(), 64 << 20);
        let issues = issues.list();
        assert!(
            issues.iter().any(|r| r.lost_data() && r.kind == IssueKind::HighChunkCompression),
            "{issues:?}"
        );
    }
}
