//! What files are written through: the disk itself, or in tests one that fails.

use std::io::{self, Seek, SeekFrom, Write};

/// A file of the disk.
pub(crate) struct Disk<F>(pub F);

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

/// Called before a file is made durable and before it gets its name.
pub(crate) fn before_commit() -> io::Result<()> {
    #[cfg(feature = "faults")]
    crate::faults::before_write(&[])?;
    Ok(())
}
