//! Sparse map of the values of cells in 3D, the common base of all hybrid grids.
//!
//! Space is cut into blocks of 4×4×4 cells. A block with known cells has a leaf: one bit for each cell
//! that is known and a list with only their values. A surface seen by a lidar takes 3 to 5 bytes per
//! known cell, less than in a map file (6 to 9), where blocks of values would take 20 and more.

use std::fmt;

mod arena;
mod block;

use arena::{Arena, push_tight};
use block::{BLOCK_CELLS, Bits};
pub(crate) use block::{Block, BlockKey};
use portolan_spatial::DenseIndex;

/// Indices of a cell in 3D along x, y, z. Cell (0, 0, 0) is centred at the origin of the grid.
pub type VoxelIndex = [i32; 3];

/// Cells have indices from minus this up to this minus one along each axis (`formats.md` §4.6).
pub const MAX_VOXEL_INDEX: i32 = 8192;

/// Cells along each edge of a leaf's block.
const LEAF_EDGE: i32 = 4;

/// The known cells of one block; bit `16 z + 4 y + x` of the mask is the cell (x, y, z) of the block.
#[derive(Clone, Copy, Debug)]
#[repr(C, packed(4))]
struct Leaf {
    mask: u64,
    /// Position of its values, in the order of the bits.
    start: u32,
}

/// Map from cells to values of type `T`. Cells never set have no value.
#[derive(Clone)]
pub struct VoxelMap<T> {
    index: DenseIndex,
    leaves: Vec<Leaf>,
    values: Arena<T>,
    num_cells: usize,
    /// The last leaf changed: neighbouring points hit neighbouring cells.
    recent: (u64, usize),
    /// All cells are within ±(32 << this) of the origin: how far Cartographer's grid has grown.
    root_bits: u32,
}

/// No block has this key.
const NO_KEY: u64 = u64::MAX;

impl<T: Copy + Default> Default for VoxelMap<T> {
    fn default() -> Self {
        Self::with_capacity(0, 0, 0)
    }
}

/// Whether a cell can exist.
#[inline]
pub(crate) fn is_possible(cell: VoxelIndex) -> bool {
    // Written out: iterators and `map` on arrays are not always compiled into the loops that need them.
    let is_within = |i: i32| (-MAX_VOXEL_INDEX..MAX_VOXEL_INDEX).contains(&i);
    is_within(cell[0]) & is_within(cell[1]) & is_within(cell[2])
}

/// The key of the block that holds a possible cell: 12 bits per axis, z highest.
#[inline]
fn key_of(cell: VoxelIndex) -> u64 {
    let block = |i: i32| u64::from((i + MAX_VOXEL_INDEX) as u32 / LEAF_EDGE as u32);
    block(cell[2]) << 24 | block(cell[1]) << 12 | block(cell[0])
}

#[inline]
fn bit_of([x, y, z]: VoxelIndex) -> u64 {
    1 << ((z & 3) << 4 | (y & 3) << 2 | (x & 3))
}

/// The first cell of a block.
fn first_cell(key: u64) -> VoxelIndex {
    [0, 12, 24].map(|shift| ((key >> shift & 0xfff) as i32) * LEAF_EDGE - MAX_VOXEL_INDEX)
}

/// Sorts blocks in the order of map files: by cubes of 64 cells, within them by cubes of 8 cells, within
/// them by z, y and x.
fn file_order(key: u64) -> u64 {
    let [x, y, z] = [0, 12, 24].map(|shift| key >> shift & 0xfff);
    let level = |shift: u32, bits: u32| {
        let part = |v: u64| v >> shift & ((1 << bits) - 1);
        part(z) << (2 * bits) | part(y) << bits | part(x)
    };
    level(4, 8) << 12 | level(1, 3) << 3 | level(0, 1)
}

impl<T: Copy + Default> VoxelMap<T> {
    fn with_capacity(leaves: usize, values: usize, root_bits: u32) -> Self {
        Self {
            index: DenseIndex::with_capacity(leaves),
            leaves: Vec::with_capacity(leaves),
            values: Arena::with_capacity(values),
            num_cells: 0,
            recent: (NO_KEY, 0),
            root_bits: root_bits.max(1),
        }
    }

    /// Number of known cells.
    pub fn num_cells(&self) -> usize {
        self.num_cells
    }

    /// Edge of the cube of cells that Cartographer would have reserved: 64 cells, doubled until all
    /// known cells are inside, at least 128.
    pub fn extent(&self) -> u32 {
        64 << self.root_bits
    }

    /// The value of a cell that is known.
    #[inline]
    pub fn get(&self, cell: VoxelIndex) -> Option<T> {
        if !is_possible(cell) {
            return None;
        }
        let leaf = self.leaves[self.index.get(key_of(cell))?];
        self.value_in(leaf, bit_of(cell))
    }

    #[inline]
    fn value_in(&self, leaf: Leaf, bit: u64) -> Option<T> {
        let mask = leaf.mask;
        if mask & bit == 0 {
            return None;
        }
        let rank = (mask & (bit - 1)).count_ones();
        Some(self.values.at((leaf.start + rank) as usize))
    }

    /// The values of the eight cells from `low` to `low + (1, 1, 1)`; the first bit of the position counts
    /// along x, the second along y, the third along z.
    #[inline]
    pub fn corners(&self, low: VoxelIndex) -> [Option<T>; 8] {
        let mut values = [None; 8];
        if !is_possible(low) || !is_possible(corner(low, 7)) {
            for (c, value) in values.iter_mut().enumerate() {
                *value = self.get(corner(low, c));
            }
            return values;
        }
        // Along which axes the two cells are in different blocks.
        let is_last = |axis: usize| usize::from(low[axis] & 3 == 3) << axis;
        let across = is_last(0) | is_last(1) | is_last(2);
        let mut leaves = [None; 8];
        for (side, leaf) in leaves.iter_mut().enumerate() {
            if side & !across == 0 {
                *leaf = self.index.get(key_of(corner(low, side))).map(|l| self.leaves[l]);
            }
        }
        for (c, value) in values.iter_mut().enumerate() {
            *value = leaves[c & across].and_then(|leaf| self.value_in(leaf, bit_of(corner(low, c))));
        }
        values
    }

    /// The value of a cell, to be changed; a cell not known so far becomes known with the default value. None
    /// for impossible cells.
    #[inline]
    pub(crate) fn entry(&mut self, cell: VoxelIndex) -> Option<&mut T> {
        if !is_possible(cell) {
            return None;
        }
        let (number, bit) = (self.leaf_of(key_of(cell))?, bit_of(cell));
        let leaf = self.leaves[number];
        let mask = leaf.mask;
        let rank = (mask & (bit - 1)).count_ones() as usize;
        let mut start = leaf.start;
        if mask & bit == 0 {
            start = self.values.insert(start, mask.count_ones() as usize, rank, T::default())?;
            self.leaves[number] = Leaf { mask: mask | bit, start };
            self.num_cells += 1;
        }
        Some(self.values.at_mut(start as usize + rank))
    }

    /// Changes cells of one block, all at once. False if there is no room for them.
    pub(crate) fn update_block(&mut self, key: BlockKey, update: impl FnOnce(&mut Block<T>)) -> bool {
        let Some(number) = self.leaf_of(key.0) else { return false };
        let Leaf { mask: before, start } = self.leaves[number];
        let mut block = Block { known: before, values: [T::default(); BLOCK_CELLS] };
        let list = self.values.list(start, before.count_ones() as usize);
        Bits(before).zip(list).for_each(|(place, value)| block.values[place] = *value);
        update(&mut block);
        let counts = [before, block.known].map(|mask| mask.count_ones() as usize);
        let Some(start) = self.values.resize(start, counts) else { return false };
        let list = self.values.list_mut(start, counts[1]);
        Bits(block.known).zip(list).for_each(|(place, value)| *value = block.values[place]);
        self.leaves[number] = Leaf { mask: block.known, start };
        self.num_cells = self.num_cells + counts[1] - counts[0];
        true
    }

    /// The number of the leaf of a block, which is made if there is none yet.
    #[inline]
    fn leaf_of(&mut self, key: u64) -> Option<usize> {
        if self.recent.0 != key {
            let found = match self.index.get(key) {
                Some(leaf) => leaf,
                None => self.add_leaf(key)?,
            };
            self.recent = (key, found);
        }
        Some(self.recent.1)
    }

    #[cold]
    fn add_leaf(&mut self, key: u64) -> Option<usize> {
        let number = self.leaves.len();
        if number >= DenseIndex::MAX_KEYS {
            return None;
        }
        let start = self.values.allocate(0)?;
        push_tight(&mut self.leaves, Leaf { mask: 0, start });
        self.index.insert(key, number);
        for i in first_cell(key) {
            while !(-(32 << self.root_bits)..32 << self.root_bits).contains(&i) {
                self.root_bits += 1;
            }
        }
        Some(number)
    }

    /// Visits every known cell in the order of memory, which is the same for the same history.
    pub fn for_each(&self, mut visit: impl FnMut(VoxelIndex, T)) {
        for (key, number) in self.index.iter() {
            self.for_each_in_leaf(first_cell(key), self.leaves[number], &mut visit);
        }
    }

    /// Visits the known cells of the box from `first` to `last`.
    pub fn for_each_in_box(&self, first: VoxelIndex, last: VoxelIndex, mut visit: impl FnMut(VoxelIndex, T)) {
        let bounds = [0, 1, 2].map(|a| {
            let possible = |i: i32| i.clamp(-MAX_VOXEL_INDEX, MAX_VOXEL_INDEX - 1);
            possible(first[a]).div_euclid(LEAF_EDGE)..=possible(last[a]).div_euclid(LEAF_EDGE)
        });
        let is_inside = |cell: VoxelIndex| (0..3).all(|a| first[a] <= cell[a] && cell[a] <= last[a]);
        for z in bounds[2].clone() {
            for y in bounds[1].clone() {
                for x in bounds[0].clone() {
                    let start = [x, y, z].map(|i| i * LEAF_EDGE);
                    if let Some(number) = self.index.get(key_of(start)) {
                        self.for_each_in_leaf(start, self.leaves[number], |cell, value| {
                            if is_inside(cell) {
                                visit(cell, value);
                            }
                        });
                    }
                }
            }
        }
    }

    /// Visits the known cells of the leaf of the block that starts at `first`.
    #[inline]
    fn for_each_in_leaf(&self, first: VoxelIndex, leaf: Leaf, mut visit: impl FnMut(VoxelIndex, T)) {
        let mask = leaf.mask;
        for (place, value) in Bits(mask).zip(self.values.list(leaf.start, mask.count_ones() as usize)) {
            let place = place as i32;
            visit([first[0] + (place & 3), first[1] + (place >> 2 & 3), first[2] + (place >> 4)], *value);
        }
    }

    /// Keys and numbers of all leaves in the order of map files.
    fn sorted_leaves(&self) -> Vec<(u64, usize)> {
        let mut leaves: Vec<(u64, usize)> = self.index.iter().collect();
        leaves.sort_unstable_by_key(|(key, _)| file_order(*key));
        leaves
    }

    /// Visits every known cell in the order of map files (`formats.md` §4.6).
    pub(crate) fn for_each_in_file_order(&self, mut visit: impl FnMut(VoxelIndex, T)) {
        let leaves = self.sorted_leaves();
        let cube = |key: u64| file_order(key) >> 3;
        for of_cube in leaves.chunk_by(|a, b| cube(a.0) == cube(b.0)) {
            let mut at = [None; 8];
            for (key, number) in of_cube {
                at[(file_order(*key) & 7) as usize] = Some((first_cell(*key), self.leaves[*number]));
            }
            for (z, y, side) in (0..8).flat_map(|z| (0..8).flat_map(move |y| [(z, y, 0), (z, y, 1)])) {
                let Some((first, leaf)) = at[(z >> 2) << 2 | (y >> 2) << 1 | side] else { continue };
                for x in 0..4 {
                    let cell = [first[0] + x, first[1] + (y as i32 & 3), first[2] + (z as i32 & 3)];
                    if let Some(value) = self.value_in(leaf, bit_of(cell)) {
                        visit(cell, value);
                    }
                }
            }
        }
    }

    /// The same map without spare room, neighbours close to each other in memory.
    #[must_use]
    pub(crate) fn compacted(&self) -> Self {
        let leaves = self.sorted_leaves();
        let count = |number: usize| ({ self.leaves[number].mask }).count_ones() as usize;
        let values = leaves.iter().map(|(_, n)| Arena::<T>::capacity_for(count(*n))).sum();
        let mut compact = Self::with_capacity(leaves.len(), values, self.root_bits);
        for (key, number) in leaves {
            let Some(start) = compact.values.allocate(count(number)) else { break };
            let values = self.values.list(self.leaves[number].start, count(number));
            compact.values.list_mut(start, values.len()).copy_from_slice(values);
            compact.index.insert(key, compact.leaves.len());
            compact.leaves.push(Leaf { mask: self.leaves[number].mask, start });
        }
        compact.num_cells = self.num_cells;
        compact
    }

    /// Memory taken, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.index.memory_bytes()
            + self.leaves.capacity() * size_of::<Leaf>()
            + self.values.memory_bytes()
            + size_of::<Self>()
    }
}

/// Corner `c` of a cube of cells.
#[inline]
fn corner(low: VoxelIndex, c: usize) -> VoxelIndex {
    let along = |axis: usize| low[axis].saturating_add((c >> axis & 1) as i32);
    [along(0), along(1), along(2)]
}

impl<T: Copy + Default + PartialEq> PartialEq for VoxelMap<T> {
    /// Whether the same cells are known and have the same values.
    fn eq(&self, other: &Self) -> bool {
        let mut equal = self.num_cells == other.num_cells && self.root_bits == other.root_bits;
        self.for_each(|cell, value| equal = equal && other.get(cell) == Some(value));
        equal
    }
}

impl<T> fmt::Debug for VoxelMap<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "VoxelMap({} cells in {} leaves)", self.num_cells, self.leaves.len())
    }
}

#[cfg(test)]
mod tests;
