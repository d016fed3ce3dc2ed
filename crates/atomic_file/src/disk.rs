//! What files are written through: the disk itself, or in tests one that fails.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// A file of the disk.
#[derive(Debug)]
pub struct Disk<F>(pub F);

impl<F> Disk<F> {
    /// The same file, read and written by whoever has no more than a reference to it.
    pub fn shared(&self) -> Disk<&F> {
        Disk(&self.0)
    }
}

impl Disk<File> {
    /// Lets the file end after so many bytes.
    ///
    /// # Errors
    /// Those of the system.
    pub fn set_len(&self, bytes: u64) -> io::Result<()> {
        before_operation()?;
        self.0.set_len(bytes)
    }

    /// Waits until everything is on the disk.
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

/// Waits until a file or folder is on the disk; not where a test has the disk fail, which waits for thousands.
pub(crate) fn sync(file: &File) -> io::Result<()> {
    #[cfg(feature = "faults")]
    if crate::faults::is_planned() {
        return Ok(());
    }
    file.sync_all()
}

/// A file without a name in this folder, for what waits on disk; it is gone when nobody holds it, whatever happens.
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

/// Called before a file is made, before it is made durable and before it gets its name.
pub(crate) fn before_operation() -> io::Result<()> {
    #[cfg(feature = "faults")]
    crate::faults::before_write(&[])?;
    Ok(())
}
