//! Reads the index at the end of a bag.

use std::collections::BTreeMap;

use super::record::{Fields, Op, peek_head};
use crate::RecordingError;
use crate::container::{Connection, FileBytes};
use portolan_ros_messages::Encoding;

/// Index entry of one chunk.
#[derive(Clone, Debug)]
pub(crate) struct ChunkInfo {
    /// Log times, nanoseconds.
    pub(crate) first: u64,
    pub(crate) last: u64,
    /// Messages per connection.
    pub(crate) counts: Vec<(u32, u32)>,
}

/// State of the index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TailState {
    Whole,
    /// The recording was not closed properly.
    Missing,
    Damaged,
}

/// The index, or the readable part of it.
#[derive(Debug)]
pub(crate) struct Tail {
    pub(crate) state: TailState,
    /// End of the chunks: the start of a complete index, otherwise the end of the file.
    pub(crate) chunks_end: u64,
    pub(crate) connections: BTreeMap<u32, Connection>,
    /// By offset of the chunk; empty unless the index is complete.
    pub(crate) chunks: BTreeMap<u64, ChunkInfo>,
}

/// Maximum size of the description of a connection, bytes; larger ones are taken as damage.
const MAX_DESCRIPTION_BYTES: u64 = 1 << 24;

/// Reads the index at `offset`, which the bag header gives.
pub(crate) fn read(file: &mut FileBytes, offset: u64) -> Result<Tail, RecordingError> {
    let mut tail = Tail {
        state: TailState::Missing,
        chunks_end: file.length(),
        connections: BTreeMap::new(),
        chunks: BTreeMap::new(),
    };
    if offset == 0 || offset > file.length() {
        return Ok(tail);
    }
    tail.state = TailState::Whole;
    let mut at = offset;
    while at < file.length() {
        let head = peek_head(file, at)?.filter(|head| at + head.record_bytes() <= file.length());
        let sound = match &head {
            Some(head) if head.op == Op::Connection => {
                read_connection(file, at, head, &mut tail.connections)?
            }
            Some(head) if head.op == Op::ChunkInfo => read_chunk_info(file, at, head, &mut tail.chunks)?,
            _ => false,
        };
        let Some(head) = head.filter(|_| sound) else {
            tail.state = TailState::Damaged;
            break;
        };
        at += head.record_bytes();
    }
    let promised = peek_head(file, super::MAGIC.len() as u64)?;
    let complete = promised.is_some_and(|head| {
        head.chunk_count as usize <= tail.chunks.len()
            && head.connection_count as usize <= tail.connections.len()
    });
    if tail.state == TailState::Whole && complete {
        tail.chunks_end = offset;
    } else {
        tail.state = TailState::Damaged;
        tail.chunks.clear();
    }
    Ok(tail)
}

/// Reads the connection record at `offset` into `connections`; false if it is malformed.
pub(crate) fn read_connection(
    file: &mut FileBytes,
    offset: u64,
    head: &super::record::Head,
    connections: &mut BTreeMap<u32, Connection>,
) -> Result<bool, RecordingError> {
    if head.data_bytes > MAX_DESCRIPTION_BYTES {
        return Ok(false);
    }
    let data = file.peek(offset + head.data_start, head.data_bytes as usize)?;
    let connection = parse_connection(&head.topic, data);
    Ok(connection.is_some_and(|connection| {
        connections.entry(head.connection).or_insert(connection);
        true
    }))
}

/// Parses a connection from its topic and the fields in the data of its record.
pub(crate) fn parse_connection(topic: &[u8], data: &[u8]) -> Option<Connection> {
    let mut type_name = None;
    for field in Fields::new(data) {
        if let (b"type", value) = field? {
            type_name = Some(String::from_utf8_lossy(value).into_owned());
        }
    }
    Some(Connection::new(&String::from_utf8_lossy(topic), &type_name?, Encoding::Ros1))
}

fn read_chunk_info(
    file: &mut FileBytes,
    offset: u64,
    head: &super::record::Head,
    chunks: &mut BTreeMap<u64, ChunkInfo>,
) -> Result<bool, RecordingError> {
    if head.data_bytes != 8 * u64::from(head.count) {
        return Ok(false);
    }
    let data = file.peek(offset + head.data_start, head.data_bytes as usize)?;
    let word = |bytes: &[u8], at: usize| {
        bytes.get(at..).and_then(|rest| rest.first_chunk()).map_or(0, |word| u32::from_le_bytes(*word))
    };
    let counts = data.chunks_exact(8).map(|pair| (word(pair, 0), word(pair, 4))).collect();
    let info = ChunkInfo { first: head.start_time, last: head.end_time, counts };
    chunks.insert(head.chunk_offset, info);
    Ok(true)
}
