//! How many voxels points are in, counted no further than is asked.

use portolan_geometry::Point3f;

use super::reservoir::voxel_key;

/// Smallest number of slots; a power of two.
const MIN_SLOTS: usize = 256;
/// Marks a free slot; the voxel with this key is counted apart.
const FREE: u64 = 1 << 63;

/// Scratch memory for counting, reusable between calls.
#[derive(Default)]
pub(super) struct VoxelCount {
    /// Keys by open addressing with linear probing, at most half full; the length is a power of two.
    slots: Vec<u64>,
    has_free_key: bool,
    count: usize,
}

impl VoxelCount {
    /// Whether the finite ones of `points` are in `wanted` voxels with this edge at least; without voxels
    /// (no positive edge) each point counts.
    pub fn are_at_least(
        &mut self,
        wanted: usize,
        points: impl ExactSizeIterator<Item = Point3f>,
        edge: f32,
    ) -> bool {
        let is_finite = |p: &Point3f| p.x.is_finite() && p.y.is_finite() && p.z.is_finite();
        if edge.is_nan() || edge <= 0.0 {
            return points.filter(is_finite).count() >= wanted;
        }
        // There is no need for more slots than that: counting ends before.
        let slots = (2 * wanted.min(points.len())).next_power_of_two().max(MIN_SLOTS);
        self.slots.clear();
        self.slots.resize(slots, FREE);
        (self.count, self.has_free_key) = (0, false);
        self.count >= wanted || points.filter(is_finite).any(|p| self.add(voxel_key(&p, edge)) >= wanted)
    }

    /// Adds a voxel; how many there are now.
    #[inline]
    fn add(&mut self, key: u64) -> usize {
        if key == FREE {
            self.count += usize::from(!std::mem::replace(&mut self.has_free_key, true));
            return self.count;
        }
        let mask = self.slots.len() - 1;
        let mut i = super::reservoir::slot_of(key, self.slots.len());
        loop {
            let slot = &mut self.slots[i & mask];
            if *slot == key {
                return self.count;
            }
            if *slot == FREE {
                *slot = key;
                self.count += 1;
                return self.count;
            }
            i += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voxels_are_counted_as_they_are_sampled() {
        let points: Vec<Point3f> =
            (0..500).map(|i| Point3f::new((i % 37) as f32, (i % 11) as f32, -(i as f32) / 90.0)).collect();
        let mut reservoir = super::super::reservoir::Reservoir::default();
        let mut count = VoxelCount::default();
        for edge in [-1.0, 0.0, 0.3, 1.0, 2.5, 1e9, f32::NAN] {
            let voxels = reservoir.sample(points.iter().copied(), edge).count();
            for wanted in [0, 1, voxels.saturating_sub(1), voxels, voxels + 1, 1000] {
                let enough = count.are_at_least(wanted, points.iter().copied(), edge);
                assert_eq!(enough, voxels >= wanted, "{edge} {wanted}");
            }
        }
    }

    #[test]
    fn the_voxel_with_the_key_of_free_slots_counts_once() {
        let far = Point3f::new(-(2f32.powi(21)), 0.0, 0.0);
        assert_eq!(voxel_key(&far, 1.0), FREE);
        let points = [far, far, Point3f::origin()];
        let mut count = VoxelCount::default();
        assert!(count.are_at_least(2, points.into_iter(), 1.0));
        assert!(!count.are_at_least(3, points.into_iter(), 1.0));
    }
}
