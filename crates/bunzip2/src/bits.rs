//! Reads the bits of a stream, the most significant bit of each byte first.

use std::io::{Error, ErrorKind, Result};

/// Bits that are not yet read.
pub(crate) struct Bits<'a> {
    data: &'a [u8],
    /// Index of the first byte that is not in `buffer` at all.
    next: usize,
    /// The next `count` bits, starting at the top; the bits below them may already be valid.
    buffer: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    pub(crate) fn new(data: &'a [u8]) -> Self {
        Self { data, next: 0, buffer: 0, count: 0 }
    }

    /// Ensures that [`Bits::peek`] has at least 56 bits; bits after the end are zero.
    #[inline]
    pub(crate) fn refill(&mut self) {
        let word = match self.data.get(self.next..self.next + 8) {
            Some(&[a, b, c, d, e, f, g, h]) => u64::from_be_bytes([a, b, c, d, e, f, g, h]),
            _ => self.last_word(),
        };
        self.buffer |= word >> self.count;
        let bytes = (63 - self.count) / 8;
        self.next += bytes as usize;
        self.count += 8 * bytes;
    }

    #[cold]
    fn last_word(&self) -> u64 {
        let mut word = [0; 8];
        for (byte, &data) in word.iter_mut().zip(self.data.get(self.next..).unwrap_or_default()) {
            *byte = data;
        }
        u64::from_be_bytes(word)
    }

    /// The next bits, starting at the top.
    #[inline]
    pub(crate) fn peek(&self) -> u64 {
        self.buffer
    }

    /// Consumes `bits` of the bits that [`Bits::refill`] provided.
    #[inline]
    pub(crate) fn skip(&mut self, bits: u32) {
        self.buffer <<= bits;
        self.count -= bits;
    }

    /// Consumes and returns the next 1 to 24 bits.
    ///
    /// # Errors
    /// If the data end before.
    pub(crate) fn take(&mut self, bits: u32) -> Result<u32> {
        self.refill();
        let value = (self.buffer >> (64 - bits)) as u32;
        self.skip(bits);
        self.check().map(|()| value)
    }

    /// # Errors
    /// If more bits were consumed than there are.
    pub(crate) fn check(&self) -> Result<()> {
        // Bits after the end were counted as if they existed.
        if self.next - (self.count / 8) as usize > self.data.len() {
            return Err(Error::new(ErrorKind::UnexpectedEof, "the data end within a stream"));
        }
        Ok(())
    }

    /// Skips to the next byte boundary.
    pub(crate) fn align_to_byte(&mut self) {
        self.skip(self.count % 8);
    }

    /// Whether at least one bit of every byte was consumed.
    pub(crate) fn at_end(&self) -> bool {
        self.next - (self.count / 8) as usize >= self.data.len()
    }
}
