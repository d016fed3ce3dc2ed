//! Neighbours are those that another crate finds.
#![allow(clippy::unwrap_used)] // a test

mod other_tree;

use other_tree::OtherTree;
use portolan_spatial::{KdTree, VoxelMap};

/// Points on a floor and a wall, and queries near them.
fn points(count: usize, seed: u64) -> Vec<[f32; 3]> {
    let mut random = portolan_numeric::Lcg64::new(seed);
    let mut uniform = || (random.bits() >> 40) as f32 / (1u64 << 24) as f32;
    (0..count)
        .map(|i| {
            let (a, b, c) = (20.0 * uniform(), 20.0 * uniform(), 0.02 * uniform());
            if i % 2 == 0 { [a, b, c] } else { [c, a, 0.2 * b] }
        })
        .collect()
}

#[test]
fn tree_and_voxel_map_agree_with_another_crate() {
    let cloud = points(50_000, 3);
    let (tree, other) = (KdTree::new(&cloud), OtherTree::new(&cloud));
    let mut map = VoxelMap::new(0.3);
    cloud.iter().for_each(|p| assert!(map.insert(*p).is_some()));
    let mut found = Vec::new();
    let (mut hits, mut misses) = (0, 0);
    for query in points(3000, 4).iter().map(|p| p.map(|v| v + 0.3)) {
        for reach in [0.29, 0.5, 3.0] {
            // Distances: at equal ones the others may take another point.
            let expected: Vec<f32> = other.k_nearest(query, 7, reach).iter().map(|n| n.1).collect();
            tree.k_nearest(query, 7, reach, &mut found);
            let by_tree: Vec<f32> = found.iter().map(|n| n.squared_distance).collect();
            let by_map: Vec<f32> =
                map.k_nearest(query, 7, reach).iter().map(|n| n.squared_distance).collect();
            let is_equal = |a: &[f32], b: &[f32]| {
                a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5 * (1.0 + b))
            };
            assert!(is_equal(&by_tree, &expected), "{query:?}: {by_tree:?} {expected:?}");
            assert!(is_equal(&by_map, &expected), "{query:?}: {by_map:?} {expected:?}");
            match expected.is_empty() {
                true => misses += 1,
                false => hits += 1,
            }
        }
    }
    assert!(hits > 3000 && misses > 300, "{hits} {misses}");
}

#[test]
fn bytes_per_point_are_bounded() {
    let cloud = points(200_000, 5);
    let per_point = |bytes: usize| bytes as f64 / cloud.len() as f64;
    assert!(per_point(KdTree::new(&cloud).memory_bytes()) < 18.0);
    let mut map = VoxelMap::new(0.3);
    cloud.iter().for_each(|p| assert!(map.insert(*p).is_some()));
    assert!(per_point(map.memory_bytes()) < 40.0, "{}", per_point(map.memory_bytes()));
}
