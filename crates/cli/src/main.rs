//! The program `portolan`; `commands` has one file per verb.

mod clouds;
mod commands;
mod error;
mod exit;
mod input;
mod interrupt;
mod known_map;
mod output;
mod progress;
mod replaced_inputs;
mod suggest;

use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser};

use error::CliError;
use exit::ExitStatus;

/// Text of the help page below the list of verbs.
fn after_help() -> String {
    let examples = "Try:\n  portolan demo                     simulate a building, map it, evaluate the map\n  \
        portolan info RECORDING           show the contents of a recording or a map\n  \
        portolan map RECORDING -o DIR     make a map of a recording";
    format!("{examples}\n\n{}", ExitStatus::TABLE)
}

/// Makes a map and a trajectory from a recording of a moving lidar.
///
/// Portolan maps recordings (ROS 1 bags, ROS 2 MCAP and db3, packets of Velodyne and Ouster lidars, KITTI
/// folders, CARMEN logs) without ROS and without configuration, reads and writes Cartographer's .pbstream maps,
/// and measures its own results.
#[derive(Parser)]
#[command(name = "portolan", version, propagate_version = true, max_term_width = 100)]
#[command(after_help = after_help())]
struct Cli {
    #[command(flatten)]
    global: GlobalArgs,
    #[command(subcommand)]
    command: commands::Command,
}

/// Options of every verb.
#[derive(clap::Args, Clone, Debug)]
struct GlobalArgs {
    /// Print only errors on stderr.
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Print more messages on stderr; twice for all details.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Number of threads; 0 uses all cores. Results do not depend on it.
    #[arg(long, global = true, default_value_t = 0, value_name = "N", value_parser = commands::argument::threads)]
    threads: usize,
}

impl GlobalArgs {
    /// Number of threads: that of `--threads`, else the number of cores.
    fn thread_count(&self) -> usize {
        match self.threads {
            0 => std::thread::available_parallelism().map_or(2, std::num::NonZero::get),
            n => n,
        }
    }
}

fn main() -> ExitCode {
    let arguments = commands::compat::arguments(std::env::args_os());
    let status = match command_line().try_get_matches_from(arguments) {
        Ok(found) => match Cli::from_arg_matches(&found) {
            Ok(cli) => run(cli, &found),
            Err(message) => show(&message),
        },
        Err(message) => show(&suggest::with_nearest_verb(message)),
    };
    // Threads that read ahead may still have temporary files.
    portolan_unfinished::remove_all();
    status.into()
}

fn run(cli: Cli, found: &clap::ArgMatches) -> ExitStatus {
    start_logging(&cli.global);
    keep_caught_panics_quiet();
    interrupt::watch(cli.global.quiet);
    // The global pool is that of local SLAM; other work has pools of its own. An error means that it exists already.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(cli.global.thread_count()).build_global();
    let done = replaced_inputs::refuse(&command_line(), found)
        .and_then(|()| commands::run(cli.command, &cli.global));
    match done {
        // Even if results were saved, they are not complete.
        Ok(_) if interrupt::interrupted() => ExitStatus::Interrupted,
        Ok(outcome) => outcome.into(),
        Err(error) => {
            let status = error.exit_status();
            if status != ExitStatus::ClosedPipe {
                report(&error);
            }
            status
        }
    }
}

/// Suppresses the message of panics in libraries that are caught: they are reported as damage of a file, not as faults
/// of the program.
fn keep_caught_panics_quiet() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !portolan_pointcloud::is_panic_caught() {
            usual(panic);
        }
    }));
}

/// Prints a help page, the version, or an error of the command line.
fn show(message: &clap::Error) -> ExitStatus {
    let shown = message.print();
    match shown {
        _ if message.use_stderr() => ExitStatus::Usage,
        Ok(()) => ExitStatus::Done,
        Err(error) => CliError::Output(error).exit_status(),
    }
}

/// Prints an error with its causes; the only place where errors are shown to the user. A cause whose text the message
/// contains already is not repeated.
fn report(error: &CliError) {
    let mut message = error.to_string();
    let mut text = format!("error: {message}");
    let mut source = std::error::Error::source(error);
    while let Some(cause) = source {
        let cause_text = cause.to_string();
        if !message.contains(&cause_text) {
            text.push_str(&format!("\n  because: {cause_text}"));
            message.push_str(&cause_text);
        }
        source = cause.source();
    }
    progress::print_line(&text);
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
        // A closed or full stderr must not end the program.
        .log_internal_errors(false)
        .init();
}

/// Definition of the command line; man page and completions are generated from it, too.
fn command_line() -> clap::Command {
    with_negative_numbers(Cli::command())
}

/// Lets every option with a value accept negative numbers. An option that does not allow them reports this itself, with
/// the values that it expects.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let takes = |argument: clap::Arg| {
        let is_option = !argument.is_positional() && argument.get_action().takes_values();
        if is_option { argument.allow_negative_numbers(true) } else { argument }
    };
    command.mut_args(takes).mut_subcommands(with_negative_numbers)
}
