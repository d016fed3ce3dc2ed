//! `portolan migrate`: converts maps of format version 1 to version 2.

use std::path::PathBuf;

use portolan_mapfile::{MigrateError, MigrateOptions, MigrateReport, migrate};
use portolan_pbstream::PbstreamError;
use serde::Serialize;

use crate::error::{CliError, Outcome};
use crate::output::{counted, outcome_of_map, print_json, print_summary};

/// Convert a map (.pbstream) of format version 1 to version 2.
///
/// In 3D, submaps get the histograms that version 2 needs, computed from those of their nodes. 2D maps are
/// accepted, too; there the versions differ only in the header. A map of version 2 is copied.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  portolan migrate old.pbstream new.pbstream")]
pub struct MigrateArgs {
    /// Map of version 1 or 2.
    old: PathBuf,
    /// Map of version 2 to write.
    new: PathBuf,
    /// Leave out unfinished submaps.
    #[arg(long)]
    finished_only: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    output: String,
    #[serde(flatten)]
    report: MigrateReport,
}

pub fn run(args: &MigrateArgs) -> Result<Outcome, CliError> {
    let options = MigrateOptions { include_unfinished_submaps: !args.finished_only, ..Default::default() };
    let report = migrate(&args.old, &args.new, options).map_err(|error| match error {
        MigrateError::File(error @ PbstreamError::Write { .. }) => CliError::Failed(error.to_string()),
        other => CliError::in_file(&args.old, other),
    })?;
    let output = args.new.display().to_string();
    if args.json {
        let report = Report { output, report };
        print_json(&report)?;
        return Ok(outcome_of_map(&args.new, &report.report.damage));
    }
    let mut text = format!(
        "version {} to 2: {} written, {} got a histogram\n",
        report.from_version,
        counted(report.messages, "message", "messages"),
        counted(report.histograms, "submap", "submaps"),
    );
    if report.unfinished_submaps > 0 {
        text += &format!(
            "{} left out\n",
            counted(report.unfinished_submaps, "unfinished submap", "unfinished submaps")
        );
    }
    print_summary(&(text + &output));
    Ok(outcome_of_map(&args.new, &report.damage))
}
