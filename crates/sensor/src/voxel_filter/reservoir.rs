//! Chooses one point per voxel by reservoir sampling, with its own hash table.

use portolan_geometry::Point3f;

use super::voxel::{BATCH, Numbered, VoxelKey, for_each_batch};

/// Smallest number of slots; a power of two.
const MIN_SLOTS: usize = 256;
/// Maximum size of the first table, which has two slots per point: a table that grows is filled twice.
const MOST_FIRST_SLOTS: usize = 1 << 17;

/// State of one voxel.
#[derive(Clone, Copy)]
struct Voxel {
    key: VoxelKey,
    count: u32,
    kept: u32,
}

/// Chooses one point per voxel of this edge and returns the indices of the chosen points in ascending order.
/// An edge that is not positive keeps all points whose coordinates are finite.
pub(super) fn sample(points: impl ExactSizeIterator<Item = Point3f>, edge: f32) -> Vec<u32> {
    if edge.is_nan() || edge <= 0.0 {
        let is_finite = |p: &Point3f| p.coords.iter().all(|coordinate| coordinate.is_finite());
        return points.zip(0..).filter(|(p, _)| is_finite(p)).map(|(_, number)| number).collect();
    }
    let mut reservoir = Reservoir::new(points.len());
    for_each_batch(points, edge, |batch| {
        reservoir.visit_all(batch);
        true
    });
    reservoir.chosen()
}

struct Reservoir {
    /// Numbers of voxels, from one on; zero is a free slot. Open addressing with linear probing, at most half
    /// full; the length is a power of two.
    slots: Vec<u32>,
    voxels: Vec<Voxel>,
    points: usize,
    random: MinimalStandard,
}

impl Reservoir {
    fn new(points: usize) -> Self {
        let slots = (2 * points).min(MOST_FIRST_SLOTS).next_power_of_two().max(MIN_SLOTS);
        Self {
            slots: vec![0; slots],
            voxels: Vec::with_capacity(points.min(slots / 2)),
            points,
            random: MinimalStandard(1),
        }
    }

    /// Adds at most [`BATCH`] points. Their expected slots and voxels are read before any is changed, so that
    /// these reads overlap.
    fn visit_all(&mut self, batch: &[Numbered]) {
        let mut expected = [0; BATCH];
        for (expected, (key, _)) in expected.iter_mut().zip(batch) {
            *expected = self.slots[key.slot(self.slots.len())];
        }
        let mut are_known = [false; BATCH];
        for ((is_known, expected), (key, _)) in are_known.iter_mut().zip(expected).zip(batch) {
            let voxel = self.voxels.get((expected as usize).wrapping_sub(1));
            *is_known = voxel.is_some_and(|voxel| voxel.key == *key);
        }
        for ((is_known, expected), (key, number)) in are_known.into_iter().zip(expected).zip(batch) {
            match is_known {
                true => self.count(expected, *number),
                false => self.visit(*key, *number),
            }
        }
    }

    /// Adds a point to a voxel given by its number.
    #[inline]
    fn count(&mut self, voxel: u32, number: u32) {
        let voxel = &mut self.voxels[voxel as usize - 1];
        voxel.count += 1;
        // Half of the draws are unpredictable: a select costs less than a branch.
        let is_last = self.random.draws_last_of(voxel.count);
        voxel.kept = std::hint::select_unpredictable(is_last, number, voxel.kept);
    }

    #[inline]
    fn visit(&mut self, key: VoxelKey, number: u32) {
        let mask = self.slots.len() - 1;
        let mut i = key.slot(self.slots.len());
        while self.slots[i] != 0 {
            if self.voxels[self.slots[i] as usize - 1].key == key {
                self.count(self.slots[i], number);
                return;
            }
            i = (i + 1) & mask;
        }
        self.voxels.push(Voxel { key, count: 1, kept: number });
        self.slots[i] = self.voxels.len() as u32;
        if 2 * self.voxels.len() >= self.slots.len() {
            self.grow();
        }
    }

    #[cold]
    fn grow(&mut self) {
        self.slots = vec![0; 2 * self.slots.len()];
        let mask = self.slots.len() - 1;
        for (voxel, number) in self.voxels.iter().zip(1..) {
            let mut i = voxel.key.slot(self.slots.len());
            while self.slots[i] != 0 {
                i = (i + 1) & mask;
            }
            self.slots[i] = number;
        }
    }

    fn chosen(&self) -> Vec<u32> {
        // A bit set of the chosen points gives them in order.
        let mut is_chosen = vec![0_u64; self.points.div_ceil(64)];
        for voxel in &self.voxels {
            is_chosen[voxel.kept as usize / 64] |= 1 << (voxel.kept % 64);
        }
        let mut chosen = Vec::with_capacity(self.voxels.len());
        for (bits, first) in is_chosen.iter().zip((0u32..).step_by(64)) {
            let mut rest = *bits;
            while rest != 0 {
                chosen.push(first + rest.trailing_zeros());
                rest &= rest - 1;
            }
        }
        chosen
    }
}

/// The generator `minstd_rand0`, and libstdc++'s method to draw integers from it.
struct MinimalStandard(u64);

/// Range of the generator divided by n, for small n (entry 0 is unused).
const SHARES: [u32; 64] = {
    let mut shares = [u32::MAX; 64];
    let mut n = 1;
    while n < shares.len() {
        shares[n] = MinimalStandard::RANGE / n as u32;
        n += 1;
    }
    shares
};

impl MinimalStandard {
    const MODULUS: u64 = 2_147_483_647;
    /// Largest minus smallest value of the generator.
    const RANGE: u32 = 2_147_483_645;

    /// The next value of the generator minus one, 0 to `RANGE`.
    #[inline]
    fn next(&mut self) -> u32 {
        // The modulus is 2³¹ − 1, so 2³¹ is congruent to 1: the bits above 31 are added.
        let product = self.0 * 16_807;
        let folded = (product & Self::MODULUS) + (product >> 31);
        self.0 = if folded < Self::MODULUS { folded } else { folded - Self::MODULUS };
        self.0 as u32 - 1
    }

    /// Draws an integer from 1 to `n` and returns whether it is `n`.
    #[inline]
    fn draws_last_of(&mut self, n: u32) -> bool {
        let share = match SHARES.get(n as usize) {
            Some(share) => *share,
            None => Self::RANGE / n,
        };
        if share == 0 {
            // The voxel has more points than the generator has values.
            return false;
        }
        loop {
            let value = self.next();
            if value < n * share {
                return value >= (n - 1) * share;
            }
        }
    }
}
