//! Whether a recording was found in maps that were known before.

use portolan_geometry::Rigid3;
use portolan_mapping::{Map, Space, TrajectoryId};

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
    /// Of the nodes of the recording (up to 200, spread evenly) so many lie near a node of a known map: places that should
    /// have been recognised.
    pub nodes_near_known_ones: usize,
}

/// Nodes nearer to each other see the same place, metres.
const NEAR: f64 = 3.0;
/// Nodes that are compared.
const COMPARED: usize = 200;
/// So many places that were not recognised refute a start.
const REFUTED: usize = 5;

/// What is known of the place of a recording in known maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// It was found.
    Found,
    /// Somebody said where it starts, and nothing speaks for or against it: it went where no known map reaches.
    Told,
    /// Somebody said where it starts, but the known maps look otherwise there.
    Refuted,
    /// Nobody said it, and it was not found.
    NotFound,
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
        let nodes_near_known_ones = nodes_near_known_ones(&mapped.map, &pieces);
        Some(Self {
            loop_closures,
            first_found_after_seconds,
            placed_after_seconds,
            start_was_told,
            nodes_near_known_ones,
        })
    }

    /// What is known of the place.
    pub fn place(&self) -> Place {
        match self {
            _ if self.placed_after_seconds.is_some() || self.first_found_after_seconds.is_some() => {
                Place::Found
            }
            _ if !self.start_was_told => Place::NotFound,
            _ if self.nodes_near_known_ones >= REFUTED => Place::Refuted,
            _ => Place::Told,
        }
    }

    /// Whether the recording lies in the known maps where it belongs, as far as can be known.
    pub fn is_trusted(&self) -> bool {
        matches!(self.place(), Place::Found | Place::Told)
    }
}

/// How many nodes of the pieces of a recording lie near one of another trajectory.
fn nodes_near_known_ones<S: Space>(map: &Map<S>, pieces: &[TrajectoryId]) -> usize {
    let (new, known): (Vec<_>, Vec<_>) =
        map.graph.state().nodes.iter().partition(|(id, _)| pieces.contains(&id.trajectory_id));
    let stride = new.len().div_ceil(COMPARED).max(1);
    let near = |a: &Rigid3, b: &Rigid3| (a.translation.vector - b.translation.vector).norm() < NEAR;
    let is_near = |pose: &Rigid3| known.iter().any(|(_, node)| near(pose, &node.map_from_tracking));
    new.iter().step_by(stride).filter(|(_, node)| is_near(&node.map_from_tracking)).count()
}
