//! Index of the voxels of a planar voxel map: the largest ones in a hash table, the eight smaller ones in
//! each of them in a table of their own. Consecutive hits are near each other, and so are these tables.
//! With voxels of all sizes in one hash table each access would wait for memory.

use nalgebra as na;
use portolan_spatial::DenseIndex;

/// Number of voxel sizes, each half of the one before.
pub(super) const LEVELS: u32 = 3;
/// Number of voxels of each size from the origin to the border along each axis.
const MAX_INDEX: u32 = 1 << INDEX_BITS >> 1;
const INDEX_BITS: u32 = 11;
/// Number of smallest voxels along the edge of a largest one, and along the edge of the whole map.
pub(super) const SMALLEST_IN_LARGEST: f32 = (1 << (LEVELS - 1)) as f32;
pub(super) const SMALLEST_IN_ALL: f32 = (1 << SMALLEST_BITS) as f32;
const SMALLEST_BITS: u32 = INDEX_BITS + LEVELS - 1;
/// Number that marks a missing voxel.
const NONE: u32 = u32::MAX;
/// Table of a voxel without smaller ones.
const NO_CHILDREN: [u32; 8] = [NONE; 8];

/// Numbers of voxels: dense, in the order in which they were added.
#[derive(Clone, Debug)]
pub(super) struct VoxelTree {
    largest: DenseIndex,
    /// For each voxel, the index in `tables` of the smaller ones in it. The first table is that of voxels
    /// without any.
    table_of: Vec<u32>,
    /// Indexed by [`Smallest::octant`].
    tables: Vec<[u32; 8]>,
}

impl VoxelTree {
    /// An empty tree with capacity for this number of voxels.
    pub fn with_capacity(voxels: usize) -> Self {
        Self {
            largest: DenseIndex::with_capacity(0),
            table_of: Vec::with_capacity(voxels),
            tables: vec![NO_CHILDREN],
        }
    }

    /// Memory taken, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.largest.memory_bytes()
            + self.table_of.capacity() * size_of::<u32>()
            + self.tables.capacity() * size_of::<[u32; 8]>()
    }

    /// Number of voxels, which is the number of the next one.
    pub fn len(&self) -> usize {
        self.table_of.len()
    }

    /// The number of the largest voxel around a position.
    #[inline]
    pub fn largest(&self, smallest: Smallest) -> Option<usize> {
        self.largest.get(smallest.key())
    }

    /// The number of the voxel of a size (not the largest) around a position, in the next larger one.
    #[inline]
    pub fn child(&self, parent: usize, smallest: Smallest, level: u32) -> Option<usize> {
        let children = &self.tables[self.table_of[parent] as usize];
        let number = children[smallest.octant(level)];
        (number != NONE).then_some(number as usize)
    }

    /// Adds the largest voxel around a position, which must not exist yet. Gives its number.
    pub fn add_largest(&mut self, smallest: Smallest) -> usize {
        self.largest.insert(smallest.key(), self.len());
        self.add()
    }

    /// Adds a smaller voxel (there are fewer than 2²⁸ of them), which must not exist yet. Gives its
    /// number.
    pub fn add_child(&mut self, parent: usize, smallest: Smallest, level: u32) -> usize {
        self.set_child(parent, smallest.octant(level), self.len());
        self.add()
    }

    fn add(&mut self) -> usize {
        self.table_of.push(0);
        self.table_of.len() - 1
    }

    fn set_child(&mut self, parent: usize, octant: usize, number: usize) {
        if self.table_of[parent] == 0 {
            self.table_of[parent] = self.tables.len() as u32;
            self.tables.push(NO_CHILDREN);
        }
        self.tables[self.table_of[parent] as usize][octant] = number as u32;
    }

    /// The tree of the wanted voxels whose larger voxels are all wanted, too, and their numbers in this
    /// tree, ascending.
    pub fn filtered(&self, is_wanted: impl Fn(usize) -> bool) -> (Self, Vec<usize>) {
        let wanted_largest = || self.largest.iter().filter(|(_, number)| is_wanted(*number));
        let mut kept: Vec<usize> = wanted_largest().map(|(_, number)| number).collect();
        let mut i = 0;
        while let Some(parent) = kept.get(i) {
            let children = self.children(*parent).map(|(_, number)| number).filter(|n| is_wanted(*n));
            let children: Vec<usize> = children.collect();
            kept.extend(children);
            i += 1;
        }
        kept.sort_unstable();
        let new_number = |number: usize| kept.binary_search(&number).ok();
        let mut filtered = Self::with_capacity(kept.len());
        filtered.largest = DenseIndex::with_capacity(wanted_largest().count());
        filtered.table_of.resize(kept.len(), 0);
        for (key, number) in wanted_largest() {
            if let Some(number) = new_number(number) {
                filtered.largest.insert(key, number);
            }
        }
        for (parent, number) in kept.iter().enumerate() {
            for (octant, child) in self.children(*number) {
                if let Some(child) = new_number(child) {
                    filtered.set_child(parent, octant, child);
                }
            }
        }
        (filtered, kept)
    }

    /// For each voxel, in the order of their numbers, the first smallest voxel in it and its size;
    /// [`None`] for one outside of all largest voxels.
    pub fn places(&self) -> Vec<Option<(Smallest, u32)>> {
        let mut places = vec![None; self.len()];
        let mut open: Vec<(usize, Smallest, u32)> =
            self.largest.iter().map(|(key, number)| (number, Smallest::of_key(key), 0)).collect();
        while let Some((number, first, level)) = open.pop() {
            if let Some(place) = places.get_mut(number) {
                *place = Some((first, level));
            }
            let children = self.children(number);
            open.extend(
                children.map(|(octant, child)| (child, first.in_octant(octant, level + 1), level + 1)),
            );
        }
        places
    }

    /// Octants and numbers of the voxels in a larger one.
    fn children(&self, parent: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let children = self.tables[self.table_of[parent] as usize].iter().enumerate();
        children.filter(|(_, number)| **number != NONE).map(|(octant, number)| (octant, *number as usize))
    }
}

/// Indices of a smallest voxel from the corner of the whole map. A larger one has these without their last
/// bits.
#[derive(Clone, Copy, Default)]
pub(super) struct Smallest {
    x: u32,
    y: u32,
    z: u32,
}

impl Smallest {
    /// The voxel around a position, given in smallest voxels from the corner; none outside of the map.
    #[inline]
    pub fn around(scaled: &na::Vector3<f32>) -> Option<Self> {
        // Numbers from this one to twice it share their exponent, and the excess is in the bits below it.
        const EXPONENT: u32 = SMALLEST_IN_ALL.to_bits();
        const BELOW: u32 = f32::MANTISSA_DIGITS - 1 - SMALLEST_BITS;
        let bits = |v: f32| (v + SMALLEST_IN_ALL).to_bits() ^ EXPONENT;
        let (x, y, z) = (bits(scaled.x), bits(scaled.y), bits(scaled.z));
        let is_one = (x | y | z) >> (f32::MANTISSA_DIGITS - 1) == 0;
        is_one.then_some(Self { x: x >> BELOW, y: y >> BELOW, z: z >> BELOW })
    }

    /// The key of the largest voxel around it: its indices.
    #[inline]
    fn key(self) -> u64 {
        let index = |smallest: u32| u64::from(smallest >> (LEVELS - 1));
        index(self.x) | index(self.y) << 12 | index(self.z) << 24
    }

    /// The first smallest voxel in the largest voxel with this key.
    fn of_key(key: u64) -> Self {
        let index = |shift: u32| ((key >> shift) as u32 & 0xfff) << (LEVELS - 1);
        Self { x: index(0), y: index(12), z: index(24) }
    }

    /// The first smallest voxel in an octant, of this size, of the voxel of which this is the first one.
    fn in_octant(self, octant: usize, level: u32) -> Self {
        let bit = |axis: u32| (octant as u32 >> axis & 1) << (LEVELS - 1 - level);
        Self { x: self.x | bit(0), y: self.y | bit(1), z: self.z | bit(2) }
    }

    /// The voxel with these indices, if it exists.
    pub fn of_indices(indices: [u32; 3]) -> Option<Self> {
        let [x, y, z] = indices;
        ((x | y | z) >> SMALLEST_BITS == 0).then_some(Self { x, y, z })
    }

    /// Its indices from the corner of the whole map.
    pub fn indices(self) -> [u32; 3] {
        [self.x, self.y, self.z]
    }

    /// Octant, in the next larger voxel, of the voxel of this size (not the largest) around it.
    #[inline]
    fn octant(self, level: u32) -> usize {
        let bit = |smallest: u32| smallest >> (LEVELS - 1 - level) & 1;
        (bit(self.x) | bit(self.y) << 1 | bit(self.z) << 2) as usize
    }

    /// Whether the voxel of this size around it is within the map.
    #[inline]
    pub fn is_in_reach(self, level: u32) -> bool {
        let first = (MAX_INDEX << level) - MAX_INDEX;
        let from_first = |smallest: u32| (smallest >> (LEVELS - 1 - level)).wrapping_sub(first);
        (from_first(self.x) | from_first(self.y) | from_first(self.z)) >> INDEX_BITS == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(x: f32, y: f32, z: f32) -> Smallest {
        Smallest::around(&na::Vector3::new(x, y, z)).unwrap()
    }

    #[test]
    fn voxels_are_children_of_larger_ones() {
        let mut tree = VoxelTree::with_capacity(0);
        let (one, other) = (place(4000.0, 4000.0, 4001.5), place(4003.0, 4001.0, 4001.5));
        assert_eq!(tree.largest(one), None);
        let largest = tree.add_largest(one);
        assert_eq!((tree.largest(other), tree.largest(place(3999.0, 4000.0, 4000.0))), (Some(largest), None));
        let middle = tree.add_child(largest, one, 1);
        assert_eq!((tree.child(largest, one, 1), tree.child(largest, other, 1)), (Some(middle), None));
        let small = tree.add_child(middle, one, 2);
        let beside = place(4000.0, 4000.0, 4000.5);
        assert_eq!((tree.child(middle, one, 2), tree.child(middle, beside, 2)), (Some(small), None));
        assert_eq!((largest, middle, small, tree.len()), (0, 1, 2, 3));
    }

    #[test]
    fn places_of_voxels_are_restored() {
        let mut tree = VoxelTree::with_capacity(0);
        let one = place(4003.0, 4001.0, 4002.0);
        let largest = tree.add_largest(one);
        let middle = tree.add_child(largest, one, 1);
        tree.add_child(middle, one, 2);
        let places = tree.places().into_iter().flatten().map(|(first, level)| (first.indices(), level));
        let expected = [([4000, 4000, 4000], 0), ([4002, 4000, 4002], 1), ([4003, 4001, 4002], 2)];
        assert_eq!(places.collect::<Vec<_>>(), expected);
        assert!(Smallest::of_indices([0, 8192, 0]).is_none() && Smallest::of_indices([8191; 3]).is_some());
    }

    #[test]
    fn smaller_voxels_have_a_shorter_reach() {
        let at = |x: f32| [0, 1, 2].map(|level| place(x, 4096.0, 4096.0).is_in_reach(level));
        assert_eq!([at(4096.0), at(4096.0 + 1030.0)], [[true; 3], [true, true, false]]);
        assert_eq!([at(4096.0 - 2050.0), at(8191.0)], [[true, false, false]; 2]);
        assert!(Smallest::around(&na::Vector3::new(8192.0, 0.0, 0.0)).is_none());
        assert!(Smallest::around(&na::Vector3::new(-0.5, f32::NAN, 0.0)).is_none());
    }

    #[test]
    fn children_of_removed_voxels_are_removed() {
        let mut tree = VoxelTree::with_capacity(0);
        let places = [place(10.0, 10.0, 10.0), place(500.0, 10.0, 10.0)];
        for place in places {
            let largest = tree.add_largest(place);
            let middle = tree.add_child(largest, place, 1);
            tree.add_child(middle, place, 2);
        }
        let (filtered, kept) = tree.filtered(|number| number != 1);
        assert_eq!((kept, filtered.len()), (vec![0, 3, 4, 5], 4));
        let numbers = places.map(|place| {
            let middle = filtered.child(filtered.largest(place)?, place, 1)?;
            filtered.child(middle, place, 2)
        });
        assert_eq!(numbers, [None, Some(3)]);
    }
}
