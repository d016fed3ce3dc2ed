//! Whether a recording was found in maps that were known before.

use portolan_mapping::{Consistency, Space};

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
    pub start_was_given: bool,
    /// How far from where somebody said that it starts it was found, metres and radians; none where its scans fit there, or nowhere
    /// better.
    pub error_of_given_start: Option<(f64, f64)>,
    /// Whether its nodes that were tied to known maps are gone: then there is little to compare with these.
    pub is_trimmed: bool,
    /// How its scans agree with the known maps where it lies in them.
    pub agreement: Consistency,
}

/// A place that fewer of its places than this fraction confirm is refuted. Simulated offices seen by a poor lidar: at most 9 of 25 where
/// they lie 0.3 m off or more, 7 of 24 in a place that looks alike; 19 of 25 and more where they belong
/// (docs/experiments/2026-11-known-places.md).
const LEAST_CONFIRMED: f64 = 0.25;

/// What is known of the place of a recording in known maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// It was found, and its scans fit the known maps there.
    Found,
    /// It was found, but too few of its scans fit the known maps there, or lie where these know the place.
    Doubtful,
    /// Somebody said where it starts, and nothing speaks for or against it: it went where no known map reaches.
    GivenAsStart,
    /// The known maps look otherwise where it was found, or where somebody said that it starts.
    Refuted,
    /// Nobody said it, and it was not found.
    NotFound,
}

impl Place {
    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Found => "found",
            Self::Doubtful => "doubtful",
            Self::GivenAsStart => "told",
            Self::Refuted => "refuted",
            Self::NotFound => "not_found",
        }
    }
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

    /// What is known of the place.
    pub fn place(&self) -> Place {
        let is_tied = self.placed_after_seconds.is_some() || self.first_found_after_seconds.is_some();
        let is_placed = is_tied || self.start_was_given;
        let Consistency { places, confirmed, .. } = self.agreement;
        match self.agreement.is_known() {
            _ if !is_placed => Place::NotFound,
            false if is_tied && self.is_trimmed => Place::Found,
            false if is_tied => Place::Doubtful,
            false => Place::GivenAsStart,
            true if self.agreement.is_confirmed() => Place::Found,
            true if (confirmed as f64) < LEAST_CONFIRMED * places as f64 => Place::Refuted,
            true => Place::Doubtful,
        }
    }

    /// Whether the recording is known to lie in the known maps where it belongs.
    pub fn is_trusted(&self) -> bool {
        self.place() == Place::Found
    }

    /// Whether the recording does not lie where it belongs, as far as can be known: two buildings on top of each other.
    pub fn is_refused(&self) -> bool {
        matches!(self.place(), Place::Refuted | Place::NotFound)
    }
}
