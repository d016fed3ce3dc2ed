//! Writes MCAP files of the profile `ros2`.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use super::record::{
    CHANNEL, CHUNK, CHUNK_INDEX, DATA_END, FOOTER, HEADER, MAGIC, MESSAGE, MESSAGE_INDEX, RECORD_HEAD_BYTES,
    SCHEMA, STATISTICS, SUMMARY_OFFSET,
};
use crate::output_file::OutputFile;
use crate::{McapCompression, RecordedMessage, RecordingError, RecordingWriter};
use portolan_ros_messages::{Dialect, definition, encode};

/// Size at which a chunk is closed, bytes.
const CHUNK_BYTES: usize = 1 << 20;
const ZSTD_LEVEL: i32 = 3;

/// Writes an MCAP file with CDR messages, like a ROS 2 recording.
pub(crate) struct McapWriter {
    file: OutputFile,
    compression: McapCompression,
    /// Schema records by type, numbered from 1.
    schemas: BTreeMap<String, u16>,
    schema_records: Vec<Vec<u8>>,
    channels: BTreeMap<(Arc<str>, String), u16>,
    channel_records: Vec<Vec<u8>>,
    /// Messages per channel.
    counts: Vec<u64>,
    chunk: OpenChunk,
    /// Chunk index records.
    chunk_indexes: Vec<Vec<u8>>,
    range: Option<(u64, u64)>,
    buffer: Vec<u8>,
}

#[derive(Default)]
struct OpenChunk {
    records: Vec<u8>,
    /// Per channel: log time and offset of every message.
    entries: BTreeMap<u16, Vec<(u64, u64)>>,
    range: Option<(u64, u64)>,
}

impl McapWriter {
    /// Starts a file. It appears under its name when it is finished.
    pub(crate) fn create(path: &Path, compression: McapCompression) -> Result<Self, RecordingError> {
        let mut file = OutputFile::create(path)?;
        file.append(MAGIC)?;
        let header = RecordBytes::new(HEADER).string("ros2").string("portolan");
        file.append(&header.finish())?;
        Ok(Self {
            file,
            compression,
            schemas: BTreeMap::new(),
            schema_records: Vec::new(),
            channels: BTreeMap::new(),
            channel_records: Vec::new(),
            counts: Vec::new(),
            chunk: OpenChunk::default(),
            chunk_indexes: Vec::new(),
            range: None,
            buffer: Vec::new(),
        })
    }

    fn channel(&mut self, message: &RecordedMessage) -> Result<u16, RecordingError> {
        let type_name = message.message.type_name();
        let key = (message.topic.clone(), type_name.to_owned());
        if let Some(id) = self.channels.get(&key) {
            return Ok(*id);
        }
        let schema = self.schema(type_name)?;
        let id = u16::try_from(self.channel_records.len())
            .map_err(|_| unwritable("an MCAP file cannot hold more than 65536 topics".to_owned()))?;
        let metadata = bytes_of(|r| r.string("offered_qos_profiles").string(""));
        let record = RecordBytes::new(CHANNEL).u16(id).u16(schema).string(&message.topic).string("cdr");
        let record = record.bytes(&metadata).finish();
        self.chunk.records.extend_from_slice(&record);
        self.channel_records.push(record);
        self.counts.push(0);
        self.channels.insert(key, id);
        Ok(id)
    }

    fn schema(&mut self, type_name: &str) -> Result<u16, RecordingError> {
        if let Some(id) = self.schemas.get(type_name) {
            return Ok(*id);
        }
        let definition = definition(type_name, Dialect::Ros2)
            .ok_or_else(|| unwritable(format!("messages of type {type_name} cannot be written")))?;
        let id = self.schema_records.len() as u16 + 1; // there are nine types
        let name = type_name.replacen('/', "/msg/", 1);
        let record = RecordBytes::new(SCHEMA).u16(id).string(&name).string("ros2msg");
        let record = record.bytes(definition.as_bytes()).finish();
        self.chunk.records.extend_from_slice(&record);
        self.schema_records.push(record);
        self.schemas.insert(type_name.to_owned(), id);
        Ok(id)
    }

    fn close_chunk(&mut self) -> Result<(), RecordingError> {
        let chunk = std::mem::take(&mut self.chunk);
        let Some((first, last)) = chunk.range else { return Ok(()) };
        let (name, packed) = match self.compression {
            McapCompression::None => ("", None),
            McapCompression::Lz4 => ("lz4", Some(compress_lz4(&chunk.records))),
            McapCompression::Zstd => ("zstd", Some(zstd::bulk::compress(&chunk.records, ZSTD_LEVEL))),
        };
        let packed = packed
            .transpose()
            .map_err(|error| unwritable(format!("a chunk cannot be compressed: {error}")))?;
        let packed = packed.as_deref().unwrap_or(&chunk.records);
        let crc = crc32fast::hash(&chunk.records);
        let record = RecordBytes::new(CHUNK).u64(first).u64(last).u64(chunk.records.len() as u64).u32(crc);
        let record = record.string(name).long_bytes(packed).finish();
        let chunk_offset = self.file.position();
        self.file.append(&record)?;
        let indexes_offset = self.file.position();
        let mut index_offsets = RecordBytes::default();
        for (channel, entries) in &chunk.entries {
            index_offsets = index_offsets.u16(*channel).u64(self.file.position());
            let entries = entries.iter().fold(RecordBytes::default(), |r, (time, at)| r.u64(*time).u64(*at));
            let record = RecordBytes::new(MESSAGE_INDEX).u16(*channel).bytes(&entries.bytes);
            self.file.append(&record.finish())?;
        }
        let index = RecordBytes::new(CHUNK_INDEX).u64(first).u64(last).u64(chunk_offset);
        let index = index.u64(record.len() as u64).bytes(&index_offsets.bytes);
        let index = index.u64(self.file.position() - indexes_offset).string(name);
        let index = index.u64(packed.len() as u64).u64(chunk.records.len() as u64);
        self.chunk_indexes.push(index.finish());
        Ok(())
    }

    fn write_summary(&mut self) -> Result<(), RecordingError> {
        let data_crc = self.file.crc();
        self.file.append(&RecordBytes::new(DATA_END).u32(data_crc).finish())?;
        let summary_offset = self.file.position();
        self.file.restart_crc();
        let statistics = self.statistics();
        let mut groups = Vec::new();
        let sections = [
            (SCHEMA, &self.schema_records),
            (CHANNEL, &self.channel_records),
            (STATISTICS, &vec![statistics]),
            (CHUNK_INDEX, &self.chunk_indexes),
        ];
        for (op, records) in sections {
            let start = self.file.position();
            for record in records {
                self.file.append(record)?;
            }
            groups.push((op, start, self.file.position() - start));
        }
        let offsets = self.file.position();
        for (op, start, bytes) in groups.into_iter().filter(|(_, _, bytes)| *bytes > 0) {
            self.file.append(&RecordBytes::new(SUMMARY_OFFSET).u8(op).u64(start).u64(bytes).finish())?;
        }
        // The checksum covers the footer up to itself.
        let footer = RecordBytes::new(FOOTER).u64(summary_offset).u64(offsets).u32(0).finish();
        let (covered, _) = footer.split_at(footer.len() - 4);
        self.file.append(covered)?;
        let crc = self.file.crc();
        self.file.append(&crc.to_le_bytes())?;
        self.file.append(MAGIC)
    }

    fn statistics(&self) -> Vec<u8> {
        let counts = (0u16..).zip(&self.counts);
        let counts = counts.fold(RecordBytes::default(), |r, (channel, count)| r.u16(channel).u64(*count));
        let (first, last) = self.range.unwrap_or_default();
        let record = RecordBytes::new(STATISTICS).u64(self.counts.iter().sum());
        let record = record.u16(self.schema_records.len() as u16).u32(self.channel_records.len() as u32);
        let (attachments, metadata) = (0, 0);
        let record = record.u32(attachments).u32(metadata).u32(self.chunk_indexes.len() as u32);
        record.u64(first).u64(last).bytes(&counts.bytes).finish()
    }
}

impl RecordingWriter for McapWriter {
    fn write(&mut self, message: &RecordedMessage) -> Result<(), RecordingError> {
        let time = u64::try_from(message.log_time.unix_nanoseconds())
            .map_err(|_| unwritable("a log time is before 1970, which MCAP cannot hold".to_owned()))?;
        let bytes = encode(&message.message, true, std::mem::take(&mut self.buffer)).map_err(|error| {
            unwritable(format!("a message on {} cannot be written to an MCAP file: {error}", message.topic))
        })?;
        if self.chunk.records.len() + bytes.len() > CHUNK_BYTES {
            self.close_chunk()?;
        }
        let channel = self.channel(message)?;
        let offset = self.chunk.records.len() as u64;
        let count = self.counts.get_mut(usize::from(channel));
        let sequence = count.map_or(0, |count| {
            *count += 1;
            *count as u32
        });
        let head = RecordBytes::new(MESSAGE).u16(channel).u32(sequence).u64(time).u64(time);
        self.chunk.records.extend_from_slice(&head.finish_before(bytes.len()));
        self.chunk.records.extend_from_slice(&bytes);
        self.buffer = bytes;
        self.chunk.entries.entry(channel).or_default().push((time, offset));
        for range in [&mut self.chunk.range, &mut self.range] {
            let (first, last) = range.unwrap_or((time, time));
            *range = Some((first.min(time), last.max(time)));
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<(), RecordingError> {
        self.close_chunk()?;
        self.write_summary()?;
        self.file.finish()
    }
}

fn unwritable(detail: String) -> RecordingError {
    RecordingError::Unwritable { detail }
}

fn compress_lz4(data: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
    encoder.write_all(data)?;
    Ok(encoder.finish()?)
}

fn bytes_of(build: impl FnOnce(RecordBytes) -> RecordBytes) -> Vec<u8> {
    build(RecordBytes::default()).bytes
}

/// Builds a record or a part of one.
#[derive(Default)]
struct RecordBytes {
    bytes: Vec<u8>,
}

impl RecordBytes {
    /// Starts a record; its length is set at the end.
    fn new(op: u8) -> Self {
        let mut head = [0; RECORD_HEAD_BYTES];
        head[0] = op;
        Self { bytes: head.to_vec() }
    }

    fn finish(self) -> Vec<u8> {
        self.finish_before(0)
    }

    /// Sets the length of a record, of which `more` bytes follow.
    fn finish_before(mut self, more: usize) -> Vec<u8> {
        let length = (self.bytes.len() - RECORD_HEAD_BYTES + more) as u64;
        for (byte, value) in self.bytes.iter_mut().skip(1).zip(length.to_le_bytes()) {
            *byte = value;
        }
        self.bytes
    }

    fn raw(mut self, bytes: &[u8]) -> Self {
        self.bytes.extend_from_slice(bytes);
        self
    }

    fn u8(self, value: u8) -> Self {
        self.raw(&[value])
    }

    fn u16(self, value: u16) -> Self {
        self.raw(&value.to_le_bytes())
    }

    fn u32(self, value: u32) -> Self {
        self.raw(&value.to_le_bytes())
    }

    fn u64(self, value: u64) -> Self {
        self.raw(&value.to_le_bytes())
    }

    /// Bytes after their length in four bytes.
    fn bytes(self, bytes: &[u8]) -> Self {
        self.u32(bytes.len() as u32).raw(bytes)
    }

    /// Bytes after their length in eight bytes.
    fn long_bytes(self, bytes: &[u8]) -> Self {
        self.u64(bytes.len() as u64).raw(bytes)
    }

    fn string(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }
}
