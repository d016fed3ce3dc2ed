//! Stores the states of voxels with two bits each, in blocks of 8×8×8 cells.

use portolan_grids::{MAX_VOXEL_INDEX, VoxelIndex};
use portolan_spatial::DenseIndex;

/// Cells along each edge of a block, as a power of two.
const EDGE_BITS: u32 = 3;
/// No block has this key.
const NO_KEY: u64 = u64::MAX;

/// State of a known cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum VoxelState {
    Solid,
    Free,
}

/// One bit for each cell: a layer for each height, with a byte for each y.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    layers: [Layer; 8],
}

#[derive(Clone, Copy, Debug, Default)]
struct Layer {
    solid: u64,
    free: u64,
}

/// States of cells; cells that were never set have none.
#[derive(Debug)]
pub(crate) struct VoxelStates {
    index: DenseIndex,
    blocks: Vec<([i32; 3], Block)>,
    /// The block changed last: the next cell along a beam is most often in it, too.
    recent: (u64, usize),
}

impl VoxelStates {
    /// No cell has a state.
    pub fn new() -> Self {
        Self { index: DenseIndex::with_capacity(0), blocks: Vec::new(), recent: (NO_KEY, 0) }
    }

    /// State of a cell, if known.
    #[inline]
    pub fn get(&self, cell: VoxelIndex) -> Option<VoxelState> {
        let (_, block) = self.blocks.get(self.index.get(key(cell)?)?)?;
        let (layer, bit) = place(cell);
        let Layer { solid, free } = block.layers.get(layer)?;
        match (solid & bit != 0, free & bit != 0) {
            (true, _) => Some(VoxelState::Solid),
            (_, true) => Some(VoxelState::Free),
            _ => None,
        }
    }

    /// Sets the state of a cell that has none yet.
    #[inline]
    pub fn learn(&mut self, cell: VoxelIndex, state: VoxelState) {
        let Some(number) = self.block_of(cell) else { return };
        let (layer, bit) = place(cell);
        let Some((_, block)) = self.blocks.get_mut(number) else { return };
        let Some(Layer { solid, free }) = block.layers.get_mut(layer) else { return };
        match state {
            VoxelState::Solid => *solid |= bit & !*free,
            VoxelState::Free => *free |= bit & !*solid,
        }
    }

    /// Visits all solid cells, block by block in the order in which the blocks were made.
    pub fn for_each_solid(&self, mut visit: impl FnMut(VoxelIndex)) {
        for ([x, y, z], block) in &self.blocks {
            for (height, layer) in (0..).zip(block.layers) {
                for bit in (0..64).filter(|bit| layer.solid >> bit & 1 == 1) {
                    visit([x + (bit & 7), y + (bit >> 3), z + height]);
                }
            }
        }
    }

    /// The number of the block around a cell, which is made if there is none; none for cells out of range.
    #[inline]
    fn block_of(&mut self, cell: VoxelIndex) -> Option<usize> {
        let key = key(cell)?;
        if self.recent.0 != key {
            let known = self.index.get(key);
            self.recent = (key, known.unwrap_or(self.blocks.len()));
            if known.is_none() && self.blocks.len() < DenseIndex::MAX_KEYS {
                self.index.insert(key, self.blocks.len());
                self.blocks.push((cell.map(|i| i >> EDGE_BITS << EDGE_BITS), Block::default()));
            }
        }
        (self.recent.1 < self.blocks.len()).then_some(self.recent.1)
    }
}

/// The key of the block around a cell; none for cells out of range.
#[inline]
fn key([x, y, z]: VoxelIndex) -> Option<u64> {
    let is_possible = |i: i32| (-MAX_VOXEL_INDEX..MAX_VOXEL_INDEX).contains(&i);
    let block = |i: i32| ((i + MAX_VOXEL_INDEX) >> EDGE_BITS) as u64;
    (is_possible(x) & is_possible(y) & is_possible(z)).then(|| block(z) << 24 | block(y) << 12 | block(x))
}

/// The layer of a cell in its block, and its bit there.
#[inline]
fn place([x, y, z]: VoxelIndex) -> (usize, u64) {
    ((z & 7) as usize, 1 << ((y & 7) << 3 | (x & 7)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn the_first_state_of_a_voxel_stays() {
        let (mut states, mut known) = (VoxelStates::new(), BTreeMap::new());
        for i in 0..4000_i32 {
            let cell = [i * 7919 % 37 - 18, i * 104_729 % 23 - 11, i * 31 % 29 - 14];
            let state = if i % 3 == 0 { VoxelState::Solid } else { VoxelState::Free };
            states.learn(cell, state);
            known.entry(cell).or_insert(state);
        }
        for cell in known.keys() {
            assert_eq!(states.get(*cell), known.get(cell).copied());
        }
        assert_eq!(states.get([100, 0, 0]), None);
        let mut solid = Vec::new();
        states.for_each_solid(|cell| solid.push(cell));
        solid.sort_unstable();
        let expected = known.iter().filter(|(_, state)| **state == VoxelState::Solid).map(|(cell, _)| *cell);
        assert_eq!(solid, expected.collect::<Vec<_>>());
    }

    #[test]
    fn cells_beyond_the_index_range_have_no_state() {
        let mut states = VoxelStates::new();
        for far in [MAX_VOXEL_INDEX, -MAX_VOXEL_INDEX - 1, i32::MIN, i32::MAX] {
            states.learn([0, far, 0], VoxelState::Solid);
            assert_eq!(states.get([0, far, 0]), None);
        }
        states.learn([-MAX_VOXEL_INDEX, 0, MAX_VOXEL_INDEX - 1], VoxelState::Free);
        assert_eq!(states.get([-MAX_VOXEL_INDEX, 0, MAX_VOXEL_INDEX - 1]), Some(VoxelState::Free));
    }
}
