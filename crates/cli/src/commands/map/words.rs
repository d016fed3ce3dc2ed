//! Progress messages and summary of mapping for the user.

use std::path::PathBuf;

use portolan::job::{MappingSummary, resident_and_peak_bytes};
use portolan::pipeline::PipelineProgress;
use portolan_issue::{Issue, Severity};
use portolan_numeric::LatencyHistogram;

use super::degenerate::degenerate_intervals;
use crate::known_map::sentence;
use crate::output::counted;

/// Progress message of mapping.
pub(super) fn describe(state: &PipelineProgress, start: std::time::Instant) -> String {
    let memory = resident_and_peak_bytes()
        .map_or_else(String::new, |(resident, _)| format!(", {} MB", resident / 1_000_000));
    format!(
        "{:.0} s of the recording, {:.0}x real time, {} nodes, {} constraints, {} waiting{memory}",
        state.recording_seconds,
        state.recording_seconds / start.elapsed().as_secs_f64().max(1e-3),
        state.backend.nodes,
        state.backend.constraints,
        state.backend.backlog,
    )
}

/// Maximum number of issues of one kind and sensor that are all listed; of more only the first is listed.
const MOST_ALIKE: usize = 3;

/// One line for each issue; harmless ones only if requested. `all` must be sorted by kind.
fn issues(all: impl Iterator<Item = Issue>, with_harmless: bool) -> String {
    let (harmless, listed): (Vec<Issue>, Vec<Issue>) =
        all.partition(|issue| issue.severity == Severity::Info && !with_harmless);
    let mut text = String::new();
    let are_alike = |a: &Issue, b: &Issue| (a.kind, &a.sensor, a.severity) == (b.kind, &b.sensor, b.severity);
    for alike in listed.chunk_by(are_alike) {
        let shown = if alike.len() > MOST_ALIKE { 1 } else { alike.len() };
        let (shown, others) = alike.split_at(shown);
        for issue in shown {
            let label = if issue.lost_data() { "lost" } else { "repaired" };
            text += &format!("{label}: {issue} ({}x)\n", issue.count);
        }
        if !others.is_empty() {
            let count = others.iter().fold(0u64, |sum, issue| sum.saturating_add(issue.count));
            text += &format!("  and {count} more of this kind (report.json lists them)\n");
        }
    }
    let harmless = harmless.len() as u64;
    if harmless > 0 {
        text += &format!("{} [-v lists them]\n", counted(harmless, "harmless repair", "harmless repairs"));
    }
    text
}

/// Summary of mapping: counts, localisation, computing times, rejected loop closures, losses, degenerate intervals,
/// issues and files.
pub(super) fn summary(
    mapped: &MappingSummary,
    files: &[PathBuf],
    seconds: f64,
    with_harmless: bool,
) -> String {
    let mut text = format!(
        "{} matched to {}, {}, {}, {}; {:.0} s of recording in {seconds:.1} s ({:.0}x real time)\n",
        counted(mapped.scans, "scan", "scans"),
        mapped.engine,
        counted(mapped.nodes as u64, "node", "nodes"),
        counted(mapped.submaps as u64, "submap", "submaps"),
        counted(mapped.loop_closures as u64, "loop closure", "loop closures"),
        mapped.recording_seconds,
        mapped.recording_seconds / seconds.max(1e-3),
    );
    if let Some(localisation) = &mapped.localisation {
        text += &format!("{}\n", sentence(localisation));
    }
    text += &times(&mapped.scan_times);
    text += &contradictions(mapped);
    text += &mapped.losses;
    text += &degenerate_intervals(&mapped.degenerate_intervals, mapped.recording_seconds);
    text += &issues(mapped.issues.iter(), with_harmless);
    if mapped.interrupted {
        text += "interrupted: stopped before the map was finished; what was mapped is saved\n";
    }
    for file in files {
        text += &format!("{}\n", file.display());
    }
    text.trim_end().to_owned()
}

/// Computing time per scan and peak memory.
fn times(times: &LatencyHistogram) -> String {
    if times.count() == 0 {
        return String::new();
    }
    let memory = resident_and_peak_bytes()
        .map_or_else(String::new, |(_, peak)| format!("; memory at most {} MB", peak / 1_000_000));
    format!(
        "local SLAM {:.2} ms a scan, 99 % within {:.2} ms{memory}\n",
        1e3 * times.total().as_secs_f64() / times.count() as f64,
        1e3 * times.quantile(0.99).as_secs_f64(),
    )
}

/// Rejected loop closures, places where the map contradicts itself, and drift.
fn contradictions(mapped: &MappingSummary) -> String {
    let mut text = String::new();
    let contradicted = mapped.contradicted_loop_closures;
    if contradicted > 0 {
        text += &format!(
            "{contradicted} more loop closures were rejected as outliers: the others contradict them\n"
        );
    }
    let unsupported = mapped.unsupported_loop_closures;
    if unsupported > 0 {
        text += &format!(
            "{unsupported} more loop closures would have bent the map and were left out: too few others agree with them\n"
        );
    }
    let consistency = mapped.self_consistency;
    if consistency.is_contradictory() {
        text += &format!(
            "the map contradicts itself at {} of {} places that were passed again: parts of it overlap wrongly (see map.png)\n",
            consistency.contradicted, consistency.places,
        );
    }
    let drift = mapped.drift;
    if drift.is_large() {
        text += &format!(
            "parts of the map may be off against each other by {:.1} m and {:.0} deg (one standard deviation): neither scans nor loop closures constrain their relative pose\n",
            drift.translation,
            drift.rotation.to_degrees(),
        );
    }
    text
}
