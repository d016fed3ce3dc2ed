//! Whether a recording was found in maps that were known before.

use portolan_mapping::Space;

use crate::pipeline::MappedRecording;

/// How well the recording was found in the maps that were known before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Localisation {
    /// Loop closures between the recording and the known maps.
    pub loop_closures: usize,
    /// Seconds from the recording's first node to the first one that was found in a known map.
    pub first_found_after_seconds: Option<f64>,
    /// Seconds of the recording, from its first node, that it took until its place was known.
    pub placed_after_seconds: Option<f64>,
    /// Whether somebody said where it starts.
    pub start_was_told: bool,
}

impl Localisation {
    /// Nothing if no map was known before.
    pub fn of<S: Space>(mapped: &MappedRecording<S>) -> Option<Self> {
        let (state, new) = (mapped.map.graph.state(), mapped.trajectory_id);
        let pieces = mapped.pieces();
        if state.trajectories.keys().all(|id| pieces.contains(id)) {
            return None;
        }
        let time = |node_id| state.nodes.get(&node_id).map(|node| node.data.time);
        let found = |c: &&portolan_mapping::Constraint| {
            (c.submap_id.trajectory_id == new) != (c.node_id.trajectory_id == new)
        };
        let between: Vec<_> = state.constraints.iter().filter(found).collect();
        let start = mapped.map.node_poses(new).first().map(|(time, _)| *time);
        // A known scan found in a new submap counts from when that submap had its first scan.
        let first = between.iter().filter_map(|c| {
            if c.node_id.trajectory_id == new {
                return time(c.node_id);
            }
            state.submaps.get(&c.submap_id)?.node_ids.iter().find_map(|id| time(*id))
        });
        let trimmed = state.trimmed_ties.get(&new);
        let first = first.chain(trimmed.map(|ties| ties.first)).min();
        let first_found_after_seconds = first.zip(start).map(|(found, start)| found.seconds_since(start));
        let placed = mapped.map.graph.placed_at();
        let placed_after_seconds = placed.zip(start).map(|(placed, start)| placed.seconds_since(start));
        let loop_closures = between.len() + trimmed.map_or(0, |ties| ties.count);
        let start_was_told = state.trajectories.get(&new).is_some_and(|t| t.initial_pose.is_some());
        Some(Self { loop_closures, first_found_after_seconds, placed_after_seconds, start_was_told })
    }
}
