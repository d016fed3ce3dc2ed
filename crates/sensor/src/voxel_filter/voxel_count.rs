//! Counts the voxels that contain points, up to a limit.

use portolan_geometry::Point3f;

use super::voxel::{BATCH, VoxelKey, for_each_voxel, small_indices};

/// Smallest number of slots; a power of two.
const MIN_SLOTS: usize = 256;
/// Maximum number of voxels for a bit set.
const MAX_BITS: usize = 1 << 18;

/// Points for which voxels of any size are counted.
pub(super) struct CountedPoints {
    /// Batches of coordinates, metres; the last one is filled up with copies of its last point.
    batches: Vec<[[f32; 3]; BATCH]>,
    count: usize,
    /// Corners of the bounding box of all points, metres.
    bounds: [[f32; 3]; 2],
    /// Reused memory of the counts.
    bits: Vec<u64>,
    slots: Vec<Option<VoxelKey>>,
}

impl CountedPoints {
    /// Points whose coordinates are finite.
    pub fn new(points: impl ExactSizeIterator<Item = Point3f>) -> Self {
        let count = points.len();
        let mut batches: Vec<[[f32; 3]; BATCH]> = Vec::with_capacity(count.div_ceil(BATCH));
        let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        for (i, point) in points.enumerate() {
            let point = point.coords.data.0[0];
            for axis in 0..3 {
                bounds[0][axis] = bounds[0][axis].min(point[axis]);
                bounds[1][axis] = bounds[1][axis].max(point[axis]);
            }
            if i % BATCH == 0 {
                batches.push([point; BATCH]);
            }
            if let Some(batch) = batches.last_mut() {
                batch[i % BATCH..].fill(point);
            }
        }
        Self { batches, count, bounds, bits: Vec::new(), slots: Vec::new() }
    }

    /// Whether the points are in at least `wanted` voxels of this edge (metres). If the edge is not positive,
    /// each point counts.
    pub fn are_in(&mut self, wanted: usize, edge: f32) -> bool {
        if wanted == 0 || edge.is_nan() || edge <= 0.0 {
            return self.count >= wanted;
        }
        match small_indices(&[self.bounds[0], self.bounds[1]], edge) {
            Some([first, last]) => {
                let sizes = [0, 1, 2].map(|axis| (last[axis] - first[axis] + 1) as usize);
                let voxels = sizes[0].saturating_mul(sizes[1]).saturating_mul(sizes[2]);
                match voxels <= MAX_BITS {
                    true => self.are_in_by_bits(wanted, edge, first, sizes),
                    false => self.are_in_by_keys(wanted, edge),
                }
            }
            None => self.are_in_by_keys(wanted, edge),
        }
    }

    /// The same with one bit per voxel from `first` on.
    fn are_in_by_bits(&mut self, wanted: usize, edge: f32, first: [i32; 3], sizes: [usize; 3]) -> bool {
        self.bits.clear();
        self.bits.resize((sizes[0] * sizes[1] * sizes[2]).div_ceil(64), 0);
        let [along_y, along_z] = [sizes[0], sizes[0] * sizes[1]];
        let mut count = 0;
        for batch in &self.batches {
            let Some(indices) = small_indices(batch, edge) else { continue };
            for index in indices {
                let along = |axis: usize| (index[axis] - first[axis]) as usize;
                let place = along(0) + along_y * along(1) + along_z * along(2);
                let (word, bit) = (&mut self.bits[place / 64], 1 << (place % 64));
                count += usize::from(*word & bit == 0);
                *word |= bit;
            }
            if count >= wanted {
                return true;
            }
        }
        false
    }

    /// The same by open addressing with linear probing, at most half full.
    fn are_in_by_keys(&mut self, wanted: usize, edge: f32) -> bool {
        // More slots are not needed: counting stops at `wanted`.
        let slots = (2 * wanted.min(self.count)).next_power_of_two().max(MIN_SLOTS);
        self.slots.clear();
        self.slots.resize(slots, None);
        let mut count = 0;
        let points = self.batches.as_flattened().iter().map(|point| Point3f::from(*point));
        for_each_voxel(points, edge, |key, _| {
            let mut i = key.slot(slots);
            while self.slots[i].is_some_and(|other| other != key) {
                i = (i + 1) & (slots - 1);
            }
            count += usize::from(self.slots[i].replace(key).is_none());
            count < wanted
        });
        count >= wanted
    }
}

#[cfg(test)]
mod tests {
    use super::super::reservoir::sample;
    use super::*;

    #[test]
    fn voxels_are_counted_as_they_are_sampled() {
        let points: Vec<Point3f> =
            (0..501).map(|i| Point3f::new((i % 37) as f32, (i % 11) as f32, -(i as f32) / 90.0)).collect();
        let far = Point3f::new(-(2f32.powi(21)), 1e9, 1e30);
        for points in [points.clone(), [points, vec![far, far]].concat()] {
            let mut counted = CountedPoints::new(points.iter().copied());
            for edge in [-1.0, 0.0, 0.01, 0.3, 1.0, 2.5, 1e9, f32::NAN, f32::INFINITY] {
                let voxels = sample(points.iter().copied(), edge).len();
                for wanted in [0, 1, voxels.saturating_sub(1), voxels, voxels + 1, 1000] {
                    assert_eq!(counted.are_in(wanted, edge), voxels >= wanted, "{edge} {wanted}");
                }
            }
        }
    }
}
