//! A hash table of voxels.

use rustc_hash::FxHashMap;

/// Index of a voxel along x, y and z, in voxels from the origin.
pub type VoxelKey = [i32; 3];

/// Hash table of values by voxel. Voxels can only be visited in the order of their keys, so that no output
/// depends on the order of the table.
#[derive(Clone, Debug)]
pub struct VoxelHash<T> {
    voxels: FxHashMap<VoxelKey, T>,
}

impl<T> Default for VoxelHash<T> {
    fn default() -> Self {
        Self { voxels: FxHashMap::default() }
    }
}

impl<T> VoxelHash<T> {
    /// Number of voxels that have a value.
    #[inline]
    pub fn len(&self) -> usize {
        self.voxels.len()
    }

    /// Whether no voxel has a value.
    pub fn is_empty(&self) -> bool {
        self.voxels.is_empty()
    }

    /// Whether a voxel has a value.
    #[inline]
    pub fn contains(&self, key: &VoxelKey) -> bool {
        self.voxels.contains_key(key)
    }

    /// The value of a voxel.
    #[inline]
    pub fn get(&self, key: &VoxelKey) -> Option<&T> {
        self.voxels.get(key)
    }

    /// The value of a voxel, mutable.
    #[inline]
    pub fn get_mut(&mut self, key: &VoxelKey) -> Option<&mut T> {
        self.voxels.get_mut(key)
    }

    /// The value of a voxel; if there is none, that of `make` is inserted.
    #[inline]
    pub fn or_insert_with(&mut self, key: VoxelKey, make: impl FnOnce() -> T) -> &mut T {
        self.voxels.entry(key).or_insert_with(make)
    }

    /// The value of a voxel; the default is inserted if there is none.
    #[inline]
    pub fn or_default(&mut self, key: VoxelKey) -> &mut T
    where
        T: Default,
    {
        self.voxels.entry(key).or_default()
    }

    /// Removes all values and keeps the memory of the table.
    pub fn clear(&mut self) {
        self.voxels.clear();
    }

    /// All voxels in ascending order of x, then y, then z.
    pub fn sorted(&self) -> Vec<(VoxelKey, &T)> {
        let mut sorted: Vec<(VoxelKey, &T)> = self.voxels.iter().map(|(key, value)| (*key, value)).collect();
        sorted.sort_unstable_by_key(|(key, _)| *key);
        sorted
    }

    /// Removes all voxels, keeps the memory of the table, and returns them in ascending order of x, then y, then z.
    pub fn drain_sorted(&mut self) -> Vec<(VoxelKey, T)> {
        let mut sorted: Vec<(VoxelKey, T)> = self.voxels.drain().collect();
        sorted.sort_unstable_by_key(|(key, _)| *key);
        sorted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voxels_come_in_order_of_their_keys() {
        let mut voxels = VoxelHash::default();
        for key in [[2, 0, 0], [-1, 5, 0], [-1, 4, 9], [2, 0, 0]] {
            *voxels.or_default(key) += 1;
        }
        let expected = vec![([-1, 4, 9], 1), ([-1, 5, 0], 1), ([2, 0, 0], 2)];
        let sorted: Vec<(VoxelKey, i32)> = voxels.sorted().into_iter().map(|(k, v)| (k, *v)).collect();
        assert_eq!(sorted, expected);
        assert_eq!(voxels.drain_sorted(), expected);
        assert!(voxels.is_empty());
    }
}
