//! Cubic cells with moments of the points in them, in a hash table.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use crate::moments::Moments;

/// Multiplies and rotates; the keys are small integers from our own grid.
#[derive(Default)]
pub(crate) struct CellHasher(u64);

impl Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0 ^ (self.0 >> 29)
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.write_u32(u32::from(*byte));
        }
    }

    fn write_u32(&mut self, value: u32) {
        self.0 = (self.0.rotate_left(21) ^ u64::from(value)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    fn write_i32(&mut self, value: i32) {
        self.write_u32(value as u32);
    }

    fn write_usize(&mut self, _: usize) {
        // Only the length of the key, which is always the same.
    }
}

/// A cell of the grid.
pub(crate) type Key = [i32; 3];

/// A table whose iteration order is never used.
pub(crate) type CellTable<V> = HashMap<Key, V, BuildHasherDefault<CellHasher>>;

/// Cells in the order in which they were first seen.
#[derive(Default)]
pub(crate) struct Cells {
    index: CellTable<u32>,
    pub keys: Vec<Key>,
    pub moments: Vec<Moments>,
}

impl Cells {
    /// The cell of a key; made if missing.
    pub fn cell(&mut self, key: Key) -> usize {
        let next = self.keys.len() as u32;
        let index = *self.index.entry(key).or_insert(next);
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
