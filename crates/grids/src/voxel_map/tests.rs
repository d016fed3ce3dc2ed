use std::collections::BTreeMap;

use super::*;
use crate::testing::Lcg;

fn random_cells(seed: u32, n: usize, reach: f32) -> BTreeMap<VoxelIndex, u16> {
    let mut lcg = Lcg::new(seed);
    (0..n).map(|i| ([0; 3].map(|_| lcg.symmetric(reach).round() as i32), i as u16)).collect()
}

fn filled(cells: &BTreeMap<VoxelIndex, u16>) -> VoxelMap<u16> {
    let mut map = VoxelMap::default();
    for (cell, value) in cells {
        *map.entry(*cell).unwrap() = *value;
    }
    map
}

/// The order of `formats.md` §4.6, literally.
fn nested(c: &VoxelIndex) -> [i32; 9] {
    let [x, y, z] = *c;
    [z >> 6, y >> 6, x >> 6, (z >> 3) & 7, (y >> 3) & 7, (x >> 3) & 7, z & 7, y & 7, x & 7]
}

#[test]
fn values_are_kept_at_their_indices() {
    for (seed, reach) in [(1, 3000.0), (2, 20.0), (3, 8000.0)] {
        let cells = random_cells(seed, 10_000, reach);
        for map in [filled(&cells), filled(&cells).compacted()] {
            assert_eq!(map.num_cells(), cells.len());
            assert!(cells.iter().all(|(cell, value)| map.get(*cell) == Some(*value)));
            let mut visited = BTreeMap::new();
            map.for_each(|cell, value| assert_eq!(visited.insert(cell, value), None));
            assert_eq!(visited, cells);
            let mut in_order = Vec::new();
            map.for_each_in_file_order(|cell, value| in_order.push((cell, value)));
            assert_eq!(in_order.len(), cells.len());
            assert!(in_order.is_sorted_by_key(|(cell, _)| nested(cell)));
        }
        assert_eq!(filled(&cells), filled(&cells).compacted());
    }
}

#[test]
fn corners_are_the_eight_cells() {
    let map = filled(&random_cells(4, 30_000, 20.0));
    let mut lcg = Lcg::new(5);
    for _ in 0..3000 {
        let low = [0; 3].map(|_| lcg.symmetric(23.0).round() as i32);
        for (c, value) in map.corners(low).into_iter().enumerate() {
            assert_eq!(value, map.get(corner(low, c)), "{low:?} {c}");
        }
    }
    for edge in [-8193, -8192, 8190, 8191, i32::MIN, i32::MAX] {
        assert_eq!(map.corners([edge, 0, 30]), [None; 8]);
    }
}

#[test]
fn cells_have_bounds_and_the_extent_doubles() {
    let mut map = VoxelMap::<u16>::default();
    assert_eq!(map.extent(), 128);
    for (cell, extent) in [([63, -64, 0], 128), ([64, 0, 0], 256), ([0, -129, 0], 512), ([0, 0, 8191], 16384)]
    {
        assert!(map.entry(cell).is_some());
        assert_eq!(map.extent(), extent, "{cell:?}");
    }
    for cell in [[8192, 0, 0], [0, -8193, 0], [0, 0, i32::MAX]] {
        assert!(map.entry(cell).is_none() && map.get(cell).is_none());
    }
}

#[test]
fn boxes_have_the_cells_in_them() {
    let cells = random_cells(6, 20_000, 20.0);
    let map = filled(&cells);
    for (first, last) in [([-7, 3, -20], [9, 5, 1]), ([-30; 3], [30; 3]), ([-60; 3], [0, 0, -1])] {
        let mut found = BTreeMap::new();
        map.for_each_in_box(first, last, |cell, value| assert_eq!(found.insert(cell, value), None));
        let is_inside = |cell: &VoxelIndex| (0..3).all(|a| first[a] <= cell[a] && cell[a] <= last[a]);
        let expected: BTreeMap<_, _> =
            cells.iter().filter(|(c, _)| is_inside(c)).map(|(c, v)| (*c, *v)).collect();
        assert_eq!(found, expected);
    }
}
