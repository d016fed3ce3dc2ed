//! Finding a trajectory in a map that it is not connected with yet, while it is being recorded.
//!
//! In 3D a search without a guess is by far the most expensive one. It is made cheap by what is known all
//! the same: which way is up, by now, for whole trajectories; and that the scanner is near the ways of those
//! that made the map. It is made in time by searching as soon as nodes come, not only before optimisations,
//! and in bounds by allowing so many searches for each second of the recording.

use portolan_geometry::{Duration, Quaternion, Rigid3, Time, Vector3, rotation_between};

use super::PoseGraph;
use crate::{NodeId, SearchRegion, Space, SubmapId, TrajectoryId, of_trajectory};

/// The scanner may be so far, metres, outside the box around the nodes of a submap: to the side, as far as
/// another lane, aisle or room lies; in height, as far as a handheld scanner differs from one on a vehicle.
const BESIDE_NODES: f64 = 8.0;
const ABOVE_NODES: f64 = 1.5;
/// Searches for each second of the recording. One takes 10 to 100 ms on one core.
const SEARCHES_PER_SECOND: f64 = 8.0;
/// Searches that were not needed are saved up for so many seconds.
const SAVED_SECONDS: f64 = 2.0;
/// Searches wait for each other at most this long, so that several run at the same time.
const PATIENCE: Duration = Duration::from_ticks(5_000_000);

/// When and how a trajectory without a place is searched.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Localisation {
    is_wanted: bool,
    /// Searches that may be made.
    allowed: f64,
    last_node: Option<Time>,
    last_search: Option<Time>,
    /// Time of the newest node when a part of the map was first put where it lies in another one.
    pub placed_at: Option<Time>,
}

impl Localisation {
    pub fn set_wanted(&mut self, wanted: bool) {
        self.is_wanted = wanted;
    }

    /// Time goes on with a new node.
    fn advance(&mut self, time: Time) {
        let seconds = self.last_node.map_or(SAVED_SECONDS, |last| time.seconds_since(last));
        let most = SEARCHES_PER_SECOND * SAVED_SECONDS;
        self.allowed = (self.allowed + SEARCHES_PER_SECOND * seconds.max(0.0)).min(most);
        self.last_node = Some(time);
    }

    /// Whether one more search may be made. Without bounds if nothing is wanted while recording.
    pub fn take_one(&mut self) -> bool {
        let is_allowed = !self.is_wanted || self.allowed >= 1.0;
        self.allowed -= if self.is_wanted && is_allowed { 1.0 } else { 0.0 };
        is_allowed
    }
}

impl<S: Space> PoseGraph<S> {
    /// The time of the newest node when a trajectory was first found in the rest of the map.
    pub fn placed_at(&self) -> Option<Time> {
        self.localisation.placed_at
    }

    /// Where a node without a guess is looked for in a submap: a pose in the middle, and how far around it.
    pub(super) fn anywhere(&self, node_id: NodeId, submap_id: SubmapId) -> (Rigid3, SearchRegion) {
        let near_nodes = self.localisation.is_wanted.then(|| self.near_nodes(node_id, submap_id)).flatten();
        near_nodes.unwrap_or((
            Rigid3::identity(),
            SearchRegion::WholeSubmap { acceptance: self.loop_search().acceptance, around_guess: None },
        ))
    }

    fn near_nodes(&self, node_id: NodeId, submap_id: SubmapId) -> Option<(Rigid3, SearchRegion)> {
        let map_from_submap = self.problem.submaps.get(&submap_id)?;
        let inserted = self.state.submaps.get(&submap_id)?.node_ids.iter();
        let poses = inserted.filter_map(|id| Some(self.problem.nodes.get(id)?.map_from_node));
        let mut places = poses.map(|pose| (map_from_submap.inverse() * pose).translation.vector);
        let first = places.next()?;
        let (low, high) = places.fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
        let half_size = 0.5 * (high - low) + Vector3::new(BESIDE_NODES, BESIDE_NODES, ABOVE_NODES);
        let level_from_submap = self.level(submap_id.trajectory_id) * map_from_submap.rotation;
        let level_from_node =
            self.level(node_id.trajectory_id) * self.problem.nodes.get(&node_id)?.map_from_node.rotation;
        let middle = 0.5 * (low + high);
        let guess = Rigid3::from_parts(middle.into(), level_from_submap.inverse() * level_from_node);
        Some((guess, SearchRegion::NearNodes { level_from_submap, half_size }))
    }

    /// From where a trajectory lies by now to level: as its newest node says, whose gravity was averaged
    /// for longest.
    fn level(&self, id: TrajectoryId) -> Quaternion {
        let newest = of_trajectory(&self.problem.nodes, id).next_back().map(|(_, node)| node);
        let up = newest.map_or_else(Vector3::z, |node| {
            node.map_from_node.rotation * (node.gravity_alignment.inverse() * Vector3::z())
        });
        rotation_between(&up, &Vector3::z())
    }

    /// Looks for nodes without a guess if enough of them wait; optimises if that ties parts together.
    pub(super) fn localise(&mut self, newest: NodeId) {
        let Some(time) = self.problem.nodes.get(&newest).map(|node| node.time) else { return };
        self.localisation.advance(time);
        let waited = self.localisation.last_search.map_or(PATIENCE, |last| time - last);
        if !self.localisation.is_wanted || waited < PATIENCE || !self.search.has_unplaced() {
            return;
        }
        self.localisation.last_search = Some(time);
        let parts = self.state.connectivity.components().len();
        let found = self.search.run_unplaced(&self.remembered);
        self.add_found(found);
        if self.state.connectivity.components().len() < parts {
            self.optimize();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn searches_are_as_many_as_the_seconds_of_the_recording_allow() {
        let mut localisation = Localisation { is_wanted: true, ..Localisation::default() };
        let mut made = 0;
        for i in 0..=1000 {
            localisation.advance(Time::from_ticks(0) + Duration::from_seconds(0.1 * f64::from(i)));
            made += (0..50).filter(|_| localisation.take_one()).count();
        }
        let expected = SEARCHES_PER_SECOND * (100.0 + SAVED_SECONDS);
        assert!((made as f64 - expected).abs() < 2.0, "{made}");
        assert!((0..100_000).all(|_| Localisation::default().take_one()));
    }
}
