//! Records of an MCAP file.

use std::collections::{BTreeMap, BTreeSet};

use crate::RecordingError;
use crate::container::{Compression, Connection, Content, FileBytes, Record, RecordFormat};
use portolan_ros_messages::Encoding;

/// First and last bytes of an MCAP file.
pub(crate) const MAGIC: &[u8] = b"\x89MCAP0\r\n";

pub(crate) const HEADER: u8 = 0x01;
pub(crate) const FOOTER: u8 = 0x02;
pub(crate) const SCHEMA: u8 = 0x03;
pub(crate) const CHANNEL: u8 = 0x04;
pub(crate) const MESSAGE: u8 = 0x05;
pub(crate) const CHUNK: u8 = 0x06;
pub(crate) const MESSAGE_INDEX: u8 = 0x07;
pub(crate) const CHUNK_INDEX: u8 = 0x08;
pub(crate) const STATISTICS: u8 = 0x0b;
pub(crate) const SUMMARY_OFFSET: u8 = 0x0e;
pub(crate) const DATA_END: u8 = 0x0f;

/// Bytes of type and length before every record's content.
pub(crate) const RECORD_HEAD_BYTES: usize = 9;
/// Bytes of channel, sequence number and two times before a message's data.
pub(crate) const MESSAGE_HEAD_BYTES: usize = 22;

/// Reads the values of a record one after the other; `None` past the end.
pub(crate) struct Text<'a> {
    rest: &'a [u8],
}

impl<'a> Text<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    pub(crate) fn rest(&self) -> &'a [u8] {
        self.rest
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes after their length in four bytes.
    pub(crate) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.take(length as usize)
    }

    pub(crate) fn string(&mut self) -> Option<String> {
        self.bytes().map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }

    pub(crate) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (bytes, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(bytes)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (bytes, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(*bytes)
    }
}

/// Start of a record in the file.
pub(crate) struct PeekedRecord {
    pub(crate) op: u8,
    /// Size of the whole record, bytes; saturates if the stated length is too large.
    pub(crate) record_bytes: u64,
    /// The content, cut off at the requested length.
    pub(crate) content: Vec<u8>,
}

/// The record at `offset` with at most `content_bytes` of its content; `None` at the end of the file.
pub(crate) fn peek(
    file: &mut FileBytes,
    offset: u64,
    content_bytes: usize,
) -> Result<Option<PeekedRecord>, RecordingError> {
    let bytes = file.peek(offset, RECORD_HEAD_BYTES + content_bytes)?;
    let Some((head, content)) = bytes.split_at_checked(RECORD_HEAD_BYTES) else { return Ok(None) };
    let [op, length @ ..] = head else { return Ok(None) };
    let length = length.try_into().map_or(u64::MAX, u64::from_le_bytes);
    let content = content.get(..usize::try_from(length).unwrap_or(usize::MAX)).unwrap_or(content).to_vec();
    let record_bytes = length.saturating_add(RECORD_HEAD_BYTES as u64);
    Ok(Some(PeekedRecord { op: *op, record_bytes, content }))
}

/// Head of a chunk record.
pub(crate) struct ChunkHead {
    pub(crate) first: u64,
    pub(crate) last: u64,
    pub(crate) unpacked_bytes: u64,
    pub(crate) crc: u32,
    /// `None` for an unknown compression.
    pub(crate) compression: Option<Compression>,
    /// Bytes from the start of the content to the (compressed) records.
    pub(crate) records_start: u64,
    pub(crate) records_bytes: u64,
}

impl ChunkHead {
    /// Parses the first bytes of a chunk's content.
    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let mut text = Text::new(content);
        let (first, last) = (text.u64()?, text.u64()?);
        let (unpacked_bytes, crc) = (text.u64()?, text.u32()?);
        let compression = Compression::from_name(text.bytes()?);
        let records_bytes = text.u64()?;
        let records_start = (content.len() - text.rest().len()) as u64;
        Some(Self { first, last, unpacked_bytes, crc, compression, records_start, records_bytes })
    }
}

/// Schemas and channels read so far.
#[derive(Debug, Default)]
pub(crate) struct Channels {
    /// Name of every schema.
    schemas: BTreeMap<u16, String>,
    pub(crate) connections: BTreeMap<u32, Connection>,
}

impl Channels {
    /// Adds the content of a schema record; false if it is malformed.
    pub(crate) fn add_schema(&mut self, content: &[u8]) -> bool {
        let mut text = Text::new(content);
        let (Some(id), Some(name), Some(_encoding), Some(_definition)) =
            (text.u16(), text.string(), text.bytes(), text.bytes())
        else {
            return false;
        };
        self.schemas.entry(id).or_insert(name);
        true
    }

    /// Adds the content of a channel record; false if it is malformed or its schema is not known.
    pub(crate) fn add_channel(&mut self, content: &[u8]) -> bool {
        let mut text = Text::new(content);
        let (Some(id), Some(schema), Some(topic), Some(encoding), Some(_metadata)) =
            (text.u16(), text.u16(), text.string(), text.bytes(), text.bytes())
        else {
            return false;
        };
        let encoding = match encoding {
            b"ros1" => Encoding::Ros1,
            b"cdr" => Encoding::Cdr,
            _ => Encoding::Unknown,
        };
        let type_name = match (schema, self.schemas.get(&schema)) {
            (_, Some(name)) => name.as_str(),
            (0, None) => "unknown", // channels of schemaless encodings
            (_, None) => return false,
        };
        self.connections.entry(u32::from(id)).or_insert_with(|| Connection::new(&topic, type_name, encoding));
        true
    }

    /// Adds a whole schema or channel record in memory.
    pub(crate) fn add_record(&mut self, record: &[u8]) -> bool {
        match record.split_at_checked(RECORD_HEAD_BYTES) {
            Some(([SCHEMA, ..], content)) => self.add_schema(content),
            Some(([CHANNEL, ..], content)) => self.add_channel(content),
            _ => false,
        }
    }
}

/// The records inside of a chunk.
#[derive(Debug)]
pub(crate) struct McapFormat {
    /// Channels that exist: after damage, a message record must belong to one of them. Empty while they are
    /// not known.
    pub(crate) channels: BTreeSet<u16>,
}

impl RecordFormat for McapFormat {
    fn record(&self, data: &[u8], at: usize) -> Option<Record> {
        let mut text = Text::new(data.get(at..)?);
        let op = *text.take(1)?.first()?;
        let content = text.u64().and_then(|length| text.take(usize::try_from(length).ok()?))?;
        let end = data.len() - text.rest().len();
        let content = match op {
            MESSAGE => {
                let mut text = Text::new(content);
                let (connection, _sequence) = (text.u16()?, text.u32()?);
                let (nanoseconds, _publish_time) = (text.u64()?, text.u64()?);
                let payload = end - text.rest().len()..end;
                Content::Message { connection: u32::from(connection), nanoseconds, payload }
            }
            SCHEMA | CHANNEL => Content::Description(at..end),
            0x80.. => Content::Other, // private records of applications
            _ => return None,
        };
        Some(Record { end, content })
    }

    /// Records have no magic number to search for, so a position counts as a record only if all of its fields
    /// are plausible.
    fn find_record(&self, data: &[u8], from: usize) -> Option<usize> {
        let plausible = |at: &usize| {
            // The upper half of a length is zero; this check alone rejects almost every position.
            if !matches!(data.get(*at..), Some([SCHEMA..=MESSAGE, _, _, _, _, 0, 0, 0, 0, ..])) {
                return false;
            }
            let Some(record) = self.record(data, *at) else { return false };
            let follows = matches!(data.get(record.end), None | Some(SCHEMA..=MESSAGE));
            follows
                && match record.content {
                    Content::Message { connection, .. } => {
                        self.channels.is_empty()
                            || u16::try_from(connection).is_ok_and(|id| self.channels.contains(&id))
                    }
                    Content::Description(range) => {
                        data.get(range).is_some_and(|record| Channels::default().add_record(record))
                    }
                    Content::Other => false,
                }
        };
        (from..data.len()).find(plausible)
    }
}
