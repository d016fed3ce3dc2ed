//! Sorting by the voxels that things are in.

/// Bits along each axis in a number of a voxel.
const AXIS_BITS: u32 = 12;
const AXES: u32 = 3;

/// Sorts numbers whose bits from `shift` on are a voxel, 12 bits along each of three axes. Those of one voxel keep
/// their order. (By counting, axis by axis: few of the indices along an axis occur, so that this takes a third of the
/// time of sorting by comparisons.)
pub(crate) fn sort_by_voxel(numbers: &mut Vec<u64>, shift: u32) {
    let mut sorted = vec![0; numbers.len()];
    let mut begins = vec![0u32; 1 << AXIS_BITS];
    for axis in 0..AXES {
        let index = |number: &u64| (number >> (shift + axis * AXIS_BITS)) as usize & ((1 << AXIS_BITS) - 1);
        begins.fill(0);
        numbers.iter().for_each(|number| begins[index(number)] += 1);
        let mut sum = 0;
        begins.iter_mut().for_each(|begin| sum += std::mem::replace(begin, sum));
        for number in numbers.iter() {
            let begin = &mut begins[index(number)];
            sorted[*begin as usize] = *number;
            *begin += 1;
        }
        std::mem::swap(numbers, &mut sorted);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn voxels_are_in_order_and_what_is_in_them_is_not_moved(
            voxels in prop::collection::vec((0u64..1 << 36, 0u64..3), 0..300),
        ) {
            let mut numbers: Vec<u64> =
                (0..).zip(&voxels).map(|(i, (v, few))| (if *few > 0 { *few } else { *v }) << 28 | i).collect();
            let mut expected = numbers.clone();
            expected.sort_by_key(|number| number >> 28);
            sort_by_voxel(&mut numbers, 28);
            prop_assert_eq!(numbers, expected);
        }
    }
}
