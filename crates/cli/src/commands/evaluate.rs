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
    task: Task,
}

#[derive(clap::Subcommand)]
enum Task {
    Relations(relations::RelationsArgs),
    Trajectory(trajectory::TrajectoryArgs),
    Cloud(cloud::CloudArgs),
    Generate(generate::GenerateArgs),
    Loops(loops::LoopsArgs),
}

pub fn run(args: &EvaluateArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    match &args.task {
        Task::Relations(args) => relations::run(args, global),
        Task::Trajectory(args) => trajectory::run(args, global),
        Task::Cloud(args) => cloud::run(args, global),
        Task::Generate(args) => generate::run(args, global),
        Task::Loops(args) => loops::run(args, global),
    }
}
