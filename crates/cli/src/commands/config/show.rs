//! `portolan config show`: prints the values of all options.

use portolan_config::{ConfigError, Engine, LoadedConfig, Loader, Options};

use crate::GlobalArgs;
use crate::commands::map::ConfigArgs as SettingArgs;
use crate::error::{CliError, Outcome};
use crate::output::print;
use crate::progress::print_line;

/// Print all options with their values after loading a file and applying settings.
///
/// Without a file, the defaults are shown. They are those of Cartographer; the settings that `portolan map`
/// chooses for a recording are in the report of the map.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    portolan config show\n  \
    portolan config show --config my_robot.lua --set min_range=0.3 --changed\n  \
    portolan config show --config my_robot.lua --lua > whole.lua")]
pub struct ShowArgs {
    #[command(flatten)]
    settings: SettingArgs,
    /// Show the defaults for 3D instead of 2D; with --config the file decides.
    #[arg(long = "3d", conflicts_with = "config")]
    three_dimensions: bool,
    /// Show only options that differ from their defaults.
    #[arg(long)]
    changed: bool,
    /// Print a complete Lua file without includes that loads to the same options.
    #[arg(long, conflicts_with_all = ["changed", "json"])]
    lua: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &ShowArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let loaded = load(args)?;
    if !global.quiet {
        loaded.printed.iter().for_each(|line| print_line(line));
        loaded.warnings.iter().for_each(|warning| print_line(&format!("warning: {warning}")));
    }
    let options = &loaded.options;
    if args.lua {
        print(&options.to_lua())?;
    } else if args.json && !args.changed {
        print(&options.to_json())?;
    } else {
        let entries = if args.changed { options.changed_entries() } else { options.entries() };
        if args.json {
            let values: serde_json::Map<String, serde_json::Value> = entries
                .iter()
                .map(|entry| Ok((entry.path.clone(), serde_json::to_value(&entry.value)?)))
                .collect::<Result<_, serde_json::Error>>()
                .map_err(|error| CliError::Failed(error.to_string()))?;
            crate::output::print_json(&values)?;
        } else {
            let lines: Vec<String> = entries.iter().map(|entry| format!("{entry}\n")).collect();
            print(&lines.concat())?;
        }
    }
    Ok(Outcome::Done)
}

fn load(args: &ShowArgs) -> Result<LoadedConfig, CliError> {
    let loader = Loader {
        directories: args.settings.config_dir.clone(),
        settings: args.settings.set.clone(),
        ..Loader::default()
    };
    let mut in_3d = Options::for_3d();
    in_3d.set_engine(Engine::Planes);
    let loaded = match &args.settings.config {
        Some(path) => loader.load(path),
        None if args.three_dimensions => loader.load_options(in_3d),
        None => loader.load_options(Options::for_2d()),
    };
    loaded.map_err(|error| match error {
        // Errors of `--set` are wrong usage; without a file, all other errors are, too.
        ConfigError::NoSetting { .. } => CliError::Usage(error.to_string()),
        _ if args.settings.config.is_none() => CliError::Usage(error.to_string()),
        _ => CliError::Failed(error.to_string()),
    })
}
