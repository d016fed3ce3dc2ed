//! `cartographer_pbstream`.

use std::path::{Path, PathBuf};

use portolan_config::flags::{FlagError, Flags, KnownFlags};
use portolan_mapfile::{MapInfo, MigrateOptions, info, migrate};
use portolan_pbstream::{MapReader, MessageKind, PbstreamReader, ReadLimits, pose_graph_to_text};

use super::log;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};

const USAGE: &str = "Swiss Army knife for pbstreams.\n\nTOOLS\n  info - Prints summary of pbstream.\n  migrate - \
                     Migrates pbstream to the new submap format.";

pub fn run(arguments: &[String], _: &GlobalArgs) -> Result<Outcome, CliError> {
    match arguments.split_first() {
        Some((tool, rest)) if tool == "info" => run_info(rest),
        Some((tool, rest)) if tool == "migrate" => run_migrate(rest),
        Some((tool, _)) => Err(CliError::Failed(format!("Unknown subtool: \"{tool}\"\n{USAGE}"))),
        None => Err(CliError::Failed(USAGE.to_owned())),
    }
}

fn run_info(arguments: &[String]) -> Result<Outcome, CliError> {
    let known = KnownFlags {
        values: &[],
        switches: &[("all_debug_strings", false)],
        usage: "usage: cartographer_pbstream info <pbstream_filename> [--all_debug_strings]",
    };
    let flags = Flags::parse(arguments, &known).map_err(as_failure)?;
    let Some(name) = flags.positional.first() else {
        return Err(CliError::Failed(known.usage.to_owned()));
    };
    let path = Path::new(name);
    let failed = |error| CliError::in_file(path, error);
    let mut reader = MapReader::open_for_summary(path, ReadLimits::default()).map_err(failed)?;
    let pose_graph = flags.is_on("all_debug_strings").then(|| pose_graph_to_text(reader.pose_graph()));
    let summary: MapInfo = info(&mut reader).map_err(failed)?;
    if let Some(damage) = &summary.damage {
        return Err(CliError::in_file(path, damage));
    }
    let counters: Vec<String> = summary.counter_lines().collect();
    let lines = summary.lines(name);
    let before_counters = lines.len().saturating_sub(counters.len());
    lines.iter().take(before_counters).for_each(|line| log::info(line));
    if let Some(text) = pose_graph {
        log::info(&format!("Pose graph: {}", text.trim_end()));
        print_messages(path)?;
    }
    counters.iter().for_each(|line| log::info(line));
    Ok(Outcome::Done)
}

fn print_messages(path: &Path) -> Result<(), CliError> {
    let failed = |error| CliError::in_file(path, error);
    let mut reader = PbstreamReader::open(path).map_err(failed)?;
    while let Some(raw) = reader.next_message().map_err(failed)? {
        if !matches!(raw.kind(), MessageKind::Header | MessageKind::PoseGraph | MessageKind::Options) {
            log::info(&format!("Serialized data: {}", raw.to_text().trim_end()));
        }
    }
    Ok(())
}

fn run_migrate(arguments: &[String]) -> Result<Outcome, CliError> {
    let known = KnownFlags {
        values: &[],
        switches: &[("include_unfinished_submaps", true)],
        usage: "usage: cartographer_pbstream migrate <input_filename> <output_filename> \
                [--include_unfinished_submaps]",
    };
    let flags = Flags::parse(arguments, &known).map_err(as_failure)?;
    let [input, output] = flags.positional.as_slice() else {
        return Err(CliError::Failed(known.usage.to_owned()));
    };
    log::info(&format!(
        "Migrating serialization format 1 in \"{input}\" to serialization format 2 in \"{output}\""
    ));
    let options = MigrateOptions {
        include_unfinished_submaps: flags.is_on("include_unfinished_submaps"),
        ..MigrateOptions::default()
    };
    let (input, output) = (PathBuf::from(input), PathBuf::from(output));
    migrate(&input, &output, options).map_err(|error| CliError::in_file(&input, error))?;
    Ok(Outcome::Done)
}

/// Cartographer ends with code 1 also on wrong usage.
fn as_failure(error: FlagError) -> CliError {
    CliError::Failed(error.to_string())
}
