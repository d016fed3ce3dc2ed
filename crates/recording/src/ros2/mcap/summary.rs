//! Reads the summary at the end of an MCAP file.

use std::collections::BTreeMap;

use super::record::{
    CHANNEL, CHUNK_INDEX, Channels, FOOTER, MAGIC, RECORD_HEAD_BYTES, SCHEMA, STATISTICS, Text,
};
use crate::RecordingError;
use crate::container::FileBytes;

/// Sizes of a chunk and of the message indexes after it, and the channels in it.
#[derive(Clone, Debug)]
pub(crate) struct ChunkPlace {
    pub(crate) chunk_bytes: u64,
    pub(crate) message_index_bytes: u64,
    pub(crate) channels: Vec<u32>,
}

#[derive(Debug)]
pub(crate) struct Statistics {
    pub(crate) message_count: u64,
    pub(crate) chunk_count: u32,
    pub(crate) counts: BTreeMap<u32, u64>,
}

/// State of the summary.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SummaryState {
    Whole,
    /// The writer did not write one.
    Absent,
    /// The end of the file is missing.
    CutOff,
    Damaged,
}

/// The summary, if it is complete; otherwise empty.
#[derive(Debug)]
pub(crate) struct Summary {
    pub(crate) state: SummaryState,
    /// End of the messages.
    pub(crate) data_end: u64,
    pub(crate) channels: Channels,
    pub(crate) chunks: BTreeMap<u64, ChunkPlace>,
    pub(crate) statistics: Option<Statistics>,
}

impl Summary {
    fn empty(state: SummaryState, data_end: u64) -> Self {
        let (channels, chunks) = (Channels::default(), BTreeMap::new());
        Self { state, data_end, channels, chunks, statistics: None }
    }
}

const FOOTER_BYTES: u64 = RECORD_HEAD_BYTES as u64 + 20;
/// Maximum size of a summary, bytes; a longer one is ignored, because the summary is not required.
const MAX_SUMMARY_BYTES: u64 = 1 << 30;

/// Reads the summary.
pub(crate) fn read(file: &mut FileBytes) -> Result<Summary, RecordingError> {
    let length = file.length();
    let cut_off = Summary::empty(SummaryState::CutOff, length);
    let Some(footer_offset) = length.checked_sub(FOOTER_BYTES + MAGIC.len() as u64) else {
        return Ok(cut_off);
    };
    let end = file.peek(footer_offset, FOOTER_BYTES as usize + MAGIC.len())?.to_vec();
    let mut text = Text::new(&end);
    let footer = text.take(RECORD_HEAD_BYTES).and_then(|head| head.first().copied());
    let (Some(FOOTER), Some(start), Some(_offsets), Some(crc), MAGIC) =
        (footer, text.u64(), text.u64(), text.u32(), text.rest())
    else {
        return Ok(cut_off);
    };
    if start == 0 {
        return Ok(Summary::empty(SummaryState::Absent, footer_offset));
    }
    let damaged = Summary::empty(SummaryState::Damaged, footer_offset);
    let Some(bytes) = footer_offset.checked_sub(start).filter(|bytes| *bytes <= MAX_SUMMARY_BYTES) else {
        return Ok(damaged);
    };
    let mut section = Vec::new();
    file.read(start, bytes, &mut section)?;
    if crc != 0 {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&section);
        hasher.update(end.get(..RECORD_HEAD_BYTES + 16).unwrap_or_default());
        if hasher.finalize() != crc {
            return Ok(damaged);
        }
    }
    let mut summary = Summary::empty(SummaryState::Whole, start);
    Ok(if parse(&section, &mut summary).is_some() { summary } else { damaged })
}

fn parse(section: &[u8], summary: &mut Summary) -> Option<()> {
    let mut text = Text::new(section);
    while !text.rest().is_empty() {
        let op = *text.take(1)?.first()?;
        let length = usize::try_from(text.u64()?).ok()?;
        let content = text.take(length)?;
        match op {
            SCHEMA if !summary.channels.add_schema(content) => return None,
            // Summaries may omit schemas; the channels of those schemas are found in the chunks.
            CHANNEL => drop(summary.channels.add_channel(content)),
            CHUNK_INDEX => {
                let (offset, place) = chunk_place(content)?;
                summary.chunks.insert(offset, place);
            }
            STATISTICS => summary.statistics = Some(statistics(content)?),
            _ => {}
        }
    }
    Some(())
}

fn chunk_place(content: &[u8]) -> Option<(u64, ChunkPlace)> {
    let mut text = Text::new(content);
    let (_first, _last) = (text.u64()?, text.u64()?);
    let (offset, chunk_bytes) = (text.u64()?, text.u64()?);
    let mut offsets = Text::new(text.bytes()?);
    let message_index_bytes = text.u64()?;
    let mut channels = Vec::new();
    while !offsets.rest().is_empty() {
        channels.push(u32::from(offsets.u16()?));
        let _offset = offsets.u64()?;
    }
    channels.sort_unstable();
    channels.dedup();
    Some((offset, ChunkPlace { chunk_bytes, message_index_bytes, channels }))
}

fn statistics(content: &[u8]) -> Option<Statistics> {
    let mut text = Text::new(content);
    let message_count = text.u64()?;
    let (_schemas, _channels) = (text.u16()?, text.u32()?);
    let (_attachments, _metadata) = (text.u32()?, text.u32()?);
    let chunk_count = text.u32()?;
    let (_first, _last) = (text.u64()?, text.u64()?);
    let mut pairs = Text::new(text.bytes()?);
    let mut counts = BTreeMap::new();
    while !pairs.rest().is_empty() {
        counts.insert(u32::from(pairs.u16()?), pairs.u64()?);
    }
    Some(Statistics { message_count, chunk_count, counts })
}
