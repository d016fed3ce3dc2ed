//! Canonical Huffman codes of at most 20 bits.

use std::io::Result;

use crate::bits::Bits;
use crate::damaged;

const MAX_LENGTH: usize = 20;
/// Codes of up to this number of bits are decoded by one table lookup.
const QUICK: u32 = 10;
/// Maximum number of symbols: 256 values, the two digits of runs less one, and the end of the block.
pub(crate) const MAX_SYMBOLS: usize = 258;

/// One table of codes.
pub(crate) struct Codes {
    /// By the next [`QUICK`] bits: symbol and, in the low five bits, length of its code; zero if the code is
    /// longer.
    quick: [u16; 1 << QUICK],
    /// By length: the first code that is too large for this length, in the top bits of 64 (the largest value
    /// if there is none).
    bound: [u64; MAX_LENGTH + 1],
    /// By length: offset from a code of this length to the index of its symbol.
    offset: [i32; MAX_LENGTH + 1],
    /// Sorted by length of code, then by value.
    symbols: [u16; MAX_SYMBOLS],
}

impl Default for Codes {
    fn default() -> Self {
        Self {
            quick: [0; 1 << QUICK],
            bound: [0; MAX_LENGTH + 1],
            offset: [0; MAX_LENGTH + 1],
            symbols: [0; MAX_SYMBOLS],
        }
    }
}

impl Codes {
    /// Reads the code lengths of symbols 0 to `symbols` - 1.
    pub(crate) fn read(&mut self, bits: &mut Bits<'_>, symbols: usize) -> Result<()> {
        let mut lengths = [0u8; MAX_SYMBOLS];
        let mut length = bits.take(5)?;
        for of_symbol in lengths.iter_mut().take(symbols) {
            while bits.take(1)? == 1 {
                length = if bits.take(1)? == 0 { length + 1 } else { length.wrapping_sub(1) };
                if !(1..=MAX_LENGTH as u32).contains(&length) {
                    return Err(damaged("a code has an impossible length"));
                }
            }
            if !(1..=MAX_LENGTH as u32).contains(&length) {
                return Err(damaged("a code has an impossible length"));
            }
            *of_symbol = length as u8;
        }
        self.assign(lengths.get(..symbols).unwrap_or(&lengths))
    }

    /// Assigns codes: shorter codes come first, and codes of one length are in the order of the symbols.
    fn assign(&mut self, lengths: &[u8]) -> Result<()> {
        self.quick.fill(0);
        let (mut code, mut number) = (0u32, 0usize);
        let by_length = self.offset.iter_mut().zip(&mut self.bound).enumerate().skip(1);
        for (length, (offset, bound)) in by_length {
            *offset = number as i32 - code as i32;
            for (symbol, _) in lengths.iter().enumerate().filter(|(_, of)| usize::from(**of) == length) {
                let place = self.symbols.get_mut(number).filter(|_| code >> length == 0);
                let place = place.ok_or_else(|| damaged("there are more codes than their lengths allow"))?;
                *place = symbol as u16;
                enter(&mut self.quick, code, length as u32, symbol as u16);
                (code, number) = (code + 1, number + 1);
            }
            let end = u64::from(code) << (64 - length);
            *bound = if code >> length != 0 { u64::MAX } else { end };
            code <<= 1;
        }
        Ok(())
    }

    /// Decodes the next symbol. [`Bits::refill`] must have provided 20 bits.
    #[inline]
    pub(crate) fn symbol(&self, bits: &mut Bits<'_>) -> Result<u16> {
        let entry = self.quick.get((bits.peek() >> (64 - QUICK)) as usize).copied().unwrap_or_default();
        if entry != 0 {
            bits.skip(u32::from(entry & 31));
            return Ok(entry >> 5);
        }
        self.long_symbol(bits)
    }

    fn long_symbol(&self, bits: &mut Bits<'_>) -> Result<u16> {
        let ahead = bits.peek();
        let by_length = self.bound.iter().zip(self.offset).enumerate().skip(QUICK as usize + 1);
        for (length, (bound, offset)) in by_length {
            if ahead < *bound {
                let code = (ahead >> (64 - length)) as i32;
                bits.skip(length as u32);
                let symbol = self.symbols.get((code + offset) as usize);
                return symbol.copied().ok_or_else(|| damaged("a code that means nothing"));
            }
        }
        Err(damaged("a code that means nothing"))
    }
}

/// Enters a symbol for all table indices that begin with its code.
fn enter(quick: &mut [u16; 1 << QUICK], code: u32, length: u32, symbol: u16) {
    let Some(rest) = QUICK.checked_sub(length) else { return };
    let first = (code << rest) as usize;
    if let Some(entries) = quick.get_mut(first..first + (1 << rest)) {
        entries.fill(symbol << 5 | length as u16);
    }
}
