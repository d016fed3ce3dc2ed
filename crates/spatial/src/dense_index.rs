//! Maps keys to dense numbers with a hash table in one list of words.

/// Bits of a slot for the number; the others hold the key.
const NUMBER_BITS: u32 = 28;
const NUMBER_MASK: u64 = (1 << NUMBER_BITS) - 1;
const FREE: u64 = u64::MAX;
const MIN_SLOTS: usize = 16;

/// Maps keys of 36 bits (voxels, blocks of cells) to numbers of 28 bits (their indices in a list). Open
/// addressing with linear probing. The table is at most two thirds full and grows by half, so that little
/// memory is unused.
#[derive(Clone, Debug)]
pub struct DenseIndex {
    slots: Vec<u64>,
    len: usize,
}

impl DenseIndex {
    /// Maximum number of keys; the last number is reserved because it marks free slots.
    pub const MAX_KEYS: usize = (1 << NUMBER_BITS) - 1;

    /// An empty table with room for this many keys before it grows.
    pub fn with_capacity(num_keys: usize) -> Self {
        let slots = (num_keys + num_keys / 2 + 1).max(MIN_SLOTS);
        Self { slots: vec![FREE; slots], len: 0 }
    }

    /// First slot of the search for a key. Multiplication spreads the key over the high bits, which are then
    /// scaled to the size of the table.
    #[inline]
    fn home(&self, key: u64) -> usize {
        let hash = key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        ((hash * self.slots.len() as u64) >> 32) as usize
    }

    /// The slot of a key, or the free slot where it would be inserted.
    #[inline]
    fn slot(&self, key: u64) -> usize {
        let mut i = self.home(key);
        loop {
            let slot = self.slots[i];
            if slot >> NUMBER_BITS == key || slot == FREE {
                return i;
            }
            i += 1;
            if i == self.slots.len() {
                i = 0;
            }
        }
    }

    /// The number of a key, if it is in the table.
    #[inline]
    pub fn get(&self, key: u64) -> Option<usize> {
        let slot = self.slots[self.slot(key)];
        (slot != FREE).then_some((slot & NUMBER_MASK) as usize)
    }

    /// Adds a key that is not in the table, with its number, which must be less than [`Self::MAX_KEYS`].
    #[inline]
    pub fn insert(&mut self, key: u64, number: usize) {
        if 3 * (self.len + 1) > 2 * self.slots.len() {
            let larger = vec![FREE; self.slots.len() + self.slots.len() / 2];
            let old = std::mem::replace(&mut self.slots, larger);
            for slot in old.into_iter().filter(|s| *s != FREE) {
                let free = self.slot(slot >> NUMBER_BITS);
                self.slots[free] = slot;
            }
        }
        let free = self.slot(key);
        self.slots[free] = key << NUMBER_BITS | number as u64;
        self.len += 1;
    }

    /// All keys with their numbers, in arbitrary order.
    pub fn iter(&self) -> impl Iterator<Item = (u64, usize)> + '_ {
        let taken = self.slots.iter().filter(|s| **s != FREE);
        taken.map(|slot| (slot >> NUMBER_BITS, (slot & NUMBER_MASK) as usize))
    }

    /// Memory taken, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.slots.capacity() * size_of::<u64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_is_found_and_no_other() {
        let mut index = DenseIndex::with_capacity(0);
        let key = |i: u64| i * i * 7919 % (1 << 36);
        for i in 0..2000u64 {
            if index.get(key(i)).is_none() {
                index.insert(key(i), i as usize);
            }
        }
        assert!((0..2000).all(|i| index.get(key(i)).is_some_and(|j| key(j as u64) == key(i))));
        assert_eq!(index.get((1 << 36) - 1), None);
        assert_eq!(index.iter().count(), index.len);
    }
}
