//! Layer through which files are read and written. With the feature `faults` tests let its operations fail.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// A file whose operations can be made to fail in tests.
#[derive(Debug)]
pub struct Disk<F>(pub F);

impl<F> Disk<F> {
    /// The same file by reference, for code that reads or writes without owning it.
    pub fn shared(&self) -> Disk<&F> {
        Disk(&self.0)
    }
}

impl Disk<File> {
    /// Sets the length of the file, bytes.
    ///
    /// # Errors
    /// Those of the system.
    pub fn set_len(&self, bytes: u64) -> io::Result<()> {
        before_operation()?;
        self.0.set_len(bytes)
    }

    /// Waits until content and metadata are on the disk.
    ///
    /// # Errors
    /// Those of the system.
    pub fn sync_all(&self) -> io::Result<()> {
        before_operation()?;
        sync(&self.0)
    }

    /// Waits until the content is on the disk.
    ///
    /// # Errors
    /// Those of the system.
    pub fn sync_data(&self) -> io::Result<()> {
        before_operation()?;
        self.0.sync_data()
    }
}

/// Waits until a file or folder is on the disk. While a test plans faults it returns at once, because such a test
/// synchronises thousands of files.
pub(crate) fn sync(file: &File) -> io::Result<()> {
    #[cfg(feature = "faults")]
    if crate::faults::is_planned() {
        return Ok(());
    }
    file.sync_all()
}

/// Creates an unnamed temporary file in this folder, for data that are kept on disk. The system removes it when its
/// last handle is closed, also if the process is killed.
///
/// # Errors
/// The folder is missing or not writable.
pub fn nameless_file(folder: &Path) -> io::Result<Disk<File>> {
    before_operation()?;
    tempfile::tempfile_in(folder).map(Disk)
}

impl<F: Read> Read for Disk<F> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        #[cfg(feature = "faults")]
        let bytes = crate::faults::before_read(bytes)?;
        self.0.read(bytes)
    }
}

impl<F: Write> Write for Disk<F> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        #[cfg(feature = "faults")]
        let bytes = crate::faults::before_write(bytes)?;
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl<F: Seek> Seek for Disk<F> {
    fn seek(&mut self, position: SeekFrom) -> io::Result<u64> {
        self.0.seek(position)
    }
}

/// Fault injection point: called before a file is created, truncated, synchronised or renamed.
pub(crate) fn before_operation() -> io::Result<()> {
    #[cfg(feature = "faults")]
    crate::faults::before_write(&[])?;
    Ok(())
}
