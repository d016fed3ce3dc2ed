#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod bits;
mod block;
mod huffman;
mod inverse;
mod runs;

use std::io::{Error, ErrorKind, Result};

use bits::Bits;
use block::BlockReader;
use inverse::Inverse;

/// Magic number at the start of a block.
const BLOCK: u64 = 0x3141_5926_5359;
/// Magic number at the end of a stream.
const END_OF_STREAM: u64 = 0x1772_4538_5090;

/// Decompresses data; reuses its memory.
#[derive(Default)]
pub struct Unpacker {
    block: BlockReader,
    inverse: Inverse,
}

impl Unpacker {
    /// Appends the decompressed data of `packed` to `into`, which may grow to `limit` bytes. After an error
    /// `into` holds the data before it.
    ///
    /// # Errors
    /// If the data are not bzip2, cut off, damaged (checksums are verified), or longer than `limit`; with
    /// [`ErrorKind::Unsupported`] for randomised blocks, which versions before 1.0 wrote.
    pub fn unpack(&mut self, packed: &[u8], limit: usize, into: &mut Vec<u8>) -> Result<()> {
        let mut bits = Bits::new(packed);
        self.stream(&mut bits, limit, into)?;
        while !bits.at_end() {
            self.stream(&mut bits, limit, into)?;
        }
        Ok(())
    }

    fn stream(&mut self, bits: &mut Bits<'_>, limit: usize, into: &mut Vec<u8>) -> Result<()> {
        let largest = match (bits.take(24)?, bits.take(8)?) {
            (0x42_5a_68, digit @ 0x31..=0x39) => (digit as usize - 0x30) * 100_000,
            _ => return Err(damaged("no bzip2")),
        };
        let mut checksum = 0u32;
        loop {
            let magic = u64::from(bits.take(24)?) << 24 | u64::from(bits.take(24)?);
            let expected = bits.take(16)? << 16 | bits.take(16)?;
            match magic {
                BLOCK => {
                    let head = self.block.read(bits, largest)?;
                    if head.randomised {
                        return Err(Error::new(
                            ErrorKind::Unsupported,
                            "randomised blocks are not supported",
                        ));
                    }
                    let text = self.inverse.undo(self.block.transformed(), head.origin)?;
                    if runs::expand(text, limit, into)? != expected {
                        return Err(damaged("the checksum of a block is wrong"));
                    }
                    checksum = checksum.rotate_left(1) ^ expected;
                }
                END_OF_STREAM if expected == checksum => {
                    bits.align_to_byte();
                    return Ok(());
                }
                END_OF_STREAM => return Err(damaged("the checksum of a stream is wrong")),
                _ => return Err(damaged("neither a block nor the end of the stream")),
            }
        }
    }
}

fn damaged(what: &'static str) -> Error {
    Error::new(ErrorKind::InvalidData, what)
}

#[cfg(test)]
mod tests;
