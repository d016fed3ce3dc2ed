//! Writes ROS 1 bags.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use portolan_geometry::Time;

use super::record::{MAGIC, Op};
use crate::output_file::OutputFile;
use crate::{BagCompression, RecordedMessage, RecordingError, RecordingWriter};
use portolan_ros_messages::{Dialect, definition, encode, is_static_tf_topic, md5sum};

/// Size at which a chunk is closed, bytes; the same as in `rosbag record`.
const CHUNK_BYTES: usize = 768 << 10;
/// Size of the bag header record with its padding, bytes.
const BAG_HEADER_BYTES: usize = 4096;

/// Log time in a bag: seconds and nanoseconds, four bytes each.
type Stamp = [u8; 8];

/// Writes a ROS 1 bag 2.0.
pub(crate) struct BagWriter {
    file: OutputFile,
    compression: BagCompression,
    connections: BTreeMap<(Arc<str>, String), u32>,
    /// Connection records; the index repeats them.
    connection_records: Vec<Vec<u8>>,
    chunk: OpenChunk,
    chunks: Vec<WrittenChunk>,
    buffer: Vec<u8>,
}

#[derive(Default)]
struct OpenChunk {
    records: Vec<u8>,
    /// Per connection: log time and offset of every message.
    entries: BTreeMap<u32, Vec<(Stamp, u32)>>,
    /// First and last log time.
    range: Option<(Time, Time)>,
}

struct WrittenChunk {
    offset: u64,
    range: (Time, Time),
    counts: Vec<(u32, u32)>,
}

impl BagWriter {
    /// Starts a bag. It appears under its name when it is finished.
    pub(crate) fn create(path: &Path, compression: BagCompression) -> Result<Self, RecordingError> {
        let mut writer = Self {
            file: OutputFile::create(path)?,
            compression,
            connections: BTreeMap::new(),
            connection_records: Vec::new(),
            chunk: OpenChunk::default(),
            chunks: Vec::new(),
            buffer: Vec::new(),
        };
        writer.file.append(MAGIC)?;
        let header = writer.bag_header(0);
        writer.file.append(&header)?;
        Ok(writer)
    }

    /// The bag header record; it is overwritten when the index is complete.
    fn bag_header(&self, index_offset: u64) -> Vec<u8> {
        let fields: [Field<'_>; 4] = [
            (b"chunk_count", &(self.chunks.len() as u32).to_le_bytes()),
            (b"conn_count", &(self.connection_records.len() as u32).to_le_bytes()),
            (b"index_pos", &index_offset.to_le_bytes()),
            (b"op", &[Op::BagHeader as u8]),
        ];
        let header_bytes: usize = fields.iter().map(|(name, value)| 5 + name.len() + value.len()).sum();
        record(&fields, &vec![b' '; BAG_HEADER_BYTES - header_bytes])
    }

    fn connection(&mut self, message: &RecordedMessage) -> Result<u32, RecordingError> {
        let type_name = message.message.type_name();
        let key = (message.topic.clone(), type_name.to_owned());
        if let Some(id) = self.connections.get(&key) {
            return Ok(*id);
        }
        let (Some(md5sum), Some(definition)) = (md5sum(type_name), definition(type_name, Dialect::Ros1))
        else {
            return Err(RecordingError::Unwritable {
                detail: format!("messages of type {type_name} (topic {}) cannot be written", message.topic),
            });
        };
        let id = self.connection_records.len() as u32;
        let topic = message.topic.as_bytes();
        let mut description = Vec::new();
        push_field(&mut description, b"topic", topic);
        push_field(&mut description, b"type", type_name.as_bytes());
        push_field(&mut description, b"md5sum", md5sum.as_bytes());
        push_field(&mut description, b"message_definition", definition.as_bytes());
        if is_static_tf_topic(&message.topic) {
            push_field(&mut description, b"latching", b"1");
        }
        let fields: [Field<'_>; 3] =
            [(b"conn", &id.to_le_bytes()), (b"op", &[Op::Connection as u8]), (b"topic", topic)];
        let record = record(&fields, &description);
        self.chunk.records.extend_from_slice(&record);
        self.connection_records.push(record);
        self.connections.insert(key, id);
        Ok(id)
    }

    fn close_chunk(&mut self) -> Result<(), RecordingError> {
        let chunk = std::mem::take(&mut self.chunk);
        let Some(range) = chunk.range else { return Ok(()) };
        let (name, packed): (&[u8], _) = match self.compression {
            BagCompression::None => (b"none", chunk.records.clone()),
            BagCompression::Lz4 => (b"lz4", compress_lz4(&chunk.records)?),
            BagCompression::Bz2 => (b"bz2", compress_bz2(&chunk.records)?),
        };
        let offset = self.file.position();
        let size = (chunk.records.len() as u32).to_le_bytes();
        let fields: [Field<'_>; 3] = [(b"compression", name), (b"op", &[Op::Chunk as u8]), (b"size", &size)];
        self.file.append(&record(&fields, &packed))?;
        for (connection, entries) in &chunk.entries {
            let fields: [Field<'_>; 4] = [
                (b"conn", &connection.to_le_bytes()),
                (b"count", &(entries.len() as u32).to_le_bytes()),
                (b"op", &[Op::Index as u8]),
                (b"ver", &1u32.to_le_bytes()),
            ];
            let data: Vec<u8> = entries
                .iter()
                .flat_map(|(stamp, offset)| stamp.iter().copied().chain(offset.to_le_bytes()))
                .collect();
            self.file.append(&record(&fields, &data))?;
        }
        let counts = chunk.entries.iter().map(|(id, entries)| (*id, entries.len() as u32)).collect();
        self.chunks.push(WrittenChunk { offset, range, counts });
        Ok(())
    }

    fn write_index(&mut self) -> Result<(), RecordingError> {
        let index_offset = self.file.position();
        for record in &self.connection_records {
            self.file.append(record)?;
        }
        for chunk in &self.chunks {
            let fields: [Field<'_>; 6] = [
                (b"chunk_pos", &chunk.offset.to_le_bytes()),
                (b"count", &(chunk.counts.len() as u32).to_le_bytes()),
                (b"end_time", &stamp(chunk.range.1)?),
                (b"op", &[Op::ChunkInfo as u8]),
                (b"start_time", &stamp(chunk.range.0)?),
                (b"ver", &1u32.to_le_bytes()),
            ];
            let counts = chunk.counts.iter();
            let data: Vec<u8> =
                counts.flat_map(|(id, n)| [id.to_le_bytes(), n.to_le_bytes()]).flatten().collect();
            self.file.append(&record(&fields, &data))?;
        }
        let header = self.bag_header(index_offset);
        self.file.overwrite(MAGIC.len() as u64, &header)
    }
}

impl RecordingWriter for BagWriter {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let stamp = stamp(message.log_time)?;
        let bytes = encode(&message.message, false, std::mem::take(&mut self.buffer)).map_err(|error| {
            RecordingError::Unwritable {
                detail: format!("a message on {} cannot be written to a ROS 1 bag: {error}", message.topic),
            }
        })?;
        if bytes.len() > u32::MAX as usize - CHUNK_BYTES {
            return Err(RecordingError::Unwritable {
                detail: format!("a message on {} is too large for a ROS 1 bag (4 GiB)", message.topic),
            });
        }
        if self.chunk.records.len() + bytes.len() > CHUNK_BYTES {
            self.close_chunk()?;
        }
        let connection = self.connection(message)?;
        let offset = self.chunk.records.len() as u32;
        let fields: [Field<'_>; 3] =
            [(b"conn", &connection.to_le_bytes()), (b"op", &[Op::Message as u8]), (b"time", &stamp)];
        push_record(&mut self.chunk.records, &fields, &bytes);
        self.buffer = bytes;
        self.chunk.entries.entry(connection).or_default().push((stamp, offset));
        let (first, last) = self.chunk.range.unwrap_or((message.log_time, message.log_time));
        self.chunk.range = Some((first.min(message.log_time), last.max(message.log_time)));
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), RecordingError> {
        self.close_chunk()?;
        self.write_index()?;
        self.file.finish()
    }
}

/// Name and value of a field.
type Field<'a> = (&'a [u8], &'a [u8]);

fn push_field(bytes: &mut Vec<u8>, name: &[u8], value: &[u8]) {
    bytes.extend_from_slice(&((name.len() + 1 + value.len()) as u32).to_le_bytes());
    bytes.extend_from_slice(name);
    bytes.push(b'=');
    bytes.extend_from_slice(value);
}

fn push_record(bytes: &mut Vec<u8>, fields: &[Field<'_>], data: &[u8]) {
    let header_bytes: usize = fields.iter().map(|(name, value)| 5 + name.len() + value.len()).sum();
    bytes.extend_from_slice(&(header_bytes as u32).to_le_bytes());
    fields.iter().for_each(|(name, value)| push_field(bytes, name, value));
    bytes.extend_from_slice(&(data.len() as u32).to_le_bytes());
    bytes.extend_from_slice(data);
}

fn record(fields: &[Field<'_>], data: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(data.len() + 128);
    push_record(&mut bytes, fields, data);
    bytes
}

fn stamp(time: Time) -> Result<Stamp, RecordingError> {
    let (seconds, nanoseconds) = time.to_ros();
    let seconds = u32::try_from(seconds).map_err(|_| RecordingError::Unwritable {
        detail: "a log time is before 1970 or after 2106, which a ROS 1 bag cannot hold".to_owned(),
    })?;
    let mut bytes = seconds.to_le_bytes().into_iter().chain(nanoseconds.to_le_bytes());
    Ok(std::array::from_fn(|_| bytes.next().unwrap_or_default()))
}

/// The LZ4 frame that ROS writes: independent blocks of up to 4 MB and a checksum of the content.
fn compress_lz4(data: &[u8]) -> Result<Vec<u8>, RecordingError> {
    use lz4_flex::frame::{BlockMode, BlockSize, FrameEncoder, FrameInfo};
    let info = FrameInfo::new()
        .block_mode(BlockMode::Independent)
        .block_size(BlockSize::Max4MB)
        .content_checksum(true);
    let mut encoder = FrameEncoder::with_frame_info(info, Vec::new());
    encoder.write_all(data).map_err(compression_error)?;
    encoder.finish().map_err(|error| compression_error(error.into()))
}

fn compress_bz2(data: &[u8]) -> Result<Vec<u8>, RecordingError> {
    let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
    encoder.write_all(data).map_err(compression_error)?;
    encoder.finish().map_err(compression_error)
}

fn compression_error(error: std::io::Error) -> RecordingError {
    RecordingError::Unwritable { detail: format!("a chunk cannot be compressed: {error}") }
}
