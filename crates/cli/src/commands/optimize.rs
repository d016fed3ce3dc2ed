//! `portolan optimize`: optimises pose graphs and maps.

mod graph;
mod map;

pub use map::{loop_text, optimize_draft, options, summary};

use std::path::PathBuf;

use portolan_solver::Loss;
use portolan_solver::g2o::{Initialization, OptimizeOptions};

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::input::{is_map, may_be_graph, open_forward};

/// Optimise a pose graph (g2o file) or a map (.pbstream).
///
/// g2o files may have poses in 2D (VERTEX_SE2) and in 3D (VERTEX_SE3:QUAT), with full information matrices.
/// The best of several initialisations is used unless --init names one. Maps are optimised from their own
/// poses, with their constraints, measurements and options, which --set changes.
///
/// Exit code 3 if parts of the graph could not be used.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan optimize m3500.g2o -o m3500_best.g2o\n  \
    portolan optimize noisy.g2o -o best.g2o --loss huber:1 --worst 20 --json\n  \
    portolan optimize house.pbstream -o house_best.pbstream")]
pub struct OptimizeArgs {
    /// The graph or map.
    #[arg(value_name = "GRAPH_OR_MAP")]
    input: PathBuf,
    /// File to write, of the same format.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Initial poses of a g2o file.
    #[arg(long, value_enum, default_value = "auto")]
    init: Init,
    /// Robust loss of the edges of a g2o file: none, huber, cauchy, tukey, geman-mcclure or truncated, with a
    /// scale in units of √(eᵀΩe) after a colon.
    #[arg(long, value_name = "LOSS", value_parser = loss, default_value = "none")]
    loss: Loss,
    /// Maximum number of iterations. Default: 100; for maps that of their options.
    #[arg(long, value_name = "N")]
    iterations: Option<u32>,
    /// Number of edges, of maps loop closures, with the largest errors to list.
    #[arg(long, value_name = "N", default_value_t = 10)]
    worst: usize,
    /// Estimate the condition number of the normal equations of a g2o file.
    #[arg(long)]
    condition: bool,
    /// Change an option of the optimisation of maps: `--set pose_graph.optimization_problem.huber_scale=5`.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Init {
    /// Best of the others after a few iterations.
    Auto,
    /// Poses of the file.
    File,
    /// Measurements chained along consecutive ids.
    Odometry,
    /// Measurements chained along the shortest chains of edges.
    SpanningTree,
    /// Chordal relaxation: rotations from linear equations, then positions.
    Rotations,
}

impl From<Init> for Initialization {
    fn from(init: Init) -> Self {
        match init {
            Init::Auto => Self::Automatic,
            Init::File => Self::FromFile,
            Init::Odometry => Self::Odometry,
            Init::SpanningTree => Self::SpanningTree,
            Init::Rotations => Self::RotationsFirst,
        }
    }
}

fn loss(text: &str) -> Result<Loss, String> {
    let (name, scale) = text.split_once(':').unwrap_or((text, "1"));
    let scale: f64 = scale.parse().map_err(|_| format!("\"{scale}\" is not a scale"))?;
    let loss = match name {
        "none" => Loss::None,
        "huber" => Loss::Huber(scale),
        "cauchy" => Loss::Cauchy(scale),
        "tukey" => Loss::Tukey(scale),
        "geman-mcclure" => Loss::GemanMcClure(scale),
        "truncated" => Loss::Truncated(scale),
        _ => return Err("expected none, huber, cauchy, tukey, geman-mcclure or truncated".to_owned()),
    };
    if loss.is_valid() { Ok(loss) } else { Err("the scale must be above 0".to_owned()) }
}

impl OptimizeArgs {
    fn graph_options(&self) -> OptimizeOptions {
        let mut options = OptimizeOptions {
            initialization: self.init.into(),
            loss: self.loss,
            worst_edges: self.worst,
            estimate_condition: self.condition,
            ..OptimizeOptions::default()
        };
        if let Some(iterations) = self.iterations {
            options.solver.max_num_iterations = iterations;
        }
        options
    }
}

pub fn run(args: &OptimizeArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let mut input = open_forward(&args.input)?;
    if is_map(&mut input, &args.input)? {
        return map::run(args, global);
    }
    may_be_graph(&mut input, &args.input)?;
    graph::run(args, input, global)
}
