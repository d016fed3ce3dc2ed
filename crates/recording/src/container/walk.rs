//! Walking over records that lie in memory, past damage.

use std::ops::Range;

/// One record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Record {
    /// First byte behind it.
    pub(crate) end: usize,
    pub(crate) content: Content,
}

/// What a record holds.
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

/// How the records of a container look.
pub(crate) trait RecordFormat: Send + Sync {
    /// The record at `at`, or `None` if there is no sound and whole one.
    fn record(&self, data: &[u8], at: usize) -> Option<Record>;

    /// Where the next record that looks sound starts, at or behind `from`.
    fn find_record(&self, data: &[u8], from: usize) -> Option<usize>;
}

/// Visits every sound record. Returns how often something unreadable had to be skipped.
pub(crate) fn walk(format: &dyn RecordFormat, data: &[u8], mut visit: impl FnMut(Record)) -> u64 {
    let mut at = 0;
    let mut gaps = 0;
    while at < data.len() {
        if let Some(record) = format.record(data, at) {
            // Every record is longer than nothing; the maximum guards against standing still.
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
