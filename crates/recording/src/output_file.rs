//! Output files that appear whole or not at all.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use portolan_unfinished::Unfinished;

use crate::RecordingError;

/// A file that is written under a temporary name beside its place and renamed when it is complete.
/// Dropped before that, it vanishes.
pub(crate) struct OutputFile {
    path: PathBuf,
    temporary: PathBuf,
    unfinished: Option<Unfinished>,
    writer: Option<BufWriter<File>>,
    position: u64,
    crc: crc32fast::Hasher,
}

impl OutputFile {
    pub(crate) fn create(path: &Path) -> Result<Self, RecordingError> {
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        let temporary = path.with_file_name(name);
        let error = |source| RecordingError::Write { path: path.to_owned(), source };
        let created = Unfinished::create(&temporary, || File::create(&temporary));
        let (unfinished, file) = created.map_err(error)?;
        let (unfinished, writer) = (Some(unfinished), Some(BufWriter::with_capacity(1 << 16, file)));
        let crc = crc32fast::Hasher::new();
        Ok(Self { path: path.to_owned(), temporary, unfinished, writer, position: 0, crc })
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
        self.with_writer(|writer| writer.write_all(bytes))?;
        self.crc.update(bytes);
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Replaces bytes that were written before.
    pub(crate) fn overwrite(&mut self, offset: u64, bytes: &[u8]) -> Result<(), RecordingError> {
        let end = self.position;
        self.with_writer(|writer| {
            writer.seek(SeekFrom::Start(offset))?;
            writer.write_all(bytes)?;
            writer.seek(SeekFrom::Start(end)).map(drop)
        })
    }

    /// Gives the file its name.
    pub(crate) fn finish(mut self) -> Result<(), RecordingError> {
        self.with_writer(|writer| {
            writer.flush()?;
            writer.get_ref().sync_data()
        })?;
        let rename = || std::fs::rename(&self.temporary, &self.path);
        self.unfinished
            .take()
            .map_or_else(rename, |unfinished| unfinished.complete(rename))
            .map_err(|source| RecordingError::Write { path: self.path.clone(), source })?;
        self.writer = None;
        Ok(())
    }

    fn with_writer(
        &mut self,
        action: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
    ) -> Result<(), RecordingError> {
        let result = self.writer.as_mut().map_or(Ok(()), action);
        result.map_err(|source| RecordingError::Write { path: self.path.clone(), source })
    }
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        if self.writer.take().is_some() {
            // There is nobody to tell; the file is ours and useless.
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}
