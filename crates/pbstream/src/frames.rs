//! The container format: a magic number, then records, each with a size and that number of compressed bytes
//! (`formats.md §2`).

use std::io::{self, Read};

use crate::error::{PbstreamError, RecordError};

/// The first eight bytes of every pbstream file.
pub const MAGIC: [u8; 8] = 0x7b1d_1f7b_5bf5_01db_u64.to_le_bytes();

/// One record, still compressed.
#[derive(Debug)]
pub struct Frame {
    /// Number of the record; the header is 0.
    pub index: u64,
    /// Position of the record's size field in the file.
    pub offset: u64,
    /// The gzip stream.
    pub payload: Vec<u8>,
}

/// Reads records one after another.
pub struct FrameReader {
    source: Box<dyn Read + Send>,
    /// Bytes in the source, if known.
    length: Option<u64>,
    position: u64,
    index: u64,
    max_compressed_bytes: u64,
    ended: bool,
}

impl FrameReader {
    /// Checks the magic number. `length` is the whole length of the source if it is known; stated sizes are
    /// checked against it before memory is reserved.
    pub fn new(
        mut source: Box<dyn Read + Send>,
        length: Option<u64>,
        max_compressed_bytes: u64,
    ) -> Result<Self, PbstreamError> {
        let mut start = Vec::new();
        let read = source.by_ref().take(8).read_to_end(&mut start);
        if let Err(error) = read {
            return Err(PbstreamError::Record { index: 0, offset: 0, problem: error.into() });
        }
        if start != MAGIC {
            return Err(match portolan_input::unwanted_kind_of(&start) {
                Some(kind) => PbstreamError::OtherKind { kind },
                None => PbstreamError::Magic { found: shown(&start) },
            });
        }
        Ok(Self { source, length, position: 8, index: 0, max_compressed_bytes, ended: false })
    }

    /// The position of the next record.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// The length of the source, if known.
    pub fn length(&self) -> Option<u64> {
        self.length
    }

    /// The next record, or none at the end. An error ends the iteration, because the start of the next record
    /// is unknown.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, PbstreamError> {
        if self.ended {
            return Ok(None);
        }
        let (index, offset) = (self.index, self.position);
        match self.read_record() {
            Ok(Some(payload)) => {
                self.index += 1;
                Ok(Some(Frame { index, offset, payload }))
            }
            Ok(None) => {
                self.ended = true;
                Ok(None)
            }
            Err(problem) => {
                self.ended = true;
                Err(PbstreamError::Record { index, offset, problem })
            }
        }
    }

    fn read_record(&mut self) -> Result<Option<Vec<u8>>, RecordError> {
        let mut size = [0; 8];
        match read_up_to(&mut self.source, &mut size)? {
            0 => return Ok(None),
            8 => self.position += 8,
            _ => return Err(RecordError::TruncatedSize),
        }
        let stated = u64::from_le_bytes(size);
        let available = self.length.map(|l| l.saturating_sub(self.position));
        if let Some(available) = available.filter(|a| *a < stated) {
            return Err(RecordError::Size { stated, available });
        }
        if stated > self.max_compressed_bytes {
            return Err(RecordError::CompressedTooLarge { stated, limit: self.max_compressed_bytes });
        }
        // Without a known length, memory grows with the data that are actually read.
        let reserve = if available.is_some() { stated } else { stated.min(1 << 20) };
        let mut payload = Vec::with_capacity(usize::try_from(reserve).unwrap_or(0));
        let read = self.source.by_ref().take(stated).read_to_end(&mut payload)? as u64;
        if read < stated {
            return Err(RecordError::Size { stated, available: read });
        }
        self.position = self.position.saturating_add(stated);
        Ok(Some(payload))
    }
}

/// The beginning of a file for messages: text as it is, other bytes in hexadecimal.
fn shown(start: &[u8]) -> String {
    match std::str::from_utf8(start) {
        Ok(text) if !text.contains(|c: char| c.is_control() && !c.is_whitespace()) => {
            portolan_input::quoted(text)
        }
        _ => start.iter().fold(String::new(), |shown, byte| format!("{shown}{byte:02x}")),
    }
}

/// Fills `buffer` until the source ends; returns the number of bytes read.
fn read_up_to(source: &mut dyn Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while let Some(rest) = buffer.get_mut(filled..).filter(|r| !r.is_empty()) {
        match source.read(rest) {
            Ok(0) => break,
            Ok(n) => filled += n,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(filled)
}
