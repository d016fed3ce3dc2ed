//! Output files with a position and a checksum.

use std::io::Write as _;
use std::path::Path;

use portolan_atomic_file::{AtomicFile, WriteError};

use crate::RecordingError;

/// A file that appears only when it is complete.
pub(crate) struct OutputFile {
    file: AtomicFile,
    position: u64,
    crc: crc32fast::Hasher,
}

fn failed(error: WriteError) -> RecordingError {
    RecordingError::Write { path: error.path, source: error.source }
}

impl OutputFile {
    pub(crate) fn create(path: &Path) -> Result<Self, RecordingError> {
        let file = AtomicFile::create(path).map_err(failed)?;
        Ok(Self { file, position: 0, crc: crc32fast::Hasher::new() })
    }

    /// Bytes written so far.
    pub(crate) fn position(&self) -> u64 {
        self.position
    }

    /// CRC-32 of everything appended since the start or the last [`Self::restart_crc`].
    pub(crate) fn crc(&self) -> u32 {
        self.crc.clone().finalize()
    }

    /// Starts a new checksum.
    pub(crate) fn restart_crc(&mut self) {
        self.crc.reset();
    }

    /// Appends bytes.
    pub(crate) fn append(&mut self, bytes: &[u8]) -> Result<(), RecordingError> {
        self.file.write_all(bytes).map_err(|source| failed(self.file.error(source)))?;
        self.crc.update(bytes);
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Replaces bytes that were already written.
    pub(crate) fn overwrite(&mut self, offset: u64, bytes: &[u8]) -> Result<(), RecordingError> {
        self.file.overwrite(offset, bytes).map_err(|source| failed(self.file.error(source)))
    }

    /// Completes the file and gives it its name.
    pub(crate) fn finish(self) -> Result<(), RecordingError> {
        self.file.commit().map_err(failed)
    }
}
