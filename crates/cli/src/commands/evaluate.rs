//! `portolan evaluate`: measures the accuracy of trajectories, maps and clouds.

mod cloud;
pub mod generate;
pub mod input;
mod loops;
mod relations;
mod trajectory;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};

/// Evaluate maps, trajectories and clouds against relations or the truth.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    portolan evaluate relations aces.pbstream aces.relations\n  \
    portolan evaluate trajectory walk_map/trajectory.tum walk.truth.tum --rpe 1\n  \
    portolan evaluate cloud walk.bag walk.tum walk_refined/refined.tum\n  \
    portolan evaluate generate old.pbstream -o old.relations --min-covered-distance 20")]
pub struct EvaluateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    Relations(relations::RelationsArgs),
    Trajectory(trajectory::TrajectoryArgs),
    Cloud(cloud::CloudArgs),
    Generate(generate::GenerateArgs),
    Loops(loops::LoopsArgs),
}

pub fn run(args: &EvaluateArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    match &args.what {
        What::Relations(args) => relations::run(args, global),
        What::Trajectory(args) => trajectory::run(args, global),
        What::Cloud(args) => cloud::run(args, global),
        What::Generate(args) => generate::run(args, global),
        What::Loops(args) => loops::run(args, global),
    }
}
