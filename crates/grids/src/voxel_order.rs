//! Sorts numbers by the voxels that they belong to.

/// Bits along each axis in a number of a voxel.
const AXIS_BITS: u32 = 12;
const AXES: u32 = 3;
/// Number of bits by which voxels are sorted at a time: the counters fit the nearest cache.
const DIGIT_BITS: u32 = 11;
const DIGITS: usize = (AXES * AXIS_BITS).div_ceil(DIGIT_BITS) as usize;

/// Sorts numbers whose bits from `shift` on are a voxel, 12 bits along each of three axes. Those of one voxel
/// keep their order. (By counting: voxels are close to each other, so that about half of the bits identify
/// those in the box around all of them.)
pub(crate) fn sort_by_voxel(numbers: &mut Vec<u64>, shift: u32) {
    let bounds = Bounds::around(numbers, shift);
    let digits = bounds.bits().div_ceil(DIGIT_BITS) as usize;
    let mut begins = vec![[0u32; 1 << DIGIT_BITS]; digits];
    for number in numbers.iter() {
        let place = bounds.place(*number);
        begins.iter_mut().enumerate().for_each(|(digit, begins)| begins[digit_of(place, digit)] += 1);
    }
    let mut sorted = vec![0; numbers.len()];
    for (digit, begins) in begins.iter_mut().enumerate() {
        let mut sum = 0;
        begins.iter_mut().for_each(|begin| sum += std::mem::replace(begin, sum));
        for number in numbers.iter() {
            let begin = &mut begins[digit_of(bounds.place(*number), digit)];
            sorted[*begin as usize] = *number;
            *begin += 1;
        }
        std::mem::swap(numbers, &mut sorted);
    }
}

#[inline]
fn digit_of(place: u64, digit: usize) -> usize {
    debug_assert!(digit < DIGITS);
    (place >> (DIGIT_BITS * digit as u32)) as usize & ((1 << DIGIT_BITS) - 1)
}

/// The box around voxels.
struct Bounds {
    shift: u32,
    first: [u64; AXES as usize],
    /// Number of voxels along each axis.
    sizes: [u64; AXES as usize],
}

impl Bounds {
    fn around(numbers: &[u64], shift: u32) -> Self {
        let (mut first, mut last) = ([u64::MAX; 3], [0; 3]);
        for number in numbers {
            for (axis, index) in indices(*number, shift).into_iter().enumerate() {
                first[axis] = index.min(first[axis]);
                last[axis] = index.max(last[axis]);
            }
        }
        Self { shift, first, sizes: [0, 1, 2].map(|axis| (last[axis] + 1).saturating_sub(first[axis])) }
    }

    /// Bits of the largest place.
    fn bits(&self) -> u32 {
        u64::BITS - self.sizes.iter().product::<u64>().leading_zeros()
    }

    /// Index of the voxel in the box, along the first axis first.
    #[inline]
    fn place(&self, number: u64) -> u64 {
        let [x, y, z] = indices(number, self.shift);
        let [first_x, first_y, first_z] = self.first;
        ((z - first_z) * self.sizes[1] + (y - first_y)) * self.sizes[0] + (x - first_x)
    }
}

/// The indices of a voxel along each axis.
#[inline]
fn indices(number: u64, shift: u32) -> [u64; 3] {
    let index = |axis: u32| number >> (shift + axis * AXIS_BITS) & ((1 << AXIS_BITS) - 1);
    [index(0), index(1), index(2)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn voxels_are_sorted_stably(
            voxels in prop::collection::vec((0u64..1 << 36, 0u64..3), 0..300),
        ) {
            let mut numbers: Vec<u64> =
                (0..).zip(&voxels).map(|(i, (v, few))| (if *few > 0 { *few } else { *v }) << 28 | i).collect();
            let mut expected = numbers.clone();
            expected.sort_by_key(|number| number >> 28);
            sort_by_voxel(&mut numbers, 28);
            prop_assert_eq!(numbers, expected);
        }

        #[test]
        fn voxels_in_a_small_box_are_in_order(
            voxels in prop::collection::vec(prop::array::uniform3(2000u64..2100), 0..300),
        ) {
            let number = |(i, [x, y, z]): (u64, &[u64; 3])| (z << 24 | y << 12 | x) << 20 | i;
            let mut numbers: Vec<u64> = (0..).zip(&voxels).map(number).collect();
            let mut expected = numbers.clone();
            expected.sort_unstable();
            sort_by_voxel(&mut numbers, 20);
            prop_assert_eq!(numbers, expected);
        }
    }
}
