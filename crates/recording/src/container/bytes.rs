//! Random access to the bytes of a recording, in a file or in memory.

use std::fs::File;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::UnpackedFile;
use crate::RecordingError;

/// Location of the bytes of a recording. Cheap to copy; every pass over a recording opens it again.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    /// A file.
    File(Arc<Path>),
    /// A temporary file with the decompressed bytes; it is deleted with the last copy of this value.
    Unpacked { original: Arc<Path>, file: Arc<UnpackedFile> },
    /// Bytes in memory, with a name for error messages.
    Memory { name: Arc<Path>, bytes: Arc<[u8]> },
}

impl Source {
    /// The path that the user gave.
    pub(crate) fn name(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Unpacked { original, .. } => original,
            Self::Memory { name, .. } => name,
        }
    }

    /// The file that holds the bytes; none for bytes in memory.
    pub(crate) fn file(&self) -> Option<&Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Unpacked { file, .. } => Some((**file).as_ref()),
            Self::Memory { .. } => None,
        }
    }

    /// Opens the bytes for reading.
    pub(crate) fn open(&self) -> Result<FileBytes, RecordingError> {
        let error = |source| RecordingError::Io { path: self.name().to_owned(), source };
        let (input, length): (Box<dyn ReadSeek>, u64) = match self {
            Self::Memory { bytes, .. } => (Box::new(Cursor::new(bytes.clone())), bytes.len() as u64),
            Self::File(_) | Self::Unpacked { .. } => {
                let mut file = File::open(self.file().unwrap_or(self.name())).map_err(error)?;
                let length = file.seek(SeekFrom::End(0)).map_err(error)?;
                (Box::new(file), length)
            }
        };
        Ok(FileBytes { name: self.name().to_owned(), input, length, buffer: Vec::new(), start: 0 })
    }
}

trait ReadSeek: Read + Seek + Send {}
impl<T: Read + Seek + Send> ReadSeek for T {}

/// An open recording: small reads go through a buffered window, chunks are read whole.
pub(crate) struct FileBytes {
    name: PathBuf,
    input: Box<dyn ReadSeek>,
    length: u64,
    buffer: Vec<u8>,
    start: u64,
}

/// Size of the window, bytes, so that neighbouring small records cost one read.
const WINDOW_BYTES: usize = 8192;

impl FileBytes {
    /// Size of the file when it was opened, bytes.
    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// `count` bytes from `offset`, fewer only at the end of the file. The caller must bound `count`: that
    /// much memory is used.
    pub(crate) fn peek(&mut self, offset: u64, count: usize) -> Result<&[u8], RecordingError> {
        let count = self.available(offset, count as u64);
        let inside = offset >= self.start
            && (offset - self.start).saturating_add(count as u64) <= self.buffer.len() as u64;
        if !inside {
            let mut buffer = std::mem::take(&mut self.buffer);
            self.read(offset, count.max(WINDOW_BYTES) as u64, &mut buffer)?;
            self.buffer = buffer;
            self.start = offset;
        }
        let from = (offset - self.start) as usize;
        let to = (from + count).min(self.buffer.len());
        Ok(self.buffer.get(from..to).unwrap_or_default())
    }

    /// Replaces `into` by `count` bytes from `offset`, fewer at the end of the file.
    pub(crate) fn read(&mut self, offset: u64, count: u64, into: &mut Vec<u8>) -> Result<(), RecordingError> {
        into.clear();
        let count = self.available(offset, count);
        into.reserve_exact(count);
        let input = &mut self.input;
        input
            .seek(SeekFrom::Start(offset))
            .and_then(|_| input.by_ref().take(count as u64).read_to_end(into))
            .map_err(|source| RecordingError::Io { path: self.name.clone(), source })?;
        Ok(())
    }

    fn available(&self, offset: u64, count: u64) -> usize {
        usize::try_from(count.min(self.length.saturating_sub(offset))).unwrap_or(usize::MAX)
    }
}
