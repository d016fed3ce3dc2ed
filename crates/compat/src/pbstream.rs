//! `cartographer_pbstream`: prints a summary of maps, and migrates maps.

use std::path::{Path, PathBuf};

use portolan_mapfile::{MapInfo, MigrateOptions, info, migrate};
use portolan_pbstream::{MapReader, MessageKind, PbstreamReader, ReadLimits, pose_graph_to_text};

use crate::flags::{FlagError, Flags, KnownFlags};
use crate::{CompatError, Completeness, Console};

const USAGE: &str = "Swiss Army knife for pbstreams.\n\nTOOLS\n  info - Prints summary of pbstream.\n  migrate - \
                     Migrates pbstream to the new submap format.";

/// Runs the tool `info` or `migrate`.
///
/// # Errors
/// If flags are wrong, or a map cannot be read, is damaged, or cannot be written.
pub fn pbstream(arguments: &[String], console: &mut dyn Console) -> Result<Completeness, CompatError> {
    match arguments.split_first() {
        Some((tool, rest)) if tool == "info" => run_info(rest, console),
        Some((tool, rest)) if tool == "migrate" => run_migrate(rest, console),
        Some((tool, _)) => Err(CompatError::Failed(format!("Unknown subtool: \"{tool}\"\n{USAGE}"))),
        None => Err(CompatError::Failed(USAGE.to_owned())),
    }
}

fn run_info(arguments: &[String], console: &mut dyn Console) -> Result<Completeness, CompatError> {
    let known = KnownFlags {
        values: &[],
        switches: &[("all_debug_strings", false)],
        usage: "usage: cartographer_pbstream info <pbstream_filename> [--all_debug_strings]",
    };
    let flags = Flags::parse(arguments, &known).map_err(as_failure)?;
    let Some(name) = flags.positional.first() else {
        return Err(CompatError::Failed(known.usage.to_owned()));
    };
    let path = Path::new(name);
    let failed = |error| CompatError::in_file(path, error);
    let mut reader = MapReader::open_for_summary(path, ReadLimits::default()).map_err(failed)?;
    let pose_graph = flags.is_on("all_debug_strings").then(|| pose_graph_to_text(reader.pose_graph()));
    let summary: MapInfo = info(&mut reader).map_err(failed)?;
    if let Some(damage) = &summary.damage {
        return Err(CompatError::in_file(path, damage));
    }
    let counters: Vec<String> = summary.counter_lines().collect();
    let lines = summary.lines(name);
    let before_counters = lines.len().saturating_sub(counters.len());
    lines.iter().take(before_counters).for_each(|line| console.info(line));
    if let Some(text) = pose_graph {
        console.info(&format!("Pose graph: {}", text.trim_end()));
        print_messages(path, console)?;
    }
    counters.iter().for_each(|line| console.info(line));
    Ok(Completeness::Complete)
}

fn print_messages(path: &Path, console: &mut dyn Console) -> Result<(), CompatError> {
    let failed = |error| CompatError::in_file(path, error);
    let mut reader = PbstreamReader::open(path).map_err(failed)?;
    while let Some(raw) = reader.next_message().map_err(failed)? {
        if !matches!(raw.kind(), MessageKind::Header | MessageKind::PoseGraph | MessageKind::Options) {
            console.info(&format!("Serialized data: {}", raw.to_text().trim_end()));
        }
    }
    Ok(())
}

fn run_migrate(arguments: &[String], console: &mut dyn Console) -> Result<Completeness, CompatError> {
    let known = KnownFlags {
        values: &[],
        switches: &[("include_unfinished_submaps", true)],
        usage: "usage: cartographer_pbstream migrate <input_filename> <output_filename> \
                [--include_unfinished_submaps]",
    };
    let flags = Flags::parse(arguments, &known).map_err(as_failure)?;
    let [input, output] = flags.positional.as_slice() else {
        return Err(CompatError::Failed(known.usage.to_owned()));
    };
    console.info(&format!(
        "Migrating serialization format 1 in \"{input}\" to serialization format 2 in \"{output}\""
    ));
    let options = MigrateOptions {
        include_unfinished_submaps: flags.is_on("include_unfinished_submaps"),
        ..MigrateOptions::default()
    };
    let (input, output) = (PathBuf::from(input), PathBuf::from(output));
    migrate(&input, &output, options).map_err(|error| CompatError::in_file(&input, error))?;
    Ok(Completeness::Complete)
}

/// Turns wrong usage into a failure: Cartographer's program exits with code 1 in both cases.
fn as_failure(error: FlagError) -> CompatError {
    CompatError::Failed(error.to_string())
}
