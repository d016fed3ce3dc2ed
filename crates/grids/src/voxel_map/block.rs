//! Blocks of 4×4×4 cells: keys of blocks, and their cells while they are changed.

use super::{VoxelIndex, bit_of, is_possible, key_of};

/// Cells in a block.
pub(super) const BLOCK_CELLS: usize = 64;

/// Key of a block of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct BlockKey(pub(super) u64);

impl BlockKey {
    /// Number of bits of the number of a block.
    pub const BITS: u32 = 36;

    /// The block with a cell and the cell's position in it, less than 64; none for impossible cells.
    #[inline]
    pub fn of(cell: VoxelIndex) -> Option<(Self, u32)> {
        is_possible(cell).then(|| (Self(key_of(cell)), bit_of(cell).trailing_zeros()))
    }

    /// A number less than 2^[`Self::BITS`].
    pub fn number(self) -> u64 {
        self.0
    }

    /// The block with a number that [`Self::number`] gave.
    pub fn from_number(number: u64) -> Self {
        Self(number)
    }
}

/// The cells of a block while they are changed; those not known have the default value.
pub(crate) struct Block<T> {
    pub(super) known: u64,
    pub(super) values: [T; BLOCK_CELLS],
}

impl<T: Copy> Block<T> {
    /// Changes the cell at a place (less than 64), which is known from then on.
    #[inline]
    pub fn change(&mut self, place: u32, change: impl FnOnce(T) -> T) {
        self.known |= 1 << (place & 63);
        let value = &mut self.values[(place & 63) as usize];
        *value = change(*value);
    }
}

/// Places of the bits that are set, ascending.
pub(super) struct Bits(pub u64);

impl Iterator for Bits {
    type Item = usize;

    #[inline]
    fn next(&mut self) -> Option<usize> {
        let place = self.0.trailing_zeros() as usize;
        self.0 &= self.0.wrapping_sub(1);
        (place < BLOCK_CELLS).then_some(place)
    }
}
