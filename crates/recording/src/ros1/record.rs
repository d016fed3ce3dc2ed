//! Records of a bag.

use crate::RecordingError;
use crate::container::{Compression, Content, FileBytes, Record, RecordFormat};

/// First bytes of a bag.
pub(crate) const MAGIC: &[u8] = b"#ROSBAG V2.0\n";

/// Maximum size of a record header, bytes: headers are small, with topics and a few numbers.
const MAX_HEADER_BYTES: usize = 1 << 16;

/// Type of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Op {
    Message = 2,
    BagHeader = 3,
    Index = 4,
    Chunk = 5,
    ChunkInfo = 6,
    Connection = 7,
}

/// Header of a record, with the fields of all types; fields that a record does not have are zero.
#[derive(Clone, Debug)]
pub(crate) struct Head {
    pub(crate) op: Op,
    /// Bytes from the start of the record to its data.
    pub(crate) data_start: u64,
    pub(crate) data_bytes: u64,
    pub(crate) connection: u32,
    /// Log time of a message, nanoseconds.
    pub(crate) time: u64,
    /// Entries of an index or chunk info.
    pub(crate) count: u32,
    /// Decompressed size of a chunk.
    pub(crate) size: u32,
    pub(crate) chunk_offset: u64,
    pub(crate) start_time: u64,
    pub(crate) end_time: u64,
    pub(crate) index_offset: u64,
    pub(crate) connection_count: u32,
    pub(crate) chunk_count: u32,
    /// `None` for an unknown compression.
    pub(crate) compression: Option<Compression>,
    pub(crate) topic: Vec<u8>,
    pub(crate) encryptor: Vec<u8>,
}

impl Head {
    /// Bytes of the whole record.
    pub(crate) fn record_bytes(&self) -> u64 {
        self.data_start + self.data_bytes
    }
}

/// Iterates over the named fields of a record header, or of the data of a connection record. Yields `None`
/// where the fields are malformed, and then ends.
pub(crate) struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = Option<(&'a [u8], &'a [u8])>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let field = self.rest.split_first_chunk().and_then(|(length, rest)| {
            let (field, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
            self.rest = rest;
            let equals = field.iter().position(|byte| *byte == b'=')?;
            Some((field.get(..equals)?, field.get(equals + 1..)?))
        });
        if field.is_none() {
            self.rest = &[];
        }
        Some(field)
    }
}

/// Parses the header of the record that starts with these bytes.
pub(crate) fn parse_head(bytes: &[u8]) -> Option<Head> {
    let (header_bytes, rest) = bytes.split_first_chunk()?;
    let header_bytes = u32::from_le_bytes(*header_bytes) as usize;
    if header_bytes > MAX_HEADER_BYTES {
        return None;
    }
    let (fields, rest) = rest.split_at_checked(header_bytes)?;
    let mut head = Head {
        op: Op::Message,
        data_start: header_bytes as u64 + 8,
        data_bytes: u64::from(u32::from_le_bytes(*rest.first_chunk()?)),
        connection: 0,
        time: 0,
        count: 0,
        size: 0,
        chunk_offset: 0,
        start_time: 0,
        end_time: 0,
        index_offset: 0,
        connection_count: 0,
        chunk_count: 0,
        compression: None,
        topic: Vec::new(),
        encryptor: Vec::new(),
    };
    let mut op = None;
    for field in Fields::new(fields) {
        match field? {
            (b"op", [code]) => op = Some(op_from_code(*code)?),
            (b"conn", value) => head.connection = u32_value(value)?,
            (b"time", value) => head.time = time_value(value)?,
            (b"count", value) => head.count = u32_value(value)?,
            (b"size", value) => head.size = u32_value(value)?,
            (b"chunk_pos", value) => head.chunk_offset = u64_value(value)?,
            (b"start_time", value) => head.start_time = time_value(value)?,
            (b"end_time", value) => head.end_time = time_value(value)?,
            (b"index_pos", value) => head.index_offset = u64_value(value)?,
            (b"conn_count", value) => head.connection_count = u32_value(value)?,
            (b"chunk_count", value) => head.chunk_count = u32_value(value)?,
            (b"compression", value) => head.compression = Compression::from_name(value),
            (b"topic", value) => head.topic = value.to_vec(),
            (b"encryptor", value) => head.encryptor = value.to_vec(),
            _ => {}
        }
    }
    head.op = op?;
    Some(head)
}

fn op_from_code(code: u8) -> Option<Op> {
    Some(match code {
        2 => Op::Message,
        3 => Op::BagHeader,
        4 => Op::Index,
        5 => Op::Chunk,
        6 => Op::ChunkInfo,
        7 => Op::Connection,
        _ => return None,
    })
}

fn u32_value(value: &[u8]) -> Option<u32> {
    value.try_into().ok().map(u32::from_le_bytes)
}

fn u64_value(value: &[u8]) -> Option<u64> {
    value.try_into().ok().map(u64::from_le_bytes)
}

/// A ROS time as nanoseconds since the Unix epoch.
pub(crate) fn time_value(value: &[u8]) -> Option<u64> {
    let (seconds, nanoseconds) = value.split_first_chunk()?;
    let nanoseconds = u32_value(nanoseconds)?;
    Some(u64::from(u32::from_le_bytes(*seconds)) * 1_000_000_000 + u64::from(nanoseconds))
}

/// The header of the record at `offset` of the file; `None` if there is no valid one.
pub(crate) fn peek_head(file: &mut FileBytes, offset: u64) -> Result<Option<Head>, RecordingError> {
    let Some(header_bytes) = file.peek(offset, 4)?.first_chunk().map(|b| u32::from_le_bytes(*b) as usize)
    else {
        return Ok(None);
    };
    if header_bytes > MAX_HEADER_BYTES {
        return Ok(None);
    }
    Ok(parse_head(file.peek(offset, header_bytes + 8)?))
}

/// The records inside of a chunk.
#[derive(Debug)]
pub(crate) struct BagFormat;

impl RecordFormat for BagFormat {
    fn record(&self, data: &[u8], at: usize) -> Option<Record> {
        let head = parse_head(data.get(at..)?)?;
        let start = at + head.data_start as usize;
        let end = start.checked_add(head.data_bytes as usize).filter(|end| *end <= data.len())?;
        let content = match head.op {
            Op::Message => {
                Content::Message { connection: head.connection, nanoseconds: head.time, payload: start..end }
            }
            Op::Connection => Content::Description(at..end),
            _ => return None, // chunks have no other records
        };
        Some(Record { end, content })
    }

    /// Every header has the field `op`, so the records around each such field are tried.
    fn find_record(&self, data: &[u8], from: usize) -> Option<usize> {
        const PATTERN: &[u8] = b"\x04\0\0\0op=";
        /// Maximum distance from the start of a header to its field `op`, bytes.
        const MAX_BEHIND: usize = 512;
        let mut at = from;
        while let Some(found) = data.get(at..)?.windows(PATTERN.len()).position(|bytes| bytes == PATTERN) {
            let field = at + found;
            let earliest = field.saturating_sub(MAX_BEHIND).max(from);
            // Try the farthest start first: a nearer one may miss fields before `op`.
            let mut starts = earliest..(field + 1).saturating_sub(4);
            let sound = |start: &usize| {
                let Some(header_bytes) = data.get(*start..).and_then(|rest| rest.first_chunk()) else {
                    return false;
                };
                let header_end = start + 4 + u32::from_le_bytes(*header_bytes) as usize;
                header_end > field + PATTERN.len() && data.get(*start..).and_then(parse_head).is_some()
            };
            if let Some(start) = starts.find(sound) {
                return Some(start);
            }
            at = field + 1;
        }
        None
    }
}
