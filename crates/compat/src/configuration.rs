//! `cartographer_print_configuration`: prints a configuration with all its includes.

use std::path::{Path, PathBuf};

use portolan_config::lua::{self, Limits, evaluate_file};

use crate::flags::{Flags, KnownFlags};
use crate::{CompatError, Completeness, Console};

/// Prints a configuration with all its includes.
///
/// # Errors
/// If flags are wrong, or the configuration cannot be read or run.
pub fn print_configuration(
    arguments: &[String],
    console: &mut dyn Console,
) -> Result<Completeness, CompatError> {
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
    let failed = |error: portolan_config::ConfigError| CompatError::Failed(error.to_string());
    let evaluation = evaluate_file(Path::new(name), &directories, Limits::default()).map_err(failed)?;
    console.print(
        &lua::print_configuration(&evaluation.table, Some(flags.value("subdictionary"))).map_err(failed)?,
    )?;
    Ok(Completeness::Complete)
}
