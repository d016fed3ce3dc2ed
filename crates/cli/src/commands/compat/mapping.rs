//! `cartographer_offline_node`: the map of a bag, by `portolan map`.

use std::path::{Path, PathBuf};

use clap::Parser;

use super::Flags;
use super::flags::Known;
use super::log;
use crate::error::{CliError, Outcome};
use crate::{Cli, GlobalArgs};

pub fn run(arguments: &[String], global: &GlobalArgs) -> Result<Outcome, CliError> {
    let flags = Flags::parse(
        arguments,
        &Known {
            values: &[
                ("configuration_directory", ""),
                ("configuration_basenames", ""),
                ("bag_filenames", ""),
                ("urdf_filenames", ""),
                ("load_state_filename", ""),
                ("save_state_filename", ""),
                ("skip_seconds", "0"),
            ],
            switches: &[
                ("collect_metrics", false),
                ("use_bag_transforms", true),
                ("load_frozen_state", true),
                ("keep_running", false),
            ],
            usage: "usage: cartographer_offline_node -configuration_directory DIR -configuration_basenames FILE \
                    -bag_filenames BAG [-save_state_filename MAP]",
        },
    )?;
    let directory = flags.required("configuration_directory")?;
    flags.required("configuration_basenames")?;
    let (names, bags) = (flags.list("configuration_basenames"), flags.list("bag_filenames"));
    let ([name], [bag]) = (names.as_slice(), bags.as_slice()) else {
        return Err(flags.wrong("one bag and one configuration are mapped at a time"));
    };
    if !flags.value("load_state_filename").is_empty() {
        return Err(flags.wrong("-load_state_filename: use `portolan map --from MAP`"));
    }
    let output = match flags.value("save_state_filename") {
        "" => PathBuf::from(format!("{bag}.pbstream")),
        name => PathBuf::from(name),
    };
    let parent = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // Beside the output, so that the map can be given its name without being copied.
    let folder = tempfile::Builder::new().prefix(".portolan-").tempdir_in(parent)?;
    let mut line: Vec<String> = ["portolan", "map", bag, "-o"].map(str::to_owned).to_vec();
    line.push(folder.path().display().to_string());
    line.extend(["--config".to_owned(), Path::new(directory).join(name).display().to_string()]);
    line.extend(["--config-dir".to_owned(), directory.to_owned()]);
    if let Some(urdf) = flags.list("urdf_filenames").first() {
        line.extend(["--urdf".to_owned(), urdf.clone()]);
    }
    if flags.number("skip_seconds")? > 0.0 {
        line.extend(["--skip".to_owned(), flags.value("skip_seconds").to_owned()]);
    }
    let parsed = Cli::try_parse_from(line).map_err(|error| CliError::Usage(error.to_string()))?;
    let outcome = crate::commands::run(parsed.command, global)?;
    log::info(&format!("Writing state to '{}'...", output.display()));
    std::fs::rename(folder.path().join("map.pbstream"), &output)
        .map_err(|source| CliError::File { path: output.clone(), source })?;
    Ok(outcome)
}
