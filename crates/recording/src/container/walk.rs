//! Iterates over records in memory and skips damaged parts.

use std::ops::Range;

/// One record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Record {
    /// Offset of the first byte after it.
    pub(crate) end: usize,
    pub(crate) content: Content,
}

/// The content of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    Message {
        connection: u32,
        /// Log time since the Unix epoch.
        nanoseconds: u64,
        payload: Range<usize>,
    },
    /// Describes a connection (or the schema of one); the range covers the whole record.
    Description(Range<usize>),
    Other,
}

/// The record format of a container.
pub(crate) trait RecordFormat: Send + Sync {
    /// The record at `at`, or `None` if there is no valid and complete one.
    fn record(&self, data: &[u8], at: usize) -> Option<Record>;

    /// Offset of the next record that looks valid, at or after `from`.
    fn find_record(&self, data: &[u8], from: usize) -> Option<usize>;
}

/// Visits every valid record. Returns how often unreadable bytes had to be skipped.
pub(crate) fn walk(format: &dyn RecordFormat, data: &[u8], mut visit: impl FnMut(Record)) -> u64 {
    let mut at = 0;
    let mut gaps = 0;
    while at < data.len() {
        if let Some(record) = format.record(data, at) {
            // Every record has at least one byte; `max` guarantees progress.
            at = record.end.max(at + 1);
            visit(record);
            continue;
        }
        gaps += 1;
        match format.find_record(data, at + 1) {
            Some(next) => at = next,
            None => break,
        }
    }
    gaps
}
