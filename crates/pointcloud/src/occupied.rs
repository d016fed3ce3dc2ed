//! Finds the voxels with points in them: a bit for each voxel, in blocks.

use portolan_spatial::{VoxelHash, VoxelKey as Key};

use crate::error::CloudError;
use crate::thin::check_voxel_size;

/// Binary logarithm of the edge of a block in voxels: 2³ voxels.
const BLOCK: i32 = 3;
/// Maximum number of blocks: 25 MB. A picture of 1500 by 1500 voxels has 35,000 blocks in each layer.
const MAX_BLOCKS: usize = 1 << 18;

/// Number of recently used blocks that are cached.
const RECENT: usize = 256;
/// Index of a missing block.
const NONE: u32 = u32::MAX;

/// Set of voxels with points, in bounded memory.
#[derive(Debug)]
pub struct OccupiedVoxels {
    per_metre: f64,
    max_blocks: usize,
    blocks: VoxelHash<u32>,
    bits: Vec<[u64; 8]>,
    /// Cache of recently used blocks, indexed by some bits of their keys: scans return to them often.
    recent: [(Key, u32); RECENT],
}

impl OccupiedVoxels {
    /// An empty set; `voxel_size` in metres.
    ///
    /// # Errors
    /// Fails if the size is not 0.1 mm to 1 km.
    pub fn new(voxel_size: f64) -> Result<Self, CloudError> {
        Self::with_blocks(voxel_size, MAX_BLOCKS)
    }

    fn with_blocks(voxel_size: f64, max_blocks: usize) -> Result<Self, CloudError> {
        check_voxel_size(voxel_size)?;
        Ok(Self {
            per_metre: 1.0 / voxel_size,
            max_blocks,
            blocks: VoxelHash::default(),
            bits: Vec::new(),
            recent: [([0; 3], NONE); RECENT],
        })
    }

    /// Adds a point and returns whether it is the first one in its voxel; false for points that are not
    /// finite or farther than two thousand million voxels. If there are too many blocks all voxels are
    /// dropped, and the next point in each of them counts as the first again.
    #[inline]
    pub fn add(&mut self, position: [f64; 3]) -> bool {
        let scaled = position.map(|v| v * self.per_metre);
        if !scaled.iter().all(|v| v.abs() < 2e9) {
            return false;
        }
        let [x, y, z] = scaled.map(rounded_down);
        let key = [x >> BLOCK, y >> BLOCK, z >> BLOCK];
        let place = (key[0] ^ key[1] << 3 ^ key[2] << 5) as usize % RECENT;
        let index = match self.recent.get(place) {
            Some((recent, index)) if *recent == key && *index != NONE => *index,
            _ => self.block(key, place),
        } as usize;
        let within = |v: i32| (v & ((1 << BLOCK) - 1)) as usize;
        let layer = self.bits.get_mut(index).and_then(|block| block.get_mut(within(z)));
        let Some(layer) = layer else { return false };
        let bit = 1 << (within(y) << BLOCK | within(x));
        let is_first = *layer & bit == 0;
        *layer |= bit;
        is_first
    }

    fn block(&mut self, key: Key, place: usize) -> u32 {
        if self.bits.len() >= self.max_blocks && !self.blocks.contains(&key) {
            self.blocks.clear();
            self.bits.clear();
            self.recent = [(key, NONE); RECENT];
        }
        let index = *self.blocks.or_insert_with(key, || {
            self.bits.push([0; 8]);
            (self.bits.len() - 1) as u32
        });
        if let Some(recent) = self.recent.get_mut(place) {
            *recent = (key, index);
        }
        index
    }
}

/// Rounds down; `floor` is a function call on generic CPU targets.
#[inline]
fn rounded_down(value: f64) -> i32 {
    let whole = value as i32;
    whole - i32::from(f64::from(whole) > value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn points() -> impl Iterator<Item = [f64; 3]> {
        let mut random = portolan_numeric::Lcg64::new(77);
        let mut random = move || (random.bits() >> 40) as f64 / f64::from(1 << 24);
        (0..40_000).map(move |_| [6.0 * random() - 3.0, 4.0 * random() - 2.0, random() - 0.5])
    }

    #[test]
    fn each_voxel_is_first_once() {
        let mut voxels = OccupiedVoxels::new(0.1).unwrap();
        let mut expected = BTreeSet::new();
        for point in points().chain(points()) {
            let is_new = expected.insert(point.map(|v| (v * 10.0).floor() as i64));
            assert_eq!(voxels.add(point), is_new, "{point:?}");
        }
        assert!(!voxels.add([f64::NAN, 0.0, 0.0]) && !voxels.add([0.0, 1e300, 0.0]));
        assert!(voxels.add([1.9e8, -1.9e8, 0.0]));
    }

    #[test]
    fn blocks_are_bounded() {
        let mut voxels = OccupiedVoxels::with_blocks(0.1, 40).unwrap();
        let firsts = points().filter(|point| voxels.add(*point)).count();
        let all: BTreeSet<_> = points().map(|p| p.map(|v| (v * 10.0).floor() as i64)).collect();
        assert!(voxels.bits.len() <= 40 && firsts > all.len(), "{firsts}");
        assert!(OccupiedVoxels::new(0.0).is_err());
    }
}
