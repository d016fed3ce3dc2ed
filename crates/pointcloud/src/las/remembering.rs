//! A writer that stores its first error.

use std::io::{Error, Seek, SeekFrom, Write};
use std::sync::{Arc, Mutex, PoisonError};

/// Writes until an error occurs. After it nothing is written and no error is returned, because the library
/// completes its file whenever it is dropped, and panics if that fails.
pub(super) struct Remembering<W> {
    inner: W,
    failure: Failure,
    /// Position as if no error had occurred: the library uses it for calculations.
    position: u64,
    length: u64,
}

/// The first error of a [`Remembering`], shared with other owners.
#[derive(Clone, Default)]
pub(super) struct Failure(Arc<Mutex<Option<Error>>>);

impl Failure {
    /// The first error, if there was one. Later calls return only its kind.
    pub fn get(&self) -> Option<Error> {
        let mut first = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let kind = first.as_ref().map(|error| Error::from(error.kind()));
        std::mem::replace(&mut *first, kind)
    }
}

impl<W> Remembering<W> {
    /// Writes to `inner` from its start.
    pub fn new(inner: W, failure: Failure) -> Self {
        Self { inner, failure, position: 0, length: 0 }
    }

    fn unless_failed(&mut self, act: impl FnOnce(&mut W) -> std::io::Result<()>) {
        let mut first = self.failure.0.lock().unwrap_or_else(PoisonError::into_inner);
        if first.is_none() {
            *first = act(&mut self.inner).err();
        }
    }
}

impl<W: Write> Write for Remembering<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.unless_failed(|inner| inner.write_all(bytes));
        self.position += bytes.len() as u64;
        self.length = self.length.max(self.position);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.unless_failed(Write::flush);
        Ok(())
    }
}

impl<W: Seek> Seek for Remembering<W> {
    fn seek(&mut self, place: SeekFrom) -> std::io::Result<u64> {
        self.unless_failed(|inner| inner.seek(place).map(drop));
        self.position = match place {
            SeekFrom::Start(position) => position,
            SeekFrom::Current(step) => self.position.saturating_add_signed(step),
            SeekFrom::End(step) => self.length.saturating_add_signed(step),
        };
        Ok(self.position)
    }
}
