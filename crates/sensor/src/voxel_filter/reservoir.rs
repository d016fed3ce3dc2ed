//! One point per voxel by reservoir sampling, on a hash table of its own.

use portolan_geometry::Point3f;

use crate::lround;

/// Smallest number of slots; a power of two.
const MIN_SLOTS: usize = 256;
/// A first call begins with half a slot for each point, and no more than this: tables that grow are filled twice.
const MOST_FIRST_SLOTS: usize = 1 << 14;

/// What is known of one voxel. `count == 0` marks a free slot.
#[derive(Clone, Copy, Default)]
struct Voxel {
    key: u64,
    count: u32,
    kept: u32,
}

/// Scratch memory of the filter, reusable between calls. Nothing of an earlier call shows in a later
/// one.
#[derive(Default)]
pub(super) struct Reservoir {
    /// Open addressing with linear probing, at most half full; the length is a power of two.
    slots: Vec<Voxel>,
    occupied: usize,
    /// One bit per point: whether it is kept.
    kept: Vec<u64>,
}

impl Reservoir {
    /// Chooses one point per voxel; gives the indices of the chosen points in ascending order.
    pub fn sample(
        &mut self,
        points: impl ExactSizeIterator<Item = Point3f>,
        resolution: f32,
    ) -> impl Iterator<Item = u32> + '_ {
        let voxels_of_last_call = self.occupied;
        self.kept.clear();
        self.kept.resize(points.len().div_ceil(64), 0);
        // The finest filter of an adaptive search needs about as many voxels as the one before it.
        let expected = (2 * voxels_of_last_call).max((points.len() / 2).min(MOST_FIRST_SLOTS));
        let slots = expected.next_power_of_two().max(MIN_SLOTS);
        self.slots.clear();
        self.slots.resize(slots, Voxel::default());
        self.occupied = 0;
        let mut random = MinimalStandard::new();
        // A count of points beyond u32 would need 48 GiB of them.
        for (point, index) in points.zip(0_u32..) {
            if !(point.x.is_finite() && point.y.is_finite() && point.z.is_finite()) {
                continue;
            }
            if resolution > 0.0 {
                self.visit(voxel_key(&point, resolution), index, &mut random);
            } else {
                set_bit(&mut self.kept, index);
            }
        }
        set_bits(&self.kept)
    }

    #[inline]
    fn visit(&mut self, key: u64, index: u32, random: &mut MinimalStandard) {
        if 2 * self.occupied >= self.slots.len() {
            self.grow();
        }
        let slot = find(&mut self.slots, key);
        if slot.count == 0 {
            *slot = Voxel { key, count: 1, kept: index };
            self.occupied += 1;
            set_bit(&mut self.kept, index);
            return;
        }
        slot.count += 1;
        if random.draws_last_of(slot.count) {
            clear_bit(&mut self.kept, slot.kept);
            slot.kept = index;
            set_bit(&mut self.kept, index);
        }
    }

    fn grow(&mut self) {
        let larger = vec![Voxel::default(); 2 * self.slots.len()];
        let old = std::mem::replace(&mut self.slots, larger);
        for voxel in old.into_iter().filter(|v| v.count > 0) {
            *find(&mut self.slots, voxel.key) = voxel;
        }
    }
}

/// The slot of a voxel, or the free slot where it belongs. Needs at least one free slot.
#[inline]
fn find(slots: &mut [Voxel], key: u64) -> &mut Voxel {
    let mask = slots.len() - 1;
    let mut i = slot_of(key, slots.len());
    while slots[i].count != 0 && slots[i].key != key {
        i = (i + 1) & mask;
    }
    &mut slots[i]
}

/// Where to look first for a key among so many slots (a power of two, two at least): Fibonacci hashing,
/// because only the highest bits of the product depend on all three axes.
#[inline]
pub(super) fn slot_of(key: u64, slots: usize) -> usize {
    (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - slots.trailing_zeros())) as usize
}

/// 21 bits per axis, overlapping beyond ±2^20 voxels as in the reference.
#[inline]
pub(super) fn voxel_key(point: &Point3f, resolution: f32) -> u64 {
    let cell = |coordinate: f32| lround(coordinate / resolution) as u64;
    (cell(point.x) << 42).wrapping_add(cell(point.y) << 21).wrapping_add(cell(point.z))
}

#[inline]
fn set_bit(words: &mut [u64], index: u32) {
    words[index as usize / 64] |= 1 << (index % 64);
}

#[inline]
fn clear_bit(words: &mut [u64], index: u32) {
    words[index as usize / 64] &= !(1 << (index % 64));
}

fn set_bits(words: &[u64]) -> impl Iterator<Item = u32> + '_ {
    words.iter().zip(0_u32..).flat_map(|(word, i)| {
        let mut rest = *word;
        std::iter::from_fn(move || {
            let bit = (rest != 0).then(|| rest.trailing_zeros())?;
            rest &= rest - 1;
            Some(64 * i + bit)
        })
    })
}

/// The generator `minstd_rand0` and the way in which libstdc++ draws integers from it.
struct MinimalStandard(u64);

impl MinimalStandard {
    const MODULUS: u64 = 2_147_483_647;
    /// Largest minus smallest value of the generator.
    const RANGE: u32 = 2_147_483_645;

    fn new() -> Self {
        Self(1)
    }

    /// The next value less one, 0 to `RANGE`.
    #[inline]
    fn next(&mut self) -> u32 {
        self.0 = self.0 * 16_807 % Self::MODULUS;
        self.0 as u32 - 1
    }

    /// Draws an integer from 1 to `n`; whether it is `n`.
    #[inline]
    fn draws_last_of(&mut self, n: u32) -> bool {
        let share = Self::RANGE / n;
        if share == 0 {
            // More points in one voxel than the generator has values.
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
