//! Reads and writes MCAP files.
//!
//! A record is one byte of type, eight bytes of length, and content. Messages are in chunks or outside of
//! them. A summary at the end repeats schemas and channels and lists the chunks.

mod record;
mod scan;
mod summary;
mod writer;

use std::sync::Arc;

use crate::container::{ChunkedRecording, Source};
use crate::{Recording, RecordingError};
pub(crate) use record::MAGIC;
use record::{McapFormat, Text};
pub(crate) use writer::McapWriter;

/// Whether a file with these first bytes is an MCAP file.
pub(crate) fn sniff(first_bytes: &[u8]) -> bool {
    first_bytes.starts_with(MAGIC)
}

/// Opens an MCAP file. A missing or damaged summary is rebuilt by scanning the file.
pub(crate) fn open(source: Source) -> Result<Box<dyn Recording>, RecordingError> {
    let mut file = source.open()?;
    let start = MAGIC.len() as u64;
    let header = record::peek(&mut file, start, 1 << 16)?;
    let profile = header
        .filter(|header| header.op == record::HEADER)
        .and_then(|header| Text::new(&header.content).string())
        .unwrap_or_default();
    let summary = summary::read(&mut file)?;
    let (index, channels) = scan::scan(&mut file, start, summary)?;
    let mut details: Vec<String> = [profile, index.compressions()].into();
    details.retain(|detail| !detail.is_empty());
    let description =
        if details.is_empty() { "MCAP".to_owned() } else { format!("MCAP ({})", details.join(", ")) };
    Ok(Box::new(ChunkedRecording {
        size_bytes: file.length(),
        description,
        format: Arc::new(McapFormat { channels }),
        index: Arc::new(index),
        source,
    }))
}
