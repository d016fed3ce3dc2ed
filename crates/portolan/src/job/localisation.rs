//! Determines whether a recording was found in known maps.

use portolan_mapping::{Consistency, Space};

use crate::pipeline::MappedRecording;

/// How well the recording was found in the known maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Localisation {
    /// Loop closures between the recording and the known maps.
    pub loop_closures: usize,
    /// Seconds from the recording's first node to the first one that was found in a known map.
    pub first_found_after_seconds: Option<f64>,
    /// Seconds of the recording, from its first node, until its pose in the known maps was determined.
    pub placed_after_seconds: Option<f64>,
    /// Whether the user gave the start.
    pub start_was_given: bool,
    /// Distance between the given start and the pose found, metres and radians; none where its scans fit at
    /// the given start, or nowhere better.
    pub error_of_given_start: Option<(f64, f64)>,
    /// Whether its nodes with constraints to known maps were trimmed: then little is left to compare with
    /// these maps.
    pub is_trimmed: bool,
    /// Agreement of its scans with the known maps where they overlap.
    pub agreement: Consistency,
}

/// Fraction of confirmed places below which the pose of a recording is refuted. Simulated offices with a poor
/// lidar: at most 9 of 25 at errors of 0.3 m or more, 7 of 24 in an ambiguous place; 19 of 25 and more at the
/// correct pose (docs/experiments/2026-11-known-places.md).
const LEAST_CONFIRMED: f64 = 0.25;

/// Result for the pose of a recording in known maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// It was found, and its scans fit the known maps there.
    Found,
    /// It was found, but too few of its scans fit the known maps there, or too few are in the area that these cover.
    Uncertain,
    /// The user gave the start, and nothing confirms or refutes it: the recording left the area of the known
    /// maps.
    GivenAsStart,
    /// The known maps differ from its scans where it was found, or at the start given by the user.
    Refuted,
    /// No start was given, and it was not found.
    NotFound,
}

impl Place {
    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::Uncertain => "doubtful",
            Self::GivenAsStart => "told",
            Self::Refuted => "refuted",
            Self::NotFound => "not_found",
        }
    }
}

impl Localisation {
    /// None if there were no known maps.
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
        // A known scan found in a new submap counts from the time of the first scan of that submap.
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
        let start_was_given = state.trajectories.get(&new).is_some_and(|t| t.initial_pose.is_some());
        Some(Self {
            loop_closures,
            first_found_after_seconds,
            placed_after_seconds,
            start_was_given,
            error_of_given_start: mapped.map.graph.error_of_given_start(new),
            is_trimmed: trimmed.is_some(),
            agreement: mapped.in_known_maps,
        })
    }

    /// The result for the pose.
    pub fn place(&self) -> Place {
        let is_tied = self.placed_after_seconds.is_some() || self.first_found_after_seconds.is_some();
        let is_placed = is_tied || self.start_was_given;
        let Consistency { places, confirmed, .. } = self.agreement;
        match self.agreement.is_known() {
            _ if !is_placed => Place::NotFound,
            false if is_tied && self.is_trimmed => Place::Found,
            false if is_tied => Place::Uncertain,
            false => Place::GivenAsStart,
            true if self.agreement.is_confirmed() => Place::Found,
            true if (confirmed as f64) < LEAST_CONFIRMED * places as f64 => Place::Refuted,
            true => Place::Uncertain,
        }
    }

    /// Whether the pose of the recording in the known maps is confirmed.
    pub fn is_trusted(&self) -> bool {
        self.place() == Place::Found
    }

    /// Whether the recording must not be connected to the known maps, as far as can be known: otherwise two
    /// buildings would overlap.
    pub fn is_refused(&self) -> bool {
        matches!(self.place(), Place::Refuted | Place::NotFound)
    }
}
