//! Computes the voxels of points.

use portolan_geometry::Point3f;

use crate::{lround, lround_small};

/// Number of points whose voxels are computed at once.
pub(super) const BATCH: usize = 8;
/// Limit of the indices that are rounded several at once.
const MAX_SMALL_INDEX: f32 = (1 << 22) as f32;

/// The voxel of a point, and the index of the point.
pub(super) type Numbered = (VoxelKey, u32);

/// Calls `visit` with the voxel of this edge (positive, metres) and the index of each point whose coordinates
/// are finite, until it returns false.
pub(super) fn for_each_voxel(
    points: impl Iterator<Item = Point3f>,
    edge: f32,
    mut visit: impl FnMut(VoxelKey, u32) -> bool,
) {
    for_each_batch(points, edge, |batch| batch.iter().all(|(key, number)| visit(*key, *number)));
}

/// The same for at most [`BATCH`] points at once.
pub(super) fn for_each_batch(
    points: impl Iterator<Item = Point3f>,
    edge: f32,
    mut visit: impl FnMut(&[Numbered]) -> bool,
) {
    let mut points = points.fuse();
    let mut batch = [[0.0; 3]; BATCH];
    let mut voxels = [Numbered::default(); BATCH];
    let mut first = 0;
    loop {
        let mut filled = 0;
        while filled < BATCH
            && let Some(point) = points.next()
        {
            batch[filled] = [point.x, point.y, point.z];
            filled += 1;
        }
        // More points than u32 counts would take 48 GiB.
        let finite = match small_indices(&batch, edge) {
            Some(indices) => {
                for (i, index) in indices.iter().enumerate() {
                    voxels[i] = (VoxelKey::of_index(*index), first + i as u32);
                }
                filled
            }
            None => {
                let mut finite = 0;
                for (point, number) in batch[..filled].iter().zip(first..) {
                    if let Some(key) = VoxelKey::of_point(point, edge) {
                        voxels[finite] = (key, number);
                        finite += 1;
                    }
                }
                finite
            }
        };
        if !visit(&voxels[..finite]) || filled < BATCH {
            return;
        }
        first += BATCH as u32;
    }
}

/// Voxel indices of points, if all are small numbers.
#[inline]
pub(super) fn small_indices<const N: usize>(points: &[[f32; 3]; N], edge: f32) -> Option<[[i32; 3]; N]> {
    let mut indices = [[0; 3]; N];
    let mut are_small = true;
    // In this form it is compiled into a few vector instructions.
    for (index, coordinate) in indices.as_flattened_mut().iter_mut().zip(points.as_flattened()) {
        let place = coordinate / edge;
        are_small &= place.abs() < MAX_SMALL_INDEX;
        *index = lround_small(place);
    }
    are_small.then_some(indices)
}

/// A voxel in 21 bits per axis, overlapping beyond ±2^20 voxels as in Cartographer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct VoxelKey(u64);

impl VoxelKey {
    #[inline]
    fn of_index([x, y, z]: [i32; 3]) -> Self {
        Self::of_indices([i64::from(x), i64::from(y), i64::from(z)])
    }

    #[inline]
    fn of_indices([x, y, z]: [i64; 3]) -> Self {
        Self(((x as u64) << 42).wrapping_add((y as u64) << 21).wrapping_add(z as u64))
    }

    /// `None` for a point that is not finite.
    #[cold]
    fn of_point(point: &[f32; 3], edge: f32) -> Option<Self> {
        let is_finite = point.iter().all(|coordinate| coordinate.is_finite());
        is_finite.then(|| Self::of_indices(point.map(|coordinate| lround(coordinate / edge))))
    }

    /// First slot of the search for a voxel in a table of this many slots (a power of two, at least two).
    /// Fibonacci hashing, because only the highest bits of the product depend on all three axes.
    #[inline]
    pub fn slot(self, slots: usize) -> usize {
        (self.0.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - slots.trailing_zeros())) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn keys(points: &[[f32; 3]], edge: f32) -> Vec<Option<VoxelKey>> {
        let mut keys = vec![None; points.len()];
        for_each_voxel(points.iter().map(|p| Point3f::from(*p)), edge, |key, i| {
            keys[i as usize] = Some(key);
            true
        });
        keys
    }

    proptest! {
        #[test]
        fn voxels_are_the_same_one_by_one_and_in_batches(
            near in prop::collection::vec(prop::array::uniform3(-60.0f32..60.0), 0..30),
            any in prop::collection::vec(prop::array::uniform3(any::<f32>()), 0..3),
            edge in 0.01f32..4.0,
        ) {
            let on_edges = [[0.5 * edge, -0.5 * edge, 1.5 * edge], [2.5 * edge, -2.5 * edge, 0.0]];
            let points: Vec<[f32; 3]> = near.into_iter().chain(on_edges).chain(any).collect();
            let expected: Vec<_> = points.iter().map(|p| VoxelKey::of_point(p, edge)).collect();
            prop_assert_eq!(keys(&points, edge), expected);
        }
    }

    #[test]
    fn visits_end_when_asked_to() {
        let points = [Point3f::origin(); 20];
        let mut visits = 0;
        for_each_voxel(points.into_iter(), 1.0, |_, i| {
            visits += 1;
            i < 10
        });
        assert_eq!(visits, 11);
    }
}
