//! How fast is a pose graph optimised? A made-up city with one loop closure per pose and full information
//! matrices, from dead reckoning.

#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use portolan_solver::g2o::{GraphPose, Initialization, OptimizeOptions, PoseGraph, optimize_pose_graph};

#[path = "support/city.rs"]
mod city;

fn measure<P: GraphPose>(
    criterion: &mut Criterion,
    name: &str,
    graph: &PoseGraph<P>,
    initialization: Initialization,
) {
    let options = OptimizeOptions { initialization, ..Default::default() };
    let mut group = criterion.benchmark_group("pose_graph");
    group.sample_size(10);
    group.bench_function(name, |bencher| {
        bencher.iter_batched_ref(
            || graph.clone(),
            |graph| optimize_pose_graph(graph, &options).unwrap(),
            BatchSize::LargeInput,
        );
    });
    group.finish();
}

fn pose_graphs(criterion: &mut Criterion) {
    use Initialization::{Automatic, FromFile, RotationsFirst};
    let planar = city::city_2d(3500, 0.5);
    measure(criterion, "2d_3500_from_dead_reckoning", &planar, FromFile);
    measure(criterion, "2d_3500_automatic", &planar, Automatic);
    let spatial = city::city_3d(2500, 1.0);
    measure(criterion, "3d_2500_from_dead_reckoning", &spatial, FromFile);
    measure(criterion, "3d_2500_rotations_first", &spatial, RotationsFirst);
    measure(criterion, "3d_2500_automatic", &spatial, Automatic);
    measure(criterion, "3d_10000_from_dead_reckoning", &city::city_3d(10_000, 1.0), FromFile);
}

criterion_group!(benches, pose_graphs);
criterion_main!(benches);
