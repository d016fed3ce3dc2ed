//! Decodes a block from its bits to the transformed text.

use std::io::Result;

use crate::bits::Bits;
use crate::damaged;
use crate::huffman::{Codes, MAX_SYMBOLS};

const MAX_TABLES: usize = 6;
/// Number of symbols that are coded with the same table.
const GROUP: usize = 50;
const RUN_A: u16 = 0;
const RUN_B: u16 = 1;

/// The header of a block.
#[derive(Clone, Copy)]
pub(crate) struct Head {
    /// Whether single bits of the text were inverted.
    pub(crate) randomised: bool,
    /// Index of the text among the sorted rotations.
    pub(crate) origin: usize,
}

/// The last bytes of the sorted rotations of a block.
pub(crate) struct Transformed {
    /// Buffer for the largest block and [`SPARE`] more bytes.
    room: Vec<u8>,
    length: usize,
    /// Number of occurrences of each byte.
    pub(crate) counts: [u32; 256],
}

/// Runs are written in pieces of this size, bytes; one piece is enough for most runs.
const SPARE: usize = 16;

impl Default for Transformed {
    fn default() -> Self {
        Self { room: Vec::new(), length: 0, counts: [0; 256] }
    }
}

impl Transformed {
    pub(crate) fn bytes(&self) -> &[u8] {
        self.room.get(..self.length).unwrap_or_default()
    }

    /// Clears it for a block of at most `largest` bytes.
    fn begin(&mut self, largest: usize) {
        self.room.resize(largest + SPARE, 0);
        self.length = 0;
        self.counts = [0; 256];
    }

    #[inline]
    fn push(&mut self, byte: u8) -> Result<()> {
        let place = self.room.get_mut(self.length).ok_or_else(too_long)?;
        *place = byte;
        self.length += 1;
        self.count(byte, 1);
        Ok(())
    }

    #[inline]
    fn push_run(&mut self, byte: u8, length: usize) -> Result<()> {
        let end = self.length + length;
        if end + SPARE > self.room.len() {
            return Err(too_long());
        }
        while self.length < end {
            let room = self.room.get_mut(self.length..self.length + SPARE).ok_or_else(too_long)?;
            room.fill(byte);
            self.length += SPARE;
        }
        self.length = end;
        self.count(byte, length as u32);
        Ok(())
    }

    #[inline]
    fn count(&mut self, byte: u8, more: u32) {
        // Every byte has a count.
        if let Some(count) = self.counts.get_mut(usize::from(byte)) {
            *count += more;
        }
    }
}

fn too_long() -> std::io::Error {
    damaged("a block that is too long")
}

/// Decodes blocks.
#[derive(Default)]
pub(crate) struct BlockReader {
    tables: [Codes; MAX_TABLES],
    selectors: Vec<u8>,
    transformed: Transformed,
}

impl BlockReader {
    /// The last block that was read.
    pub(crate) fn transformed(&self) -> &Transformed {
        &self.transformed
    }

    /// Reads a block of at most `largest` bytes, starting after its checksum.
    pub(crate) fn read(&mut self, bits: &mut Bits<'_>, largest: usize) -> Result<Head> {
        self.transformed.begin(largest);
        let randomised = bits.take(1)? == 1;
        let origin = bits.take(24)? as usize;
        let (mut order, used) = used_bytes(bits)?;
        self.read_tables(bits, used + 2)?;
        self.read_symbols(bits, &mut order, used as u16 + 1, largest)?;
        Ok(Head { randomised, origin })
    }

    /// Reads the table index of each group of symbols, then the tables for this number of `symbols`.
    fn read_tables(&mut self, bits: &mut Bits<'_>, symbols: usize) -> Result<()> {
        let tables = bits.take(3)? as usize;
        let groups = bits.take(15)?;
        if !(2..=MAX_TABLES).contains(&tables) || groups == 0 {
            return Err(damaged("a block without tables of codes"));
        }
        let mut order: [u8; MAX_TABLES] = std::array::from_fn(|i| i as u8);
        self.selectors.clear();
        for _ in 0..groups {
            let mut place = 0;
            while bits.take(1)? == 1 {
                place += 1;
                if place >= tables {
                    return Err(damaged("a table of codes that is not there"));
                }
            }
            if let Some(to_front) = order.get_mut(..=place) {
                to_front.rotate_right(1);
            }
            self.selectors.push(order[0]);
        }
        self.tables.iter_mut().take(tables).try_for_each(|table| table.read(bits, symbols))
    }

    /// Reads symbols until `end`: digits of runs of the front byte, or places in `order`.
    fn read_symbols(
        &mut self,
        bits: &mut Bits<'_>,
        order: &mut Order,
        end: u16,
        largest: usize,
    ) -> Result<()> {
        let (mut run, mut digit) = (0usize, 1usize);
        for &selector in &self.selectors {
            let table = self.tables.get(usize::from(selector));
            let table = table.ok_or_else(|| damaged("a table of codes that is not there"))?;
            for _ in 0..GROUP {
                bits.refill();
                let symbol = table.symbol(bits)?;
                if symbol <= RUN_B {
                    // A number with the digits one and two, the least significant first.
                    run += digit << (symbol - RUN_A);
                    digit <<= 1;
                    if run > largest {
                        return Err(too_long());
                    }
                    continue;
                }
                if run > 0 {
                    self.transformed.push_run(order.front(), run)?;
                    (run, digit) = (0, 1);
                }
                if symbol == end {
                    return bits.check();
                }
                self.transformed.push(order.move_to_front(usize::from(symbol) - 1))?;
            }
            bits.check()?;
        }
        Err(damaged("a block without an end"))
    }
}

/// Reads the bytes that occur in a block, in ascending order, and their number.
fn used_bytes(bits: &mut Bits<'_>) -> Result<(Order, usize)> {
    let (mut order, mut used) = (Order([0; 256]), 0);
    let rows = bits.take(16)?;
    for row in (0..16u32).filter(|row| rows >> (15 - row) & 1 == 1) {
        let columns = bits.take(16)?;
        for column in (0..16u32).filter(|column| columns >> (15 - column) & 1 == 1) {
            if let Some(place) = order.0.get_mut(used) {
                *place = (16 * row + column) as u8;
                used += 1;
            }
        }
    }
    if used == 0 {
        return Err(damaged("a block without bytes"));
    }
    debug_assert!(used + 2 <= MAX_SYMBOLS);
    Ok((order, used))
}

/// The bytes in move-to-front order: the most recent first.
struct Order([u8; 256]);

impl Order {
    fn front(&self) -> u8 {
        self.0[0]
    }

    /// Moves the byte at `place` to the front.
    #[inline]
    fn move_to_front(&mut self, place: usize) -> u8 {
        if place < 16 {
            return self.move_within_sixteen(place);
        }
        let place = place & 255;
        let byte = self.0.get(place).copied().unwrap_or_default();
        self.0.copy_within(..place, 1);
        self.0[0] = byte;
        byte
    }

    /// Most bytes come from the first few places; these are moved within one register.
    #[inline]
    fn move_within_sixteen(&mut self, place: usize) -> u8 {
        let Some(front) = self.0.first_chunk_mut::<16>() else { return 0 };
        let sixteen = u128::from_le_bytes(*front);
        let shift = 8 * place as u32;
        let byte = (sixteen >> shift) as u8;
        let before = sixteen & ((1 << shift) - 1);
        // Shifted twice, because a single shift for the sixteenth place would be by the full width.
        let behind = (sixteen >> shift >> 8) << shift << 8;
        *front = (behind | before << 8 | u128::from(byte)).to_le_bytes();
        byte
    }
}
