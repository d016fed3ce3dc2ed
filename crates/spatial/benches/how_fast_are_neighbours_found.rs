//! How fast are neighbours found, and how many bytes does a point take? The kd-tree and the voxel map, and another
//! crate's tree up to ten million points.
//!
//! `cargo bench -p portolan-spatial -- [millions of points]…`; without numbers one million.

#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]

#[path = "../tests/other_tree/mod.rs"]
mod other_tree;

use std::time::Instant;

use other_tree::OtherTree;
use portolan_numeric::Lcg64;
use portolan_spatial::{KdTree, VoxelMap};

/// Points that look for a neighbour within a metre.
const QUERIES: usize = 300_000;
const REACH: f32 = 1.0;
/// The other tree keeps much more.
const OTHER_MOST: usize = 10_000_000;

/// A deterministic generator.
struct Random(Lcg64);

impl Random {
    fn uniform(&mut self) -> f32 {
        (self.0.bits() >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// Half on the ground, half on walls, 200 m wide, with a few centimetres of noise.
fn points(count: usize) -> Vec<[f32; 3]> {
    let mut random = Random(Lcg64::new(7));
    (0..count)
        .map(|i| {
            let (a, b, noise) = (random.uniform(), random.uniform(), 0.05 * random.uniform());
            let wall = (random.uniform() * 20.0).floor() * 10.0;
            match i % 4 {
                0 | 1 => [200.0 * a, 200.0 * b, noise],
                2 => [wall + noise, 200.0 * a, 5.0 * b],
                _ => [200.0 * a, wall + noise, 5.0 * b],
            }
        })
        .collect()
}

fn timed<T>(run: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = run();
    (result, start.elapsed().as_secs_f64())
}

fn report(name: &str, build: f64, search: f64, bytes: Option<f64>, sum: f64) {
    let bytes = bytes.map_or_else(|| "?".to_owned(), |b| format!("{b:.1}"));
    let each = 1e6 * search / QUERIES as f64;
    println!("  {name}: built in {build:.2} s, {each:.2} µs a search, {bytes} bytes a point (sum {sum:.3})");
}

fn main() {
    let asked: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    for millions in if asked.is_empty() { vec![1] } else { asked } {
        let count = millions * 1_000_000;
        println!("{millions} million points, one thread");
        let points = points(count);
        let mut random = Random(Lcg64::new(99));
        let queries: Vec<[f32; 3]> = (0..QUERIES)
            .map(|_| {
                let p = points[(random.uniform() * (count - 1) as f32) as usize];
                p.map(|v| v + 0.2 * (random.uniform() - 0.5))
            })
            .collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let (tree, build) = timed(|| pool.install(|| KdTree::new(&points)));
        let nearest =
            |q: &[f32; 3]| tree.nearest(*q, REACH).map_or(0.0, |n| f64::from(n.squared_distance.sqrt()));
        let (sum, search) = timed(|| queries.iter().map(nearest).sum());
        report("kd-tree", build, search, Some(tree.memory_bytes() as f64 / count as f64), sum);
        drop(tree);
        let (map, build) = timed(|| {
            // About ten points in each voxel that has any.
            let mut map = VoxelMap::new((10.0 * 60_000.0 / count as f32).sqrt().clamp(0.05, 1.0));
            let added = points.iter().filter(|p| map.insert(**p).is_some()).count();
            assert_eq!(added, count);
            map
        });
        let nearest = |q: &[f32; 3]| {
            map.k_nearest(*q, 1, REACH).first().map_or(0.0, |n| f64::from(n.squared_distance.sqrt()))
        };
        let (sum, search) = timed(|| queries.iter().map(nearest).sum());
        report("voxel map", build, search, Some(map.memory_bytes() as f64 / count as f64), sum);
        drop(map);
        if count <= OTHER_MOST {
            let (tree, build) = timed(|| OtherTree::new(&points));
            let nearest = |q: &[f32; 3]| tree.nearest(*q, REACH).map_or(0.0, |n| f64::from(n.1.sqrt()));
            let (sum, search) = timed(|| queries.iter().map(nearest).sum());
            report("nabo", build, search, None, sum);
        }
    }
}
