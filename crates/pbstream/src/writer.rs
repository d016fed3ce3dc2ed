//! Writes a pbstream message by message and compresses on all cores.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use prost::Message as _;

use portolan_atomic_file::AtomicFile;

use crate::error::PbstreamError;
use crate::frames::MAGIC;
use crate::gzip::gzip_into;
use crate::ordered::OrderedWorkers;
use crate::proto::mapping::serialized_data::Data;
use crate::proto::mapping::{SerializationHeader, SerializedData};

/// The format version that is written.
pub const FORMAT_VERSION: u32 = 2;

/// Approximate size of a batch of messages that are compressed together, bytes. A batch fits into the caches,
/// and small messages share the overhead of a job.
const BATCH_BYTES: usize = 256 << 10;
/// Limits on batches that wait to be compressed or written: their number, and their size in bytes.
const MAX_BATCHES: usize = 8;
const MAX_WAITING_BYTES: usize = 32 << 20;

/// Writes a pbstream: header first, then messages in the order in which they are added. Memory does not grow
/// with the map, and the bytes do not depend on the number of threads.
///
/// The file appears when [`PbstreamWriter::finish`] succeeds; if the writer is dropped before, no file
/// remains.
pub struct PbstreamWriter {
    output: Output,
    path: PathBuf,
    batch: Batch,
    workers: OrderedWorkers<Batch, io::Result<Vec<u8>>>,
    /// Sizes of the batches in flight, bytes.
    in_flight: VecDeque<usize>,
    messages: u64,
}

enum Output {
    File(AtomicFile),
    Other(Box<dyn Write + Send>),
}

/// Messages that are compressed together.
#[derive(Default)]
struct Batch {
    items: Vec<Item>,
    /// Short messages, concatenated, so that a single measurement needs no allocation that is passed between
    /// threads.
    short: Vec<u8>,
    /// Size of all messages before compression, bytes.
    bytes: usize,
}

enum Item {
    /// Number of bytes in the buffer of short messages.
    Short(usize),
    Bytes(Vec<u8>),
    Message(Box<SerializedData>),
}

/// Maximum size of a short message, bytes.
const MOST_SHORT: usize = 1024;

impl PbstreamWriter {
    /// Starts a file.
    ///
    /// # Errors
    /// If the folder is missing or not writable.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, PbstreamError> {
        let path = path.as_ref();
        let file =
            AtomicFile::create(path).map_err(|e| PbstreamError::Write { path: e.path, source: e.source })?;
        Self::start(Output::File(file), path.to_owned())
    }

    /// Writes to any sink; `name` is for error messages.
    ///
    /// # Errors
    /// If writing fails.
    pub fn to_sink(
        sink: impl Write + Send + 'static,
        name: impl Into<PathBuf>,
    ) -> Result<Self, PbstreamError> {
        Self::start(Output::Other(Box::new(sink)), name.into())
    }

    fn start(mut output: Output, path: PathBuf) -> Result<Self, PbstreamError> {
        if let Err(source) = output.writer().write_all(&MAGIC) {
            return Err(PbstreamError::Write { path, source });
        }
        Ok(Self {
            output,
            path,
            batch: Batch::default(),
            workers: OrderedWorkers::new(pack),
            in_flight: VecDeque::new(),
            messages: 0,
        })
    }

    /// Writes the header, which must be the first message; see [`FORMAT_VERSION`].
    ///
    /// # Errors
    /// If writing fails.
    pub fn write_header(&mut self, format_version: u32) -> Result<(), PbstreamError> {
        let header = SerializationHeader { format_version, ..SerializationHeader::default() };
        self.write_bytes(header.encode_to_vec())
    }

    /// Writes one message of a known kind.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write(&mut self, data: Data) -> Result<(), PbstreamError> {
        let message = SerializedData { data: Some(data) };
        let size = message.encoded_len();
        if size > MOST_SHORT {
            return self.push(Item::Message(Box::new(message)), size);
        }
        message.encode(&mut self.batch.short).map_err(|error| PbstreamError::Write {
            path: self.path.clone(),
            source: io::Error::other(error),
        })?;
        self.push(Item::Short(size), size)
    }

    /// Writes one message, header or other, as it is.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write_bytes(&mut self, message: Vec<u8>) -> Result<(), PbstreamError> {
        let size = message.len();
        self.push(Item::Bytes(message), size)
    }

    /// Number of messages added so far.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Writes all remaining messages and gives the file its name.
    ///
    /// # Errors
    /// If writing fails.
    pub fn finish(mut self) -> Result<(), PbstreamError> {
        self.hand_in();
        while self.workers.len() > 0 {
            self.write_oldest()?;
        }
        match self.output {
            Output::File(file) => {
                file.commit().map_err(|e| PbstreamError::Write { path: e.path, source: e.source })
            }
            Output::Other(mut sink) => {
                sink.flush().map_err(|source| PbstreamError::Write { path: self.path, source })
            }
        }
    }

    fn push(&mut self, item: Item, size: usize) -> Result<(), PbstreamError> {
        self.batch.items.push(item);
        self.batch.bytes += size;
        self.messages += 1;
        if self.batch.bytes < BATCH_BYTES {
            return Ok(());
        }
        self.hand_in();
        while self.workers.len() > MAX_BATCHES || self.in_flight.iter().sum::<usize>() > MAX_WAITING_BYTES {
            self.write_oldest()?;
        }
        Ok(())
    }

    fn hand_in(&mut self) {
        if !self.batch.items.is_empty() {
            self.in_flight.push_back(self.batch.bytes);
            self.workers.push(std::mem::take(&mut self.batch));
        }
    }

    fn write_oldest(&mut self) -> Result<(), PbstreamError> {
        self.in_flight.pop_front();
        let Some(packed) = self.workers.pop() else { return Ok(()) };
        packed
            .and_then(|bytes| self.output.writer().write_all(&bytes))
            .map_err(|source| PbstreamError::Write { path: self.path.clone(), source })
    }
}

impl Output {
    fn writer(&mut self) -> &mut dyn Write {
        match self {
            Self::File(file) => file,
            Self::Other(sink) => sink,
        }
    }
}

/// Compresses a batch to records of the file.
fn pack(batch: Batch) -> io::Result<Vec<u8>> {
    let mut records = Vec::new();
    let mut short = &batch.short[..];
    for item in batch.items {
        match item {
            Item::Short(size) => {
                let (message, rest) = short.split_at_checked(size).ok_or_else(incomplete)?;
                short = rest;
                push_record(message, &mut records)?;
            }
            Item::Bytes(bytes) => push_record(&bytes, &mut records)?,
            Item::Message(message) => push_record(&message.encode_to_vec(), &mut records)?,
        }
    }
    Ok(records)
}

/// The error for missing bytes of a batch: the file is not written, because it would have a gap.
fn incomplete() -> io::Error {
    io::Error::other("a message was lost before it was written; please report it")
}

/// Appends a compressed message after its length.
fn push_record(message: &[u8], records: &mut Vec<u8>) -> io::Result<()> {
    let length_at = records.len();
    records.extend_from_slice(&[0; 8]);
    gzip_into(message, records)?;
    let record = records.get_mut(length_at..).and_then(<[u8]>::split_first_chunk_mut);
    let (length, packed) = record.ok_or_else(incomplete)?;
    *length = (packed.len() as u64).to_le_bytes();
    Ok(())
}
