//! `portolan config check`: finds errors in a configuration file.

use std::path::PathBuf;

use portolan_config::{ConfigError, LoadedConfig, Loader};
use portolan_geometry::Dimension;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, print};
use crate::progress::print_line;

/// Report all faults of a configuration file: unknown keys with the nearest known one, wrong types, values
/// out of bounds, options that contradict each other.
///
/// Exit code 1 if there are errors; warnings alone give 0.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  portolan config check my_robot.lua --config-dir configuration_files")]
pub struct CheckArgs {
    /// Configuration of a robot or of a map builder server.
    #[arg(value_name = "FILE.lua")]
    file: PathBuf,
    /// Folder to search for included Lua files; may be given several times.
    #[arg(long, value_name = "DIR")]
    config_dir: Vec<PathBuf>,
}

pub fn run(args: &CheckArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let loader = Loader { directories: args.config_dir.clone(), ..Loader::default() };
    match loader.load(&args.file) {
        Ok(loaded) => {
            let dimension = match loaded.options.map_builder.dimension() {
                Ok(Dimension::TwoD) => "mapping in 2D",
                Ok(Dimension::ThreeD) => "mapping in 3D",
                Err(_) => "mapping",
            };
            good(args, global, &loaded, dimension)
        }
        Err(error @ ConfigError::MissingTable { .. }) => match loader.load_server(&args.file) {
            Ok(loaded) => good(args, global, &loaded, "a map builder server"),
            Err(_) => bad(args, &[error]),
        },
        Err(ConfigError::Several { errors }) => bad(args, &errors),
        Err(error) => bad(args, &[error]),
    }
}

fn good<T>(
    args: &CheckArgs,
    global: &GlobalArgs,
    loaded: &LoadedConfig<T>,
    purpose: &str,
) -> Result<Outcome, CliError> {
    if !global.quiet {
        loaded.printed.iter().for_each(|line| print_line(line));
    }
    let warnings = counted(loaded.warnings.len() as u64, "warning", "warnings");
    let mut text: String = loaded.warnings.iter().map(|warning| format!("warning: {warning}\n")).collect();
    text.push_str(&format!("{}: configuration for {purpose}, no errors, {warnings}\n", args.file.display()));
    print(&text)?;
    Ok(Outcome::Done)
}

fn bad(args: &CheckArgs, errors: &[ConfigError]) -> Result<Outcome, CliError> {
    let text: String = errors.iter().map(|error| format!("error: {error}\n")).collect();
    print(&text)?;
    let errors = counted(errors.len() as u64, "error", "errors");
    Err(CliError::in_file(&args.file, format!("{errors} in the configuration")))
}
