//! `portolan check`: diagnoses faults of recordings and maps, with their effect and remedy.

mod map;
mod places;
mod recording;

use std::path::{Path, PathBuf};

use portolan::job::Places;
use portolan_diagnose::Severity;
use serde::Serialize;

use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::input::open_map;
use crate::output::{counted, print, print_json};

/// Diagnose recordings and maps: faults, their consequences, and remedies.
///
/// Recordings are checked for damage, stamps that jump or differ from the time of recording, gaps, scans that
/// overlap or repeat, sensors that disagree about rotation or whose clocks are offset (from 10 ms on between
/// a lidar and an IMU in 3D), frames without transforms, and implausible IMU and odometry. Maps (.pbstream)
/// are checked for damage, missing or duplicate parts, impossible poses, constraints and grids, and times out
/// of order; findings say whether `portolan repair` helps.
///
/// With --places (2D maps, about one second per place) it also reports where in a map `portolan localize`
/// would have difficulties: about every 2 m, the scans of the last metres are searched in the whole map. A
/// place is ambiguous if they fit nearly as well elsewhere, degenerate if the scan does not constrain one
/// direction, as in a corridor, and thin if the map does not explain even the scans that it was made from
/// there.
///
/// Exit code 0 if there is no finding of severity error, 1 if there is.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan check walk.bag\n  portolan check maps/*.pbstream --json\n  \
    portolan check house/map.pbstream --places --picture places.png\n  \
    portolan check walk.bag && portolan map walk.bag")]
pub struct CheckArgs {
    /// Recordings and maps.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Also print histograms of the intervals between the messages of a recording.
    #[arg(long, conflicts_with = "json")]
    histograms: bool,
    /// For 2D maps: also examine how well localisation can distinguish places along the trajectories. It
    /// takes minutes for large maps.
    #[arg(long)]
    places: bool,
    /// Examine the places of a single map and draw them: the trajectory is green where they are distinct,
    /// blue where degenerate, orange where ambiguous, red where thin.
    #[arg(long, value_name = "FILE.png")]
    picture: Option<PathBuf>,
    /// Print JSON: an array with one object for each path.
    #[arg(long)]
    json: bool,
}

/// A fault of a recording or map.
#[derive(Serialize)]
struct Finding {
    severity: Severity,
    /// Topic of a recording, or message of a map.
    about: String,
    /// Description of the fault; of several of a kind, that of the first.
    #[serde(rename = "what")]
    text: String,
    /// Number of occurrences.
    count: u64,
    /// Effect on mapping or localisation.
    effect: String,
    /// Advice.
    advice: String,
    /// For maps: what `portolan repair` does about it.
    repair: Option<&'static str>,
}

#[derive(Serialize)]
struct Report {
    path: String,
    kind: &'static str,
    errors: usize,
    warnings: usize,
    findings: Vec<Finding>,
    /// For maps, with `--places`: how well localisation can distinguish the places.
    #[serde(skip_serializing_if = "Option::is_none")]
    places: Option<Places>,
    #[serde(skip)]
    histograms: Vec<String>,
}

pub fn run(args: &CheckArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    if let Some(picture) = &args.picture {
        if args.paths.len() > 1 {
            return Err(CliError::Usage("--picture draws one map: name only that".to_owned()));
        }
        if picture.extension().is_none_or(|ending| ending != "png") {
            return Err(CliError::Usage(format!("{}: pictures of places are .png", picture.display())));
        }
    }
    let mut reports = Vec::new();
    for path in &args.paths {
        let report = check(path, args, global)?;
        if !args.json {
            print(&report.text(args.histograms, global.verbose > 0))?;
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

fn check(path: &Path, args: &CheckArgs, global: &GlobalArgs) -> Result<Report, CliError> {
    let map = open_map(path)?;
    let is_map = map.is_some();
    let picture = args.picture.as_deref();
    if !is_map && picture.is_some() {
        return Err(CliError::Usage(format!(
            "{}: --picture needs a map, and this is not one",
            path.display()
        )));
    }
    let (mut findings, places, histograms) = match map {
        Some(input) => {
            let mut findings = map::check(path, input)?;
            let wanted = args.places || picture.is_some();
            let places = if wanted { places::check(path, picture, global, &mut findings)? } else { None };
            (findings, places, Vec::new())
        }
        None => {
            let (findings, histograms) = recording::check(path, global.quiet)?;
            (findings, None, histograms)
        }
    };
    // The most severe first, otherwise in the order in which they were found.
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
    let count = |severity| findings.iter().filter(|finding| finding.severity == severity).count();
    Ok(Report {
        path: path.display().to_string(),
        kind: if is_map { "map" } else { "recording" },
        errors: count(Severity::Error),
        warnings: count(Severity::Warning),
        findings,
        places,
        histograms,
    })
}

impl Report {
    /// The report as text. Histograms, and findings that need no action, only if requested.
    fn text(&self, with_histograms: bool, with_harmless: bool) -> String {
        let verdict = match (self.errors, self.warnings) {
            (0, 0) => "nothing wrong was found".to_owned(),
            (errors, warnings) => format!(
                "{}, {}",
                counted(errors as u64, "error", "errors"),
                counted(warnings as u64, "warning", "warnings")
            ),
        };
        let mut text = format!("{}: {}, {verdict}\n", self.path, self.kind);
        let is_shown = |finding: &&Finding| with_harmless || !finding.is_harmless();
        text.extend(self.findings.iter().filter(is_shown).map(Finding::text));
        if let Some(places) = &self.places {
            text += &places.text();
        }
        let hidden = self.findings.iter().filter(|finding| !is_shown(finding)).count() as u64;
        if hidden > 0 {
            text +=
                &format!("  {} [-v lists them]\n", counted(hidden, "harmless remark", "harmless remarks"));
        }
        for histogram in self.histograms.iter().filter(|_| with_histograms) {
            text += &format!("{histogram}\n");
        }
        text
    }
}

impl Finding {
    fn is_harmless(&self) -> bool {
        self.severity == Severity::Info && self.advice.is_empty()
    }

    fn text(&self) -> String {
        let severity = match self.severity {
            Severity::Info => "info",
            Severity::Warning => "warning",
            Severity::Error => "error",
        };
        let about = if self.about.is_empty() { String::new() } else { format!("{}: ", self.about) };
        let times = if self.count > 1 { format!(" ({} times)", self.count) } else { String::new() };
        let mut text = format!("  {severity}: {about}{}{times}\n", self.text);
        let lines = [
            ("effect: ", self.effect.as_str()),
            ("to do:  ", &self.advice),
            ("repair: ", self.repair.unwrap_or("")),
        ];
        for (label, line) in lines.into_iter().filter(|(_, line)| !line.is_empty()) {
            text += &format!("    {label}{line}\n");
        }
        text
    }
}
