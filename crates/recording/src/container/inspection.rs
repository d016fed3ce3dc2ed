//! Reads the content of chunks that no index describes.

use std::collections::BTreeMap;

use super::{Content, FileBytes, RecordFormat, Segment, SegmentLoader, usual_unpacked, walk};
use crate::RecordingError;
use portolan_issue::{IssueKind, IssueLog};

/// Maximum total size of decompressed chunks without any readable message, beyond the size expected of sensor
/// data, bytes. It bounds the time by the size of the file, whatever sizes its chunks state.
const MOST_USELESS_BYTES: u64 = 512 << 20;

/// Decompresses chunks to find out what is in them; reuses its memory.
#[derive(Default)]
pub(crate) struct ChunkInspector {
    loader: SegmentLoader,
    data: Vec<u8>,
    useless_bytes: u64,
}

impl ChunkInspector {
    /// Counts the messages of a chunk by connection, sets its times, and passes the records that describe
    /// connections to `describe`. A chunk from which nothing could be read is an issue; other damage is
    /// counted by the pass that reads the chunk.
    pub(crate) fn inspect(
        &mut self,
        segment: &mut Segment,
        file: &mut FileBytes,
        format: &dyn RecordFormat,
        issues: &mut IssueLog,
        mut describe: impl FnMut(&[u8]),
    ) -> Result<BTreeMap<u32, u64>, RecordingError> {
        let mut damage = IssueLog::default();
        let usual = usual_unpacked(segment.stored_bytes);
        if self.useless_bytes > MOST_USELESS_BYTES && segment.unpacked_bytes > usual {
            issues.add(IssueKind::UnreadableChunk);
            return Ok(BTreeMap::new());
        }
        self.loader.load(segment, file, &mut self.data, &mut damage)?;
        let mut counts: BTreeMap<u32, u64> = BTreeMap::new();
        (segment.first, segment.last) = (u64::MAX, 0);
        let gaps = walk(format, &self.data, |record| match record.content {
            Content::Message { connection, nanoseconds, .. } => {
                segment.first = segment.first.min(nanoseconds);
                segment.last = segment.last.max(nanoseconds);
                *counts.entry(connection).or_default() += 1;
            }
            Content::Description(range) => describe(self.data.get(range).unwrap_or_default()),
            Content::Other => {}
        });
        if counts.is_empty() {
            self.useless_bytes += (self.data.len() as u64).saturating_sub(usual);
            if gaps > 0 || !damage.list().is_empty() {
                issues.add(IssueKind::UnreadableChunk);
            }
        }
        Ok(counts)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Compression, Source};
    use super::*;
    use crate::ros1::record::BagFormat;

    #[test]
    fn output_of_useless_chunks_is_bounded() {
        let unpacked_bytes = 60 << 20;
        let zeros = std::io::Read::take(std::io::repeat(0), unpacked_bytes);
        let packed = zstd::stream::encode_all(zeros, 1).unwrap();
        let segment = Segment {
            offset: 0,
            stored_bytes: packed.len() as u64,
            unpacked_bytes,
            compression: Compression::Zstd,
            crc: 0,
            first: 0,
            last: 0,
            connections: None,
        };
        let source = Source::Memory { name: std::path::Path::new("chunk").into(), bytes: packed.into() };
        let (mut file, mut issues) = (source.open().unwrap(), IssueLog::default());
        let mut inspector = ChunkInspector::default();
        for _ in 0..30 {
            let segment = &mut segment.clone();
            let counts = inspector.inspect(segment, &mut file, &BagFormat, &mut issues, |_| {}).unwrap();
            assert!(counts.is_empty());
        }
        assert!(
            inspector.useless_bytes <= MOST_USELESS_BYTES + unpacked_bytes,
            "{}",
            inspector.useless_bytes
        );
        let unreadable: Vec<u64> = issues.list().iter().map(|issue| issue.count).collect();
        assert_eq!(unreadable, [30]);
    }
}
