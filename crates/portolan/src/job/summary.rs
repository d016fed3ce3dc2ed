//! What is told of a mapped recording, whatever space it was mapped in.

use portolan_config::Engine;
use portolan_issue::IssueLog;
use portolan_mapping::{Consistency, DegenerateInterval, Drift, Space};
use portolan_numeric::LatencyHistogram;

use super::localisation::Localisation;
use crate::pipeline::MappedRecording;

/// Counts, times and doubts of a mapped recording.
#[derive(Clone, Debug)]
pub struct MappingSummary {
    /// Scans matched.
    pub scans: u64,
    /// What they were matched to.
    pub engine: Engine,
    /// Nodes of the map, known maps included.
    pub nodes: usize,
    /// Its submaps.
    pub submaps: usize,
    /// Its loop closures.
    pub loop_closures: usize,
    /// Loop closures that were rejected since the others contradict them.
    pub contradicted_loop_closures: u64,
    /// Loop closures that were left out since too few others agree with what they would bend.
    pub unsupported_loop_closures: usize,
    /// Whether scans of one place agree with those of its earlier passes.
    pub self_consistency: Consistency,
    /// How far places may be off to which only odometry, or nothing, told the way (2D).
    pub drift: Drift,
    /// Seconds from the first to the last measurement.
    pub recording_seconds: f64,
    /// How long local SLAM took for each matched scan.
    pub scan_times: LatencyHistogram,
    /// How well the recording was found in known maps; none without any.
    pub localisation: Option<Localisation>,
    /// When the scanner was lost, for people: a line each.
    pub losses: String,
    /// Where scans left directions open and the prediction decided (3D).
    pub degenerate_intervals: Vec<DegenerateInterval>,
    /// What was repaired or left out.
    pub issues: IssueLog,
    /// Whether it was stopped before the end of the recording, or before the map was finished.
    pub interrupted: bool,
    /// Whether data were lost while reading, or parts of the map are not tied to the rest.
    pub lost_data: bool,
    /// Whether the map is fit to be written.
    pub is_sound: bool,
}

impl MappingSummary {
    /// Of a recording that was mapped and judged.
    pub fn of<S: Space>(mapped: &MappedRecording<S>) -> Self {
        let graph = &mapped.map.graph;
        let state = graph.state();
        Self {
            scans: mapped.scans,
            engine: mapped.map.options.engine(),
            nodes: state.nodes.len(),
            submaps: state.submaps.len(),
            loop_closures: state.constraints.iter().filter(|c| c.is_loop_closure()).count(),
            contradicted_loop_closures: graph.contradicted_loop_closures(),
            unsupported_loop_closures: graph.unsupported_loop_closures(),
            self_consistency: graph.self_consistency(),
            drift: graph.drift(),
            recording_seconds: mapped.recording_seconds,
            scan_times: mapped.scan_times.clone(),
            localisation: Localisation::of(mapped),
            losses: mapped.losses_in_words(),
            degenerate_intervals: mapped.degenerate_intervals.clone(),
            issues: mapped.issues.clone(),
            interrupted: mapped.interrupted,
            lost_data: mapped.lost_data(),
            is_sound: mapped.is_sound(),
        }
    }

    /// Whether nothing of the map is to be used: it is not fit to be written, or the recording does not lie in the known maps
    /// where it belongs.
    pub fn is_refused(&self) -> bool {
        !self.is_sound || self.localisation.is_some_and(|found| found.is_refused())
    }

    /// Whether the map can be used, but not all of it as it is: data were lost, or nobody knows whether parts of it lie where
    /// they belong.
    pub fn is_partial(&self) -> bool {
        self.lost_data || self.localisation.is_some_and(|found| !found.is_trusted())
    }
}
