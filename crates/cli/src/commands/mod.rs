//! One file per verb.

pub mod argument;
mod check;
pub mod compat;
mod completions;
mod config;
mod convert;
mod demo;
mod edit;
mod evaluate;
mod handling;
mod info;
mod localize;
mod man;
mod map;
mod migrate;
mod optimize;
mod refine;
mod register;
mod render;
mod repair;
mod simulate;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};

/// Verb to run.
#[derive(clap::Subcommand)]
pub enum Command {
    Demo(demo::DemoArgs),
    Map(Box<map::MapArgs>),
    Localize(Box<localize::LocalizeArgs>),
    Info(info::InfoArgs),
    Check(Box<check::CheckArgs>),
    Config(config::ConfigArgs),
    Evaluate(Box<evaluate::EvaluateArgs>),
    Render(Box<render::RenderArgs>),
    Edit(Box<edit::EditArgs>),
    Convert(Box<convert::ConvertArgs>),
    Optimize(Box<optimize::OptimizeArgs>),
    Refine(Box<refine::RefineArgs>),
    Register(Box<register::RegisterArgs>),
    Repair(repair::RepairArgs),
    Migrate(migrate::MigrateArgs),
    Simulate(Box<simulate::SimulateArgs>),
    Compat(compat::CompatArgs),
    Completions(completions::CompletionsArgs),
    Man(man::ManArgs),
}

/// Runs the command.
pub fn run(command: Command, global: &GlobalArgs) -> Result<Outcome, CliError> {
    match command {
        Command::Demo(args) => demo::run(args, global),
        Command::Map(args) => map::run(*args, global),
        Command::Localize(args) => localize::run(&args, global),
        Command::Info(args) => info::run(&args, global),
        Command::Check(args) => check::run(&args, global),
        Command::Config(args) => config::run(&args, global),
        Command::Evaluate(args) => evaluate::run(&args, global),
        Command::Render(args) => render::run(&args, global),
        Command::Edit(args) => edit::run(&args, global),
        Command::Convert(args) => convert::run(&args, global),
        Command::Optimize(args) => optimize::run(&args, global),
        Command::Refine(args) => refine::run(&args, global),
        Command::Register(args) => register::run(&args, global),
        Command::Repair(args) => repair::run(&args),
        Command::Migrate(args) => migrate::run(&args),
        Command::Simulate(args) => simulate::run(&args, global),
        Command::Compat(args) => compat::run(&args, global),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
    }
}
