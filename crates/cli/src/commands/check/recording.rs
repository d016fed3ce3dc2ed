//! Finds faults of recordings.

use std::path::Path;

use portolan_diagnose::check_with_clocks;
use portolan_ingest::{IngestOptions, Inventory};
use portolan_recording::open;

use super::Finding;
use crate::error::CliError;
use crate::progress::Progress;

/// Reads a whole recording; returns all findings, and histograms of the intervals between messages.
pub fn check(path: &Path, quiet: bool) -> Result<(Vec<Finding>, Vec<String>), CliError> {
    let recording = open(path)?;
    let size = recording.size_bytes();
    let mut progress = Progress::start("check", size, quiet);
    let mut show = |position| {
        if progress.is_due() {
            progress.update(position, size, String::new());
        }
    };
    let options = IngestOptions::default();
    let inventory = Inventory::of(recording.as_ref(), &options)?;
    let compared = portolan::clocks::measure(recording.as_ref(), &inventory, &options, &mut show);
    let report = check_with_clocks(recording.as_ref(), &inventory, &options, &compared, &mut show)?;
    progress.finish();
    let finding = |found: portolan_diagnose::Finding| Finding {
        severity: found.severity,
        about: found.topic,
        text: found.text,
        count: found.count,
        effect: found.effect_on_slam,
        advice: found.advice,
        repair: None,
    };
    Ok((report.findings.into_iter().map(finding).collect(), report.histograms))
}
