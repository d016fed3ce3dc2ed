//! Writes files that appear complete or not at all.

use std::fs::File;
use std::io::{BufWriter, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

pub(crate) use portolan_atomic_file::folder_of;
use portolan_atomic_file::{AtomicFile, Disk, WriteError, nameless_file};

use crate::error::CloudError;

/// A file that appears when it is complete, or not at all.
pub(crate) struct Output {
    pub path: PathBuf,
    /// None when the file is complete.
    file: Option<AtomicFile>,
}

fn failed(error: WriteError) -> CloudError {
    CloudError::Write { path: error.path, source: error.source }
}

impl Output {
    /// # Errors
    /// The file cannot be created: the folder is missing or not writable, or there is a folder of this name.
    pub fn create(path: &Path) -> Result<Self, CloudError> {
        let file = AtomicFile::create(path).map_err(failed)?;
        Ok(Self { path: path.to_owned(), file: Some(file) })
    }

    /// # Errors
    /// Writing fails.
    pub fn append(&mut self, bytes: &[u8]) -> Result<(), CloudError> {
        let result = self.file.as_mut().map_or(Ok(()), |file| file.write_all(bytes));
        result.map_err(|e| CloudError::write(&self.path, e))
    }

    /// Overwrites bytes that have been written before.
    ///
    /// # Errors
    /// Writing fails, or the file is a pipe, which cannot seek back.
    pub fn overwrite(&mut self, offset: u64, bytes: &[u8]) -> Result<(), CloudError> {
        let result = self.file.as_mut().map_or(Ok(()), |file| file.overwrite(offset, bytes));
        result.map_err(|e| CloudError::write(&self.path, e))
    }

    /// A handle for a library that writes the file itself, without a buffer.
    ///
    /// # Errors
    /// The file is complete already, or the system has no handle left.
    pub fn handle(&self) -> Result<Disk<File>, CloudError> {
        let file = self.file.as_ref().map(AtomicFile::handle);
        let file = file.unwrap_or_else(|| Err(std::io::Error::other("the file is closed")));
        file.map_err(|e| CloudError::write(&self.path, e))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// Buffered bytes cannot be written, or the file cannot be renamed.
    pub fn finish(&mut self) -> Result<(), CloudError> {
        self.file.take().map_or(Ok(()), |file| file.commit().map_err(failed))
    }
}

/// Bytes buffered on disk until all of them are known, in a nameless file.
pub(crate) struct Spool {
    writer: BufWriter<Disk<File>>,
    length: u64,
}

impl Spool {
    /// Uses the folder for temporary files; for clouds that are only read.
    ///
    /// # Errors
    /// No file can be created there.
    pub fn new() -> std::io::Result<Self> {
        Self::in_folder(&std::env::temp_dir())
    }

    /// Uses this folder. The folder of results has enough space, which that for temporary files, often in
    /// memory, may not have.
    ///
    /// # Errors
    /// No file can be created there.
    pub fn in_folder(folder: &Path) -> std::io::Result<Self> {
        let writer = BufWriter::with_capacity(1 << 16, nameless_file(folder)?);
        Ok(Self { writer, length: 0 })
    }

    /// # Errors
    /// Writing fails.
    pub fn append(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.length += bytes.len() as u64;
        self.writer.write_all(bytes)
    }

    /// Number of bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Reads bytes from an offset until `bytes` is full.
    ///
    /// # Errors
    /// Flushing the buffer fails, reading fails, or there are fewer bytes after the offset.
    pub fn read_at(&mut self, offset: u64, bytes: &mut [u8]) -> std::io::Result<()> {
        self.writer.flush()?;
        let file = self.writer.get_mut();
        file.seek(SeekFrom::Start(offset))?;
        file.read_exact(bytes)?;
        file.seek(SeekFrom::End(0)).map(drop)
    }
}
