//! How fast is the pose graph of a mapping session built and optimised? Nodes in two submaps each,
//! consecutive nodes, loop closures with a robust loss; see also the example `optimize_submaps`.

#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use portolan_solver::{Problem, SolverOptions};

#[path = "support/submaps.rs"]
mod submaps;

fn submap_graphs(criterion: &mut Criterion) {
    let graph = submaps::submap_graph(3000);
    let options = SolverOptions { initial_trust_region_radius: 1e8, ..Default::default() };
    let mut group = criterion.benchmark_group("submap_graph_3000_nodes");
    group.sample_size(10);
    group.bench_function("build_2d", |bencher| bencher.iter(|| graph.problem_2d()));
    group.bench_function("build_3d", |bencher| bencher.iter(|| graph.problem_3d()));
    let mut solve = |name: &str, build: &dyn Fn() -> Problem| {
        group.bench_function(name, |bencher| {
            bencher.iter_batched_ref(build, |p| p.solve(&options).unwrap(), BatchSize::LargeInput);
        });
    };
    solve("solve_2d", &|| graph.problem_2d());
    solve("solve_3d", &|| graph.problem_3d());
    group.finish();
}

criterion_group!(benches, submap_graphs);
criterion_main!(benches);
