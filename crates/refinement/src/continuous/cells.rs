//! Cubic cells with moments of the points in them, in a hash table.

use portolan_spatial::{Moments, VoxelHash};

/// A cell of the grid.
pub(crate) type Key = portolan_spatial::VoxelKey;

/// Cells in the order in which they were first seen.
#[derive(Default)]
pub(crate) struct Cells {
    index: VoxelHash<u32>,
    pub keys: Vec<Key>,
    pub moments: Vec<Moments>,
}

impl Cells {
    /// The cell of a key; made if missing.
    pub fn cell(&mut self, key: Key) -> usize {
        let next = self.keys.len() as u32;
        let index = *self.index.or_insert_with(key, || next);
        if index == next {
            self.keys.push(key);
            self.moments.push(Moments::default());
        }
        index as usize
    }

    /// The cell of a key, if there is one.
    pub fn find(&self, key: &Key) -> Option<usize> {
        self.index.get(key).map(|i| *i as usize)
    }

    /// Forgets all cells but keeps the memory.
    pub fn clear(&mut self) {
        self.index.clear();
        self.keys.clear();
        self.moments.clear();
    }
}
