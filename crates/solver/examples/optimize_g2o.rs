//! Optimises g2o files: `cargo run --release -p portolan-solver --example optimize_g2o -- a.g2o b.g2o`.
//! `--city=10000` optimises a made-up city of so many poses in 3D instead of a file.
//! Options, before the files: `--init=automatic|file|odometry|tree|rotations`, `--radius=1e8`, `--condition`,
//! `--out=result.g2o`.

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::time::Instant;

use portolan_solver::g2o::{Graph, Initialization, OptimizeOptions, optimize_graph, read_g2o, write_g2o};

#[path = "../benches/support/city.rs"]
mod city;

fn main() -> Result<(), Box<dyn Error>> {
    let mut options = OptimizeOptions::default();
    let mut out = None;
    let mut files = Vec::new();
    for argument in std::env::args().skip(1) {
        match argument.split_once('=') {
            Some(("--init", how)) => options.initialization = initialization(how)?,
            Some(("--radius", radius)) => options.solver.initial_trust_region_radius = radius.parse()?,
            Some(("--city", poses)) => {
                let graph = Graph::ThreeD(city::city_3d(poses.parse()?, 1.0));
                optimize("city", graph, &options, None)?;
            }
            Some(("--out", path)) => out = Some(path.to_owned()),
            _ if argument == "--condition" => options.estimate_condition = true,
            _ => files.push(argument),
        }
    }
    for file in files {
        let start = Instant::now();
        let (graph, repairs) = read_g2o(BufReader::new(File::open(&file)?))?;
        println!("{file}: read in {:.3} s", start.elapsed().as_secs_f64());
        if !repairs.is_empty() {
            println!("  repaired while reading: {repairs:?}");
        }
        optimize(&file, graph, &options, out.as_deref())?;
    }
    Ok(())
}

fn initialization(how: &str) -> Result<Initialization, String> {
    Ok(match how {
        "automatic" => Initialization::Automatic,
        "file" => Initialization::FromFile,
        "odometry" => Initialization::Odometry,
        "tree" => Initialization::SpanningTree,
        "rotations" => Initialization::RotationsFirst,
        _ => {
            return Err(format!(
                "unknown initialisation {how:?}: automatic, file, odometry, tree or rotations"
            ));
        }
    })
}

fn optimize(
    name: &str,
    mut graph: Graph,
    options: &OptimizeOptions,
    out: Option<&str>,
) -> Result<(), Box<dyn Error>> {
    let start = Instant::now();
    let report = optimize_graph(&mut graph, options)?;
    let optimized = start.elapsed();
    println!("{name}: {} vertices, {} edges", graph.vertex_count(), graph.edge_count());
    println!(
        "  chi2 {:.6e} -> {:.6e} -> {:.9}",
        report.chi2_before, report.chi2_initialized, report.chi2_after
    );
    println!(
        "  {} iterations from {:?}, {:?}, {:.3} s",
        report.iterations,
        report.initialization,
        report.termination,
        optimized.as_secs_f64()
    );
    println!("  trials {:?}", report.trials);
    println!(
        "  {} residuals, {} unknowns, {} parts, held {:?}, condition {:?}",
        report.residuals, report.unknowns, report.components, report.anchored, report.condition
    );
    for edge in report.worst_edges.iter().take(3) {
        println!("  worst edge {} -> {}: chi2 {:.3}", edge.from, edge.to, edge.chi2);
    }
    if let Some(path) = out {
        write_g2o(&graph, BufWriter::new(File::create(path)?))?;
    }
    Ok(())
}
