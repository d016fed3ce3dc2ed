//! Bits of a stream, the most significant of each byte first.

use std::io::{Error, ErrorKind, Result};

/// Bits that are not yet read.
pub(crate) struct Bits<'a> {
    data: &'a [u8],
    /// First byte that is not in `buffer` at all.
    next: usize,
    /// The bits to come from the top, `count` of them; those below may already be right.
    buffer: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    pub(crate) fn new(data: &'a [u8]) -> Self {
        Self { data, next: 0, buffer: 0, count: 0 }
    }

    /// Sees to it that [`Bits::peek`] shows at least 56 bits; behind the end they are zero.
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

    /// The bits to come, the next one on top.
    #[inline]
    pub(crate) fn peek(&self) -> u64 {
        self.buffer
    }

    /// Goes on by `bits` of those that [`Bits::refill`] brought.
    #[inline]
    pub(crate) fn skip(&mut self, bits: u32) {
        self.buffer <<= bits;
        self.count -= bits;
    }

    /// The next one to 24 bits.
    ///
    /// # Errors
    /// The data end before.
    pub(crate) fn take(&mut self, bits: u32) -> Result<u32> {
        self.refill();
        let value = (self.buffer >> (64 - bits)) as u32;
        self.skip(bits);
        self.check().map(|()| value)
    }

    /// # Errors
    /// More bits were taken than there are.
    pub(crate) fn check(&self) -> Result<()> {
        // Bits behind the end are counted as if they were there.
        if self.next - (self.count / 8) as usize > self.data.len() {
            return Err(Error::new(ErrorKind::UnexpectedEof, "the data end within a stream"));
        }
        Ok(())
    }

    /// Goes on to the next whole byte.
    pub(crate) fn align_to_byte(&mut self) {
        self.skip(self.count % 8);
    }

    /// Whether every byte was begun.
    pub(crate) fn at_end(&self) -> bool {
        self.next - (self.count / 8) as usize >= self.data.len()
    }
}
