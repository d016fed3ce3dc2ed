//! `portolan config`: shows, explains and checks options and configuration files.

mod check;
mod explain;
mod show;

use std::path::PathBuf;

use portolan_config::reference;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{print, write_file};
use crate::progress::print_line;

/// Show, explain and check options; Cartographer's Lua files load unchanged.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    portolan config explain constraint_builder.min_score\n  \
    portolan config show --config backpack_2d.lua --changed\n  \
    portolan config check my_robot.lua\n  \
    portolan config reference -o options.md")]
pub struct ConfigArgs {
    #[command(subcommand)]
    task: Task,
}

#[derive(clap::Subcommand)]
enum Task {
    Show(show::ShowArgs),
    Explain(explain::ExplainArgs),
    Reference(ReferenceArgs),
    Check(check::CheckArgs),
}

/// Print the reference page of all options (Markdown): defaults, units, bounds and descriptions.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  portolan config reference -o options.md")]
struct ReferenceArgs {
    /// Write the page to a file instead.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

pub fn run(args: &ConfigArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    match &args.task {
        Task::Show(args) => show::run(args, global),
        Task::Explain(args) => explain::run(args),
        Task::Reference(args) => write_reference(args, global),
        Task::Check(args) => check::run(args, global),
    }
}

fn write_reference(args: &ReferenceArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    match &args.output {
        Some(path) => {
            write_file(path, |out| out.write_all(reference().as_bytes()))?;
            if !global.quiet {
                print_line(&format!("Wrote {}", path.display()));
            }
        }
        None => print(&reference())?,
    }
    Ok(Outcome::Done)
}
