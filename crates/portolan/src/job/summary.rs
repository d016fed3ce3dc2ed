//! Summary of a mapped recording, in 2D or 3D.

use portolan_config::Engine;
use portolan_issue::IssueLog;
use portolan_mapping::{Consistency, DegenerateInterval, Drift, Space};
use portolan_numeric::LatencyHistogram;

use super::localisation::Localisation;
use crate::pipeline::MappedRecording;

/// Counts, times and quality of a mapped recording.
#[derive(Clone, Debug)]
pub struct MappingSummary {
    /// Scans matched.
    pub scans: u64,
    /// Map representation that scans were matched to.
    pub engine: Engine,
    /// Nodes of the map, known maps included.
    pub nodes: usize,
    /// Its submaps.
    pub submaps: usize,
    /// Its loop closures.
    pub loop_closures: usize,
    /// Loop closures that were rejected since the others contradict them.
    pub contradicted_loop_closures: u64,
    /// Loop closures that were left out since too few others agree with the change they would cause.
    pub unsupported_loop_closures: usize,
    /// Whether scans of one place agree with those of its earlier passes.
    pub self_consistency: Consistency,
    /// Drift: standard deviation of positions to which neither scans nor loop closures constrain the motion
    /// (2D).
    pub drift: Drift,
    /// Seconds from the first to the last measurement.
    pub recording_seconds: f64,
    /// Time that local SLAM took for each matched scan.
    pub scan_times: LatencyHistogram,
    /// How well the recording was found in known maps; none without any.
    pub localisation: Option<Localisation>,
    /// Intervals in which the pose was lost, for users: one line each.
    pub losses: String,
    /// Intervals in which scans had degenerate directions and the prediction determined the motion (3D).
    pub degenerate_intervals: Vec<DegenerateInterval>,
    /// Repairs and losses.
    pub issues: IssueLog,
    /// Whether it was stopped before the end of the recording, or before the map was finished.
    pub interrupted: bool,
    /// Whether data were lost while reading, or parts of the map are not connected with the rest.
    pub lost_data: bool,
    /// Whether the map is sound and may be written.
    pub is_sound: bool,
}

impl MappingSummary {
    /// Summary of a mapped recording after its checks.
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

    /// Whether the map must not be used: it is not sound, or the pose of the recording in the known maps is
    /// refuted.
    pub fn is_refused(&self) -> bool {
        !self.is_sound || self.localisation.is_some_and(|found| found.is_refused())
    }

    /// Whether the map can be used only with reservations: data were lost, or the pose of parts of it is not
    /// confirmed.
    pub fn is_partial(&self) -> bool {
        self.lost_data || self.localisation.is_some_and(|found| !found.is_trusted())
    }
}
