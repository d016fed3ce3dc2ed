//! A reader that fails when the stack of its thread has grown too far.
//!
//! On damaged times of points the decompressor of the library recurses once for every few bits of the file.
//! It reads a byte now and then meanwhile. That read fails before the stack overflows, which would abort the
//! process.

use std::cell::Cell;
use std::io::{self, Read, Seek, SeekFrom};

thread_local! {
    /// Address of the stack when the thread began to read.
    static BEGIN: Cell<Option<usize>> = const { Cell::new(None) };
}

/// Stores the address of the stack of this thread. Only threads that called it are limited.
pub(super) fn begin() {
    BEGIN.set(Some(here()));
}

/// Approximate address of the stack.
#[inline(never)]
fn here() -> usize {
    let marker = 0_u8;
    std::hint::black_box(&raw const marker).addr()
}

/// Fails to read when more than `most` bytes of the stack are in use.
#[derive(Debug)]
pub(super) struct Shallow<R> {
    inner: R,
    most: usize,
}

impl<R> Shallow<R> {
    pub fn new(inner: R, most: usize) -> Self {
        Self { inner, most }
    }
}

impl<R: Read> Read for Shallow<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let is_deep = BEGIN.get().is_some_and(|begin| begin.abs_diff(here()) > self.most);
        match is_deep {
            true => Err(io::Error::new(io::ErrorKind::InvalidData, "times of points that go on for ever")),
            false => self.inner.read(bytes),
        }
    }
}

impl<R: Seek> Seek for Shallow<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads a byte at each of `levels` levels of recursion.
    fn read_deep(reader: &mut dyn Read, levels: usize) -> io::Result<usize> {
        let mut room = [0_u8; 1024];
        reader.read_exact(&mut room[..1])?;
        match std::hint::black_box(&room).len().min(levels) {
            0 => Ok(0),
            _ => Ok(1 + read_deep(reader, levels - 1)?),
        }
    }

    #[test]
    fn nested_calls_end_before_a_stack_overflow() {
        let read = |levels| {
            begin();
            read_deep(&mut Shallow::new(io::repeat(1), 1 << 20), levels)
        };
        assert_eq!(read(100).unwrap(), 100);
        assert_eq!(read(1200).unwrap_err().kind(), io::ErrorKind::InvalidData);
    }
}
