//! One file per verb.

mod check;
mod completions;
mod config;
mod demo;
mod evaluate;
mod info;
mod man;
mod map;
mod simulate;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};

/// What to do.
#[derive(clap::Subcommand)]
pub enum Command {
    Demo(demo::DemoArgs),
    Map(Box<map::MapArgs>),
    Info(info::InfoArgs),
    Check(check::CheckArgs),
    Config(config::ConfigArgs),
    Evaluate(evaluate::EvaluateArgs),
    Simulate(simulate::SimulateArgs),
    Completions(completions::CompletionsArgs),
    Man(man::ManArgs),
}

/// Runs a verb.
pub fn run(command: Command, global: &GlobalArgs) -> Result<Outcome, CliError> {
    match command {
        Command::Demo(args) => demo::run(args, global),
        Command::Map(args) => map::run(*args, global),
        Command::Info(args) => info::run(&args, global),
        Command::Check(args) => check::run(&args, global),
        Command::Config(args) => config::run(&args, global),
        Command::Evaluate(args) => evaluate::run(&args, global),
        Command::Simulate(args) => simulate::run(&args, global),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
    }
}
