//! Files that appear whole or not at all.

use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use portolan_unfinished::Unfinished;

use crate::error::CloudError;

/// A file that is written under a temporary name beside its place and renamed when it is complete. Dropped
/// before that, it vanishes.
pub(crate) struct Output {
    pub path: PathBuf,
    temporary: PathBuf,
    unfinished: Option<Unfinished>,
    writer: Option<BufWriter<File>>,
}

impl Output {
    pub fn create(path: &Path) -> Result<Self, CloudError> {
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".part");
        let temporary = path.with_file_name(name);
        // E57 files are read while they are written.
        let open = || File::options().read(true).write(true).create(true).truncate(true).open(&temporary);
        let opened = Unfinished::create(&temporary, open);
        let (unfinished, file) = opened.map_err(|e| CloudError::write(path, e))?;
        let writer = Some(BufWriter::with_capacity(1 << 18, file));
        Ok(Self { path: path.to_owned(), temporary, unfinished: Some(unfinished), writer })
    }

    pub fn append(&mut self, bytes: &[u8]) -> Result<(), CloudError> {
        let result = self.writer.as_mut().map_or(Ok(()), |writer| writer.write_all(bytes));
        result.map_err(|e| CloudError::write(&self.path, e))
    }

    /// Replaces bytes at the start.
    pub fn overwrite(&mut self, offset: u64, bytes: &[u8]) -> Result<(), CloudError> {
        let Some(writer) = self.writer.as_mut() else { return Ok(()) };
        let result = writer
            .seek(SeekFrom::Start(offset))
            .and_then(|_| writer.write_all(bytes))
            .and_then(|()| writer.seek(SeekFrom::End(0)).map(drop));
        result.map_err(|e| CloudError::write(&self.path, e))
    }

    /// A handle for a library that writes the file itself, without a buffer.
    pub fn handle(&self) -> Result<File, CloudError> {
        let file = self.writer.as_ref().map(|writer| writer.get_ref().try_clone());
        let file = file.unwrap_or_else(|| Err(std::io::Error::other("the file is closed")));
        file.map_err(|e| CloudError::write(&self.path, e))
    }

    /// Gives the file its name.
    pub fn finish(&mut self) -> Result<(), CloudError> {
        let Some(mut writer) = self.writer.take() else { return Ok(()) };
        let result = writer.flush().and_then(|()| writer.get_ref().sync_data()).and_then(|()| {
            let rename = || std::fs::rename(&self.temporary, &self.path);
            self.unfinished.take().map_or_else(rename, |unfinished| unfinished.complete(rename))
        });
        if result.is_err() {
            let _ = std::fs::remove_file(&self.temporary);
        }
        result.map_err(|e| CloudError::write(&self.path, e))
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if self.writer.take().is_some() {
            // There is nobody to tell; the file is ours and useless.
            let _ = std::fs::remove_file(&self.temporary);
        }
    }
}

/// The folder that a file is in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Bytes that wait on disk until all of them are known, in a file without a name.
pub(crate) struct Spool {
    writer: BufWriter<File>,
    length: u64,
}

impl Spool {
    /// In the folder for temporary files: for what is only read.
    pub fn new() -> std::io::Result<Self> {
        Ok(Self::of(tempfile::tempfile()?))
    }

    /// In this folder: that of results has room for them, which the one for temporary files, often memory, may not.
    pub fn in_folder(folder: &Path) -> std::io::Result<Self> {
        Ok(Self::of(tempfile::tempfile_in(folder)?))
    }

    fn of(file: File) -> Self {
        Self { writer: BufWriter::with_capacity(1 << 16, file), length: 0 }
    }

    pub fn append(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        self.length += bytes.len() as u64;
        self.writer.write_all(bytes)
    }

    /// Bytes in it.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Fills `bytes` from a place.
    pub fn read_at(&mut self, offset: u64, bytes: &mut [u8]) -> std::io::Result<()> {
        self.writer.flush()?;
        let file = self.writer.get_mut();
        file.seek(SeekFrom::Start(offset))?;
        file.read_exact(bytes)?;
        file.seek(SeekFrom::End(0)).map(drop)
    }
}
