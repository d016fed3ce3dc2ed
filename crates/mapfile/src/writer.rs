//! Writing a pbstream message by message, packing on all cores.

use std::collections::VecDeque;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use prost::Message as _;

use crate::atomic_file::AtomicFile;
use crate::error::PbstreamError;
use crate::frames::MAGIC;
use crate::gzip::gzip;
use crate::ordered::OrderedWorkers;
use crate::proto::mapping::serialized_data::Data;
use crate::proto::mapping::{SerializationHeader, SerializedData};

/// The format version that is written.
pub const FORMAT_VERSION: u32 = 2;

/// Messages are packed in batches of about this many bytes; so much fits the caches, and small messages
/// do not pay for their job.
const BATCH_BYTES: usize = 256 << 10;
/// How much may wait to be packed or written.
const MAX_BATCHES: usize = 8;
const MAX_WAITING_BYTES: usize = 32 << 20;

/// Writes a pbstream: header first, then messages in the order in which they are handed in. Memory does
/// not grow with the map, and the bytes do not depend on the number of threads.
///
/// The file appears when [`PbstreamWriter::finish`] succeeds; dropped without that it leaves nothing.
pub struct PbstreamWriter {
    output: Output,
    path: PathBuf,
    batch: Vec<Item>,
    batch_bytes: usize,
    workers: OrderedWorkers<Vec<Item>, io::Result<Vec<u8>>>,
    /// Sizes of the batches under way.
    under_way: VecDeque<usize>,
    messages: u64,
}

enum Output {
    File(AtomicFile),
    Other(Box<dyn Write + Send>),
}

enum Item {
    Bytes(Vec<u8>),
    Message(Box<SerializedData>),
}

impl PbstreamWriter {
    /// Begins a file. Errors: the folder is missing or not writable.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, PbstreamError> {
        let path = path.as_ref();
        let file =
            AtomicFile::create(path).map_err(|e| PbstreamError::Write { path: e.path, source: e.source })?;
        Self::start(Output::File(file), path.to_owned())
    }

    /// Writes to anything; `name` is for error messages.
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
            batch: Vec::new(),
            batch_bytes: 0,
            workers: OrderedWorkers::new(pack),
            under_way: VecDeque::new(),
            messages: 0,
        })
    }

    /// Writes the header that must be the first message; see [`FORMAT_VERSION`].
    pub fn write_header(&mut self, format_version: u32) -> Result<(), PbstreamError> {
        self.write_bytes(SerializationHeader { format_version }.encode_to_vec())
    }

    /// Writes one message of a known kind.
    pub fn write(&mut self, data: Data) -> Result<(), PbstreamError> {
        let message = SerializedData { data: Some(data) };
        let size = message.encoded_len();
        self.push(Item::Message(Box::new(message)), size)
    }

    /// Writes one message as it is, header or other.
    pub fn write_bytes(&mut self, message: Vec<u8>) -> Result<(), PbstreamError> {
        let size = message.len();
        self.push(Item::Bytes(message), size)
    }

    /// How many messages were handed in.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Writes out everything and gives the file its name.
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
        self.batch.push(item);
        self.batch_bytes += size;
        self.messages += 1;
        if self.batch_bytes < BATCH_BYTES {
            return Ok(());
        }
        self.hand_in();
        while self.workers.len() > MAX_BATCHES || self.under_way.iter().sum::<usize>() > MAX_WAITING_BYTES {
            self.write_oldest()?;
        }
        Ok(())
    }

    fn hand_in(&mut self) {
        if !self.batch.is_empty() {
            self.workers.push(std::mem::take(&mut self.batch));
            self.under_way.push_back(std::mem::take(&mut self.batch_bytes));
        }
    }

    fn write_oldest(&mut self) -> Result<(), PbstreamError> {
        self.under_way.pop_front();
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

/// The records of a batch as they stand in the file.
fn pack(batch: Vec<Item>) -> io::Result<Vec<u8>> {
    let mut records = Vec::new();
    for item in batch {
        let payload = match item {
            Item::Bytes(bytes) => gzip(&bytes)?,
            Item::Message(message) => gzip(&message.encode_to_vec())?,
        };
        records.extend_from_slice(&(payload.len() as u64).to_le_bytes());
        records.extend_from_slice(&payload);
    }
    Ok(records)
}
