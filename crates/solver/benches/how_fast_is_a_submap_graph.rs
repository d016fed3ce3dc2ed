//! How fast is the pose graph of a mapping session built and optimised? Nodes in two submaps each,
//! consecutive nodes, loop closures with a robust loss; see also the example `optimize_submaps`.

#![allow(missing_docs, clippy::unwrap_used)]

use portolan_solver::{Problem, SolverOptions};
use portolan_testing::Stopwatch;

#[path = "support/submaps.rs"]
mod submaps;

fn submap_graphs(watch: &Stopwatch) {
    let graph = submaps::submap_graph(3000);
    let options = SolverOptions { initial_trust_region_radius: 1e8, ..Default::default() };
    watch.time("build_2d", || graph.problem_2d());
    watch.time("build_3d", || graph.problem_3d());
    let solve = |name: &str, build: &dyn Fn() -> Problem| {
        watch.time_on(name, build, |p| p.solve(&options).unwrap());
    };
    solve("solve_2d", &|| graph.problem_2d());
    solve("solve_3d", &|| graph.problem_3d());
}

fn main() {
    let watch = Stopwatch::of_arguments();
    submap_graphs(&watch);
}
