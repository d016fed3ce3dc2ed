//! Reads a pbstream message by message and decompresses ahead on all cores.

use std::collections::VecDeque;
use std::io::Read;
use std::path::Path;

use portolan_input::{Forward, regular_file};

use crate::decoded_size::{decoded_size, without_cells};
use crate::error::{PbstreamError, RecordError};
use crate::frames::{Frame, FrameReader};
use crate::gzip::{GzipError, gunzip};
use crate::message::{Message, MessageKind, RawMessage};
use crate::ordered::OrderedWorkers;
use crate::proto::mapping::serialized_data::Data;

/// Size limits of a batch of records, which is decompressed as one job; smaller jobs have more overhead than
/// gain.
const BATCH_BYTES: usize = 128 << 10;
const BATCH_RECORDS: usize = 512;
/// Limits on read-ahead: two batches for each core, at most eight, and 4 MiB of compressed data.
const MAX_BATCHES: usize = 8;
const MAX_AHEAD_BYTES: usize = 4 << 20;
/// Maximum decompressed size of a batch that is read ahead, bytes; larger records are decompressed when they
/// are requested. So read-ahead never holds more than eight times this, even if every record is a gzip bomb.
const MAX_BATCH_UNPACKED: usize = 8 << 20;
/// The same limit for the memory of its decoded messages, bytes.
const MAX_BATCH_DECODED: u64 = 32 << 20;

/// Limits on the memory that a file can make the reader allocate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadLimits {
    /// Maximum size of a record in the file, bytes.
    pub max_compressed_bytes: u64,
    /// Maximum size of an uncompressed message, bytes. 512 MiB hold the pose graph of a map with some
    /// millions of constraints, or a grid with 100 million cells.
    pub max_message_bytes: usize,
}

impl Default for ReadLimits {
    fn default() -> Self {
        Self { max_compressed_bytes: 512 << 20, max_message_bytes: 512 << 20 }
    }
}

/// Reads the messages of a pbstream one by one, as bytes. Nothing is lost, not even unknown fields and
/// messages.
///
/// An error within one record (damaged compression) does not end the iteration: the records after it follow.
/// If the file is cut off, the error is the last item.
pub struct PbstreamReader {
    records: Records<RawMessage>,
}

impl PbstreamReader {
    /// Opens a file with the default limits.
    ///
    /// # Errors
    /// As for [`Self::open_with`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self, PbstreamError> {
        Self::open_with(path, ReadLimits::default())
    }

    /// Opens a file.
    ///
    /// # Errors
    /// If the file is missing, cannot be read, or is not a pbstream.
    pub fn open_with(path: impl AsRef<Path>, limits: ReadLimits) -> Result<Self, PbstreamError> {
        Ok(Self { records: Records::new(open_frames(path.as_ref(), limits)?, limits, RAW) })
    }

    /// Reads from any source; `length` is its whole length in bytes if it is known.
    ///
    /// # Errors
    /// If the source cannot be read, or is not a pbstream.
    pub fn from_source(
        source: impl Read + Send + 'static,
        length: Option<u64>,
        limits: ReadLimits,
    ) -> Result<Self, PbstreamError> {
        let frames = FrameReader::new(Box::new(source), length, limits.max_compressed_bytes)?;
        Ok(Self { records: Records::new(frames, limits, RAW) })
    }

    /// The next message, or none at the end.
    ///
    /// # Errors
    /// If the source cannot be read, or the next message is damaged or larger than the limits.
    pub fn next_message(&mut self) -> Result<Option<RawMessage>, PbstreamError> {
        self.records.next_record()
    }

    /// Bytes read from the file so far, including messages that were read ahead; for progress.
    pub fn bytes_read(&self) -> u64 {
        self.records.bytes_read()
    }

    /// The length of the file, if known.
    pub fn length(&self) -> Option<u64> {
        self.records.length()
    }
}

impl Iterator for PbstreamReader {
    type Item = Result<RawMessage, PbstreamError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_message().transpose()
    }
}

/// Opens a file or pipe and checks its magic number.
pub(crate) fn open_frames(path: &Path, limits: ReadLimits) -> Result<FrameReader, PbstreamError> {
    let open = |source| PbstreamError::Open { path: path.to_owned(), source };
    let input = Forward::open(path).map_err(open)?;
    let length = input.length();
    FrameReader::new(Box::new(input), length, limits.max_compressed_bytes)
}

/// Rejects pipes where a map must be read more than once.
///
/// # Errors
/// If it is a pipe, or cannot be opened.
pub fn must_be_a_file(path: &Path) -> Result<(), PbstreamError> {
    let opened = regular_file(path).map(drop);
    opened.map_err(|source| PbstreamError::Open { path: path.to_owned(), source })
}

/// A decoded message.
pub(crate) struct Decoded {
    pub index: u64,
    pub offset: u64,
    /// Size of the uncompressed message, bytes.
    pub size: usize,
    /// Number of cells that were not decoded.
    pub cells: u64,
    pub message: Message,
}

/// A processing step for decompressed records, and the memory that its result takes, bytes.
pub(crate) struct Step<T> {
    run: fn(RawMessage) -> Unpacked<T>,
    size: fn(&RawMessage) -> u64,
}

impl<T> Clone for Step<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Step<T> {}

/// Returns messages as bytes.
const RAW: Step<RawMessage> = Step { run: Ok, size: |raw| raw.bytes.len() as u64 };
/// Decodes messages.
pub(crate) const DECODE: Step<Decoded> = Step { run: decode, size: |raw| decoded_size(&raw.bytes) };
/// Decodes messages for summaries: cells of 2D grids are only counted, and nodes have no content.
pub(crate) const DECODE_SUMMARY: Step<Decoded> = Step {
    run: decode_summary,
    size: |raw| match raw.kind() {
        MessageKind::Submap | MessageKind::Node => raw.bytes.len() as u64,
        _ => decoded_size(&raw.bytes),
    },
};

/// Decodes a message; an error names the message.
fn decode(raw: RawMessage) -> Result<Decoded, PbstreamError> {
    let RawMessage { index, offset, ref bytes } = raw;
    match raw.decode() {
        Ok(message) => Ok(Decoded { index, offset, size: bytes.len(), cells: 0, message }),
        Err(problem) => Err(PbstreamError::Record { index, offset, problem }),
    }
}

fn decode_summary(mut raw: RawMessage) -> Result<Decoded, PbstreamError> {
    if raw.kind() != MessageKind::Submap {
        let mut decoded = decode(raw)?;
        if let Message::Data(data) = &mut decoded.message
            && let Data::Node(node) = &mut **data
        {
            node.node_data = None;
        }
        return Ok(decoded);
    }
    let size = raw.bytes.len();
    let Some((bytes, cells)) = without_cells(&raw.bytes) else { return decode(raw) };
    raw.bytes = bytes;
    decode(raw).map(|decoded| Decoded { size, cells, ..decoded })
}

type Unpacked<T> = Result<T, PbstreamError>;

/// Reads records ahead: they are decompressed and processed by `step` before they are requested.
pub(crate) struct Records<T> {
    frames: FrameReader,
    limits: ReadLimits,
    step: Step<T>,
    max_batches: usize,
    workers: OrderedWorkers<Vec<Frame>, Vec<Ahead<T>>>,
    ready: VecDeque<Ahead<T>>,
    /// Compressed sizes of the batches in flight, bytes.
    in_flight: VecDeque<usize>,
    /// The end of the file, or an error, after all batches in flight.
    end: Option<Result<(), PbstreamError>>,
}

enum Ahead<T> {
    Done(Unpacked<T>),
    /// Too large to decompress ahead; decompressed when it is requested.
    Later(Frame),
}

impl<T: Send + 'static> Records<T> {
    pub(crate) fn new(frames: FrameReader, limits: ReadLimits, step: Step<T>) -> Self {
        let work = move |batch: Vec<Frame>| unpack_batch(batch, limits, step);
        Self {
            frames,
            limits,
            step,
            max_batches: (2 * rayon::current_num_threads()).clamp(2, MAX_BATCHES),
            workers: OrderedWorkers::new(work),
            ready: VecDeque::new(),
            in_flight: VecDeque::new(),
            end: None,
        }
    }

    pub(crate) fn next_record(&mut self) -> Result<Option<T>, PbstreamError> {
        loop {
            if let Some(record) = self.ready.pop_front() {
                return match record {
                    Ahead::Done(result) => result.map(Some),
                    Ahead::Later(frame) => {
                        unpack(&frame, self.limits.max_message_bytes).and_then(self.step.run).map(Some)
                    }
                };
            }
            self.read_ahead();
            self.in_flight.pop_front();
            match self.workers.pop() {
                Some(batch) => self.ready = batch.into(),
                // The error is reported once; the next call returns the end.
                None => {
                    return match self.end.replace(Ok(())) {
                        Some(Err(error)) => Err(error),
                        _ => Ok(None),
                    };
                }
            }
        }
    }

    pub(crate) fn bytes_read(&self) -> u64 {
        self.frames.position()
    }

    pub(crate) fn length(&self) -> Option<u64> {
        self.frames.length()
    }

    fn read_ahead(&mut self) {
        while self.end.is_none()
            && self.workers.len() < self.max_batches
            && self.in_flight.iter().sum::<usize>() < MAX_AHEAD_BYTES
        {
            let mut batch = Vec::new();
            let mut bytes = 0;
            while bytes < BATCH_BYTES && batch.len() < BATCH_RECORDS && self.end.is_none() {
                match self.frames.next_frame() {
                    Ok(Some(frame)) => {
                        bytes += frame.payload.len();
                        batch.push(frame);
                    }
                    Ok(None) => self.end = Some(Ok(())),
                    Err(error) => self.end = Some(Err(error)),
                }
            }
            if !batch.is_empty() {
                self.in_flight.push_back(bytes);
                self.workers.push(batch);
            }
        }
    }
}

fn unpack_batch<T>(batch: Vec<Frame>, limits: ReadLimits, step: Step<T>) -> Vec<Ahead<T>> {
    let (mut room, mut room_decoded) = (MAX_BATCH_UNPACKED, MAX_BATCH_DECODED);
    let mut unpack_ahead = |frame: Frame| match unpack(&frame, room.min(limits.max_message_bytes)) {
        Err(PbstreamError::Record { problem: RecordError::Gzip(GzipError::TooLarge { .. }), .. }) => {
            Ahead::Later(frame)
        }
        Ok(raw) => match room_decoded.checked_sub((step.size)(&raw)) {
            Some(rest) => {
                room = room.saturating_sub(raw.bytes.len());
                room_decoded = rest;
                Ahead::Done((step.run)(raw))
            }
            None => Ahead::Later(frame),
        },
        Err(error) => Ahead::Done(Err(error)),
    };
    batch.into_iter().map(&mut unpack_ahead).collect()
}

fn unpack(frame: &Frame, limit: usize) -> Result<RawMessage, PbstreamError> {
    let Frame { index, offset, ref payload } = *frame;
    match gunzip(payload, limit) {
        Ok(bytes) => Ok(RawMessage { index, offset, bytes }),
        Err(error) => Err(PbstreamError::Record { index, offset, problem: error.into() }),
    }
}
