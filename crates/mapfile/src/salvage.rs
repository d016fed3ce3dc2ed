//! Finds intact records in a damaged file.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use portolan_pbstream::RawMessage;
use portolan_pbstream::ReadLimits;
use portolan_pbstream::gunzip;

/// First bytes of every record after its size: gzip, deflate.
const GZIP_START: [u8; 3] = [0x1f, 0x8b, 8];
/// Size of the smallest gzip stream, bytes.
const MIN_RECORD: u64 = 18;
/// Size of the pieces in which the file is searched, bytes.
const PIECE: usize = 1 << 20;
/// Maximum number of bytes that the search unpacks in vain, in multiples of the length of the file. It bounds
/// the time for a file made to keep the search busy.
const MAX_WASTED_WORK: u64 = 16;

/// Reads records like a normal reader, but continues after damage with the next intact record.
pub(crate) struct Salvage {
    file: File,
    length: u64,
    position: u64,
    index: u64,
    limits: ReadLimits,
    wasted_work: u64,
    /// Number of records, or of runs of bytes, that could not be used.
    pub damaged: u64,
    /// Number of bytes in them.
    pub lost_bytes: u64,
}

impl Salvage {
    /// # Errors
    /// If the file cannot be opened.
    pub fn open(path: &Path, limits: ReadLimits) -> io::Result<Self> {
        let file = portolan_input::regular_file(path)?;
        let length = file.metadata()?.len();
        Ok(Self {
            file,
            length,
            // The magic number may be damaged too: it is skipped.
            position: 8,
            index: 0,
            limits,
            wasted_work: 0,
            damaged: 0,
            lost_bytes: 0,
        })
    }

    /// The next intact record, or none at the end.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn next_message(&mut self) -> io::Result<Option<RawMessage>> {
        while self.position < self.length {
            let start = self.position;
            if let Some(message) = self.record_at(start)? {
                return Ok(Some(message));
            }
            self.damaged += 1;
            // If a record follows at the expected offset, only this one is lost.
            let next = match self.size_at(start)?.map(|size| start + 8 + size) {
                Some(end) if end == self.length || self.size_at(end)?.is_some() => end,
                _ => self.search(start + 1)?,
            };
            self.lost_bytes += next - start;
            self.position = next;
        }
        Ok(None)
    }

    /// Unpacks the record at `start` and moves to its end.
    fn record_at(&mut self, start: u64) -> io::Result<Option<RawMessage>> {
        let Some(size) = self.size_at(start)? else { return Ok(None) };
        self.file.seek(SeekFrom::Start(start + 8))?;
        let mut payload = Vec::new();
        self.file.by_ref().take(size).read_to_end(&mut payload)?;
        match gunzip(&payload, self.limits.max_message_bytes) {
            Ok(bytes) => {
                let message = RawMessage { index: self.index, offset: start, bytes };
                self.index += 1;
                self.position = start + 8 + size;
                Ok(Some(message))
            }
            Err(_) => {
                self.wasted_work = self.wasted_work.saturating_add(size);
                Ok(None)
            }
        }
    }

    /// The size of the record at `start`, if it can be a record.
    fn size_at(&mut self, start: u64) -> io::Result<Option<u64>> {
        let mut head = [0; 11];
        if start.saturating_add(head.len() as u64) > self.length {
            return Ok(None);
        }
        self.file.seek(SeekFrom::Start(start))?;
        self.file.read_exact(&mut head)?;
        Ok(size_in(&head, self.length - start, &self.limits))
    }

    /// The start of the next intact record at or after `from`, or the end of the file.
    fn search(&mut self, from: u64) -> io::Result<u64> {
        let mut from = from;
        while from < self.length && self.wasted_work / MAX_WASTED_WORK <= self.length {
            self.file.seek(SeekFrom::Start(from))?;
            let mut piece = Vec::new();
            self.file.by_ref().take((PIECE + 10) as u64).read_to_end(&mut piece)?;
            for (offset, head) in (from..).zip(piece.windows(11)) {
                if size_in(head, self.length - offset, &self.limits).is_none() {
                    continue;
                }
                let (index, position) = (self.index, self.position);
                if self.record_at(offset)?.is_some() {
                    (self.index, self.position) = (index, position);
                    return Ok(offset);
                }
                if self.wasted_work / MAX_WASTED_WORK > self.length {
                    return Ok(self.length);
                }
            }
            from = from.saturating_add(PIECE as u64);
        }
        Ok(self.length)
    }
}

/// The size from the first eleven bytes of a record; none if it is not plausible for `available` bytes.
fn size_in(head: &[u8], available: u64, limits: &ReadLimits) -> Option<u64> {
    let (size, start) = head.split_first_chunk::<8>()?;
    let size = u64::from_le_bytes(*size);
    let fits =
        (MIN_RECORD..=limits.max_compressed_bytes).contains(&size) && size.checked_add(8)? <= available;
    (fits && start == GZIP_START).then_some(size)
}
