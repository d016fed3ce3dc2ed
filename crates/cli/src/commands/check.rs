//! `portolan check`: what is wrong with recordings and maps, what follows, and what to do.

mod finding;
mod fingerprint;
mod map;
mod recording;
mod stream;
mod values;

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, is_map, print, print_json};
use finding::{Finding, Severity};

/// Tell what is wrong with recordings and maps, what follows from it, and what to do.
///
/// Of a recording: damage, stamps that jump or differ from the time of recording, gaps, scans that overlap or
/// repeat, frames without transforms, implausible IMU and odometry. Of a map (.pbstream): damage, missing or
/// doubled parts, impossible poses, constraints and grids.
///
/// Exit code 0 if there is no finding of severity error, 1 if there is.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan check walk.bag\n  portolan check maps/*.pbstream --json\n  \
    portolan check walk.bag && portolan map walk.bag")]
pub struct CheckArgs {
    /// Recordings and maps.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Print JSON: an array with one object for each path.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    path: String,
    kind: &'static str,
    errors: usize,
    warnings: usize,
    findings: Vec<Finding>,
}

pub fn run(args: &CheckArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let mut reports = Vec::new();
    for path in &args.paths {
        let report = check(path, global.quiet)?;
        if !args.json {
            print(&report.text())?;
        }
        reports.push(report);
    }
    if args.json {
        print_json(&reports)?;
    }
    let errors = reports.iter().map(|report| report.errors).sum::<usize>() as u64;
    match errors {
        0 => Ok(Outcome::Done),
        errors => Err(CliError::Failed(format!("found {}", counted(errors, "error", "errors")))),
    }
}

fn check(path: &Path, quiet: bool) -> Result<Report, CliError> {
    let is_map = is_map(path)?;
    let mut findings = if is_map { map::check(path)? } else { recording::check(path, quiet)? };
    // The worst first, otherwise as they were found.
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    let count = |severity| findings.iter().filter(|finding| finding.severity == severity).count();
    Ok(Report {
        path: path.display().to_string(),
        kind: if is_map { "map" } else { "recording" },
        errors: count(Severity::Error),
        warnings: count(Severity::Warning),
        findings,
    })
}

impl Report {
    fn text(&self) -> String {
        let verdict = match (self.errors, self.warnings) {
            (0, 0) => "nothing wrong was found".to_owned(),
            (errors, warnings) => format!(
                "{}, {}",
                counted(errors as u64, "error", "errors"),
                counted(warnings as u64, "warning", "warnings")
            ),
        };
        let findings: String = self.findings.iter().map(Finding::text).collect();
        format!("{}: {}, {verdict}\n{findings}", self.path, self.kind)
    }
}
