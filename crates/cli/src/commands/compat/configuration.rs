//! `cartographer_print_configuration`.

use std::path::{Path, PathBuf};

use portolan_config::flags::{Flags, KnownFlags};
use portolan_config::lua::{Limits, evaluate_file, print_configuration};

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::print;

pub fn run(arguments: &[String], _: &GlobalArgs) -> Result<Outcome, CliError> {
    let flags = Flags::parse(
        arguments,
        &KnownFlags {
            values: &[
                ("configuration_directories", ""),
                ("configuration_basename", ""),
                ("subdictionary", ""),
            ],
            switches: &[],
            usage: "usage: cartographer_print_configuration -configuration_directories DIR[,DIR...] \
                    -configuration_basename FILE [-subdictionary a.b.c]",
        },
    )?;
    flags.required("configuration_directories")?;
    let directories: Vec<PathBuf> =
        flags.list("configuration_directories").into_iter().map(PathBuf::from).collect();
    let name = flags.required("configuration_basename")?;
    let failed = |error: portolan_config::ConfigError| CliError::Failed(error.to_string());
    let evaluation = evaluate_file(Path::new(name), &directories, Limits::default()).map_err(failed)?;
    print(&print_configuration(&evaluation.table, Some(flags.value("subdictionary"))).map_err(failed)?)?;
    Ok(Outcome::Done)
}
