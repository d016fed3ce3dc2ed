//! How the trust region should start on a pose graph of submaps and nodes:
//! `cargo run --release -p portolan-solver --example optimize_submaps -- 5000`.

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::time::Instant;

use portolan_solver::SolverOptions;

#[path = "../benches/support/submaps.rs"]
mod submaps;

fn main() -> Result<(), Box<dyn Error>> {
    let nodes: usize = std::env::args().nth(1).map_or(Ok(5000), |n| n.parse())?;
    let graph = submaps::submap_graph(nodes);
    for is_3d in [false, true] {
        for radius in [1e4, 1e8, 1e16] {
            let start = Instant::now();
            let mut problem = if is_3d { graph.problem_3d() } else { graph.problem_2d() };
            let built = start.elapsed();
            let options = SolverOptions { initial_trust_region_radius: radius, ..Default::default() };
            let start = Instant::now();
            let summary = problem.solve(&options)?;
            println!(
                "{} nodes, {} factors, {} unknowns, radius {radius:e}: cost {:.6e} -> {:.6e}, {} iterations, {:?}, \
                 built in {:.4} s, solved in {:.4} s",
                nodes,
                problem.factor_count(),
                problem.degrees_of_freedom(),
                summary.initial_cost,
                summary.final_cost,
                summary.iterations,
                summary.termination,
                built.as_secs_f64(),
                start.elapsed().as_secs_f64()
            );
        }
    }
    Ok(())
}
