//! Temporary files for decompressed data.

use std::io::{self, Write};
use std::path::Path;

use portolan_unfinished::Unfinished;
use tempfile::{NamedTempFile, TempPath};

/// A file in the folder for temporary files; it is deleted when this value is dropped.
#[derive(Debug)]
pub(crate) struct UnpackedFile {
    path: TempPath,
    _unfinished: Unfinished,
}

impl UnpackedFile {
    /// Writes the file.
    pub(crate) fn write<E: From<io::Error>>(
        content: impl FnOnce(&mut dyn Write) -> Result<(), E>,
    ) -> Result<Self, E> {
        let (unfinished, mut file) = Unfinished::create_named(NamedTempFile::new, NamedTempFile::path)?;
        content(&mut file)?;
        Ok(Self { path: file.into_temp_path(), _unfinished: unfinished })
    }
}

impl AsRef<Path> for UnpackedFile {
    fn as_ref(&self) -> &Path {
        &self.path
    }
}
