//! The program `portolan`: one file per verb in `commands`.

mod clouds;
mod commands;
mod error;
mod input;
mod interrupt;
mod known_map;
mod lost;
mod output;
mod progress;

use std::process::ExitCode;

use clap::{CommandFactory, Parser};

use error::{CliError, Outcome};

/// Turns what a moving lidar saw into a map and a trajectory.
///
/// Portolan maps recordings (ROS 1 bags, ROS 2 MCAP and db3, packets of Velodyne and Ouster lidars, KITTI
/// folders, CARMEN logs) without ROS and without configuration, reads and writes Cartographer's .pbstream maps,
/// and measures its own results.
#[derive(Parser)]
#[command(name = "portolan", version, propagate_version = true, max_term_width = 100)]
#[command(
    after_help = "Try:\n  portolan demo                     a simulated building, mapped and measured\n  \
    portolan info RECORDING           what a recording or a map holds\n  \
    portolan map RECORDING -o DIR     the map of a recording\n\n\
    Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done with data loss, 130 interrupted."
)]
struct Cli {
    #[command(flatten)]
    global: GlobalArgs,
    #[command(subcommand)]
    command: commands::Command,
}

/// Options of every verb.
#[derive(clap::Args, Clone, Debug)]
struct GlobalArgs {
    /// Say nothing on stderr but errors.
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Say more on stderr; twice for every detail.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Threads to use; 0 takes as many as there are cores. Results do not depend on it.
    #[arg(long, global = true, default_value_t = 0, value_name = "N", value_parser = commands::argument::threads)]
    threads: usize,
}

impl GlobalArgs {
    /// As many threads as asked for, or else as there are cores.
    fn thread_count(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(2, std::num::NonZero::get),
            n => n,
        }
    }
}

fn main() -> ExitCode {
    let cli = Cli::parse_from(commands::compat::arguments(std::env::args_os()));
    start_logging(&cli.global);
    match commands::run(cli.command, &cli.global) {
        // Whatever was saved, it is not all that was asked for.
        Ok(_) if interrupt::interrupted() => ExitCode::from(interrupt::EXIT_CODE),
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::DataLost) => ExitCode::from(3),
        Err(error) if error.is_closed_pipe() => ExitCode::SUCCESS,
        Err(error) => {
            report(&error);
            ExitCode::from(match error {
                CliError::Usage(_) => 2,
                _ if interrupt::interrupted() => interrupt::EXIT_CODE,
                _ => 1,
            })
        }
    }
}

#[allow(clippy::print_stderr)] // the one place where errors reach the user
fn report(error: &CliError) {
    eprintln!("error: {error}");
    let mut source = std::error::Error::source(error);
    while let Some(cause) = source {
        eprintln!("  because: {cause}");
        source = cause.source();
    }
}

fn start_logging(global: &GlobalArgs) {
    use tracing_subscriber::filter::{EnvFilter, LevelFilter};
    let level = match (global.quiet, global.verbose) {
        (true, _) => LevelFilter::ERROR,
        (false, 0) => LevelFilter::WARN,
        (false, 1) => LevelFilter::INFO,
        (false, _) => LevelFilter::DEBUG,
    };
    let filter = EnvFilter::builder().with_default_directive(level.into()).from_env_lossy();
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(
            std::env::var_os("NO_COLOR").is_none() && std::io::IsTerminal::is_terminal(&std::io::stderr()),
        )
        .without_time()
        .with_target(false)
        .init();
}

/// The command line as data, from which man page and completions are made.
fn command_line() -> clap::Command {
    Cli::command()
}
