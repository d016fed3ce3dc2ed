//! `cartographer_offline_node`: maps bags with `portolan map`.

use std::path::{Path, PathBuf};

use clap::Parser;
use portolan_compat::{Flags, KnownFlags};
use portolan_pbstream::MapReader;

use super::log;
use crate::error::{CliError, Outcome};
use crate::output::write_file;
use crate::{Cli, GlobalArgs};

const FLAGS: KnownFlags = KnownFlags {
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
    usage: "usage: cartographer_offline_node -configuration_directory DIR -configuration_basenames FILE,… \
            -bag_filenames BAG,… [-load_state_filename MAP] [-save_state_filename MAP]",
};

/// Maps the bags: each becomes a trajectory, after those of the loaded state. The bags are mapped one after another, each
/// into the map of those before; Cartographer merges their messages by time.
pub fn run(arguments: &[String], global: &GlobalArgs) -> Result<Outcome, CliError> {
    let flags = Flags::parse(arguments, &FLAGS)?;
    let directory = flags.required("configuration_directory")?;
    flags.required("configuration_basenames")?;
    let (bags, state) = (flags.list("bag_filenames"), flags.value("load_state_filename"));
    if bags.is_empty() && state.is_empty() {
        return Err(flags
            .wrong("-bag_filenames and -load_state_filename cannot both be unspecified.")
            .into());
    }
    if !state.is_empty() && !state.ends_with(".pbstream") {
        return Err(flags.wrong(&format!("-load_state_filename={state} is no .pbstream")).into());
    }
    let output = output(&flags, &bags, state)?;
    let mut known = (!state.is_empty()).then(|| PathBuf::from(state));
    let frozen = count_frozen(&flags, known.as_deref())?;
    let parent = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // In the folder of the output, so that the map can be renamed without being copied.
    let folder = tempfile::Builder::new().prefix(".portolan-").tempdir_in(parent)?;
    let mut outcome = Outcome::Done;
    for (i, bag) in bags.iter().enumerate() {
        let results = folder.path().join(i.to_string());
        let mut line: Vec<String> =
            ["portolan", "map", bag, "--engine", "grids", "-o"].map(str::to_owned).to_vec();
        line.push(results.display().to_string());
        line.extend(of_bag(&flags, directory, i)?);
        if let Some(map) = &known {
            // As Cartographer, which writes the state whether or not the bag was localised in it.
            line.extend(["--from".to_owned(), map.display().to_string(), "--force".to_owned()]);
            line.extend(frozen_argument(frozen, i == 0));
        }
        let parsed = Cli::try_parse_from(line).map_err(|error| CliError::Usage(error.to_string()))?;
        match crate::commands::run(parsed.command, global)? {
            // No failure, as in Cartographer, which does not report this at all.
            Outcome::Untrusted => {
                log::warning(&format!("{bag} was not found in the state; it is written all the same."))
            }
            done => outcome = outcome.max(done),
        }
        known = Some(results.join("map.pbstream"));
    }
    log::info(&format!("Writing state to '{}'...", output.display()));
    let named = match known {
        Some(map) if bags.is_empty() => return copy(&map, &output).map(|()| outcome),
        Some(map) => std::fs::rename(map, &output),
        None => Ok(()),
    };
    named.map_err(|source| CliError::File { path: output.clone(), source })?;
    Ok(outcome)
}

/// Copies a map, which may be the output itself.
fn copy(map: &Path, output: &Path) -> Result<(), CliError> {
    let read = |source| CliError::File { path: map.to_owned(), source };
    let mut source = std::fs::File::open(map).map_err(read)?;
    write_file(output, |out| std::io::copy(&mut source, out).map(drop))
}

/// Path of the map: that of `-save_state_filename`, else that of the first bag with `.pbstream` appended.
fn output(flags: &Flags, bags: &[String], state: &str) -> Result<PathBuf, CliError> {
    match (flags.value("save_state_filename"), bags.first()) {
        ("", Some(bag)) => Ok(PathBuf::from(format!("{bag}.pbstream"))),
        ("", None) => Err(flags
            .wrong(&format!("without bags nothing changes in {state}: -save_state_filename?"))
            .into()),
        (name, _) => Ok(PathBuf::from(name)),
    }
}

/// Arguments of `portolan map` for the bag with this index. If there are fewer configurations than bags, the remaining
/// bags use the first one; if there are fewer robot descriptions, they have none.
fn of_bag(flags: &Flags, directory: &str, index: usize) -> Result<Vec<String>, CliError> {
    let configurations = flags.list("configuration_basenames");
    let name = configurations.get(index).or(configurations.first()).map_or("", String::as_str);
    let mut arguments = vec!["--config".to_owned(), Path::new(directory).join(name).display().to_string()];
    arguments.extend(["--config-dir".to_owned(), directory.to_owned()]);
    if let Some(urdf) = flags.list("urdf_filenames").get(index) {
        arguments.extend(["--urdf".to_owned(), urdf.clone()]);
    }
    if flags.number("skip_seconds")? > 0.0 {
        arguments.extend(["--skip".to_owned(), flags.value("skip_seconds").to_owned()]);
    }
    Ok(arguments)
}

/// Argument that freezes the trajectories of the state. They have the lowest ids of the map.
fn frozen_argument(count: usize, is_the_state_itself: bool) -> Option<String> {
    let numbers: Vec<String> = (0..count).map(|id| id.to_string()).collect();
    match (count, is_the_state_itself) {
        (0, _) => None,
        (_, true) => Some("--frozen".to_owned()),
        (_, false) => Some(format!("--frozen={}", numbers.join(","))),
    }
}

/// Number of trajectories of the state that are frozen.
fn count_frozen(flags: &Flags, state: Option<&Path>) -> Result<usize, CliError> {
    let Some(path) = state.filter(|_| flags.is_on("load_frozen_state")) else { return Ok(0) };
    let reader = MapReader::open(path).map_err(|e| CliError::in_file(path, e))?;
    Ok(reader.pose_graph().trajectory.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_copied_over_itself_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let [state, other] = ["state", "other"].map(|name| folder.path().join(name));
        std::fs::write(&state, "a map").unwrap();
        copy(&state, &state).unwrap();
        copy(&state, &other).unwrap();
        assert_eq!(std::fs::read_to_string(&state).unwrap(), "a map");
        assert_eq!(std::fs::read_to_string(&other).unwrap(), "a map");
        let error = copy(&folder.path().join("none"), &other).unwrap_err().to_string();
        assert!(error.contains("none"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
