//! Localises a trajectory, while it is being recorded, in a map that it is not connected with yet: proposals
//! are matched as nodes come, not only before optimisations.

use portolan_geometry::{Duration, Time};

use super::PoseGraph;
use crate::{NodeId, Space};

/// Maximum time that searches are collected, so that several run at the same time.
const PATIENCE: Duration = Duration::from_ticks(5_000_000);

/// When a trajectory without a place is searched.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Localisation {
    is_wanted: bool,
    last_search: Option<Time>,
    /// Time of the newest node when a part of the map was first moved to its place in another one.
    pub placed_at: Option<Time>,
}

impl Localisation {
    pub fn set_wanted(&mut self, wanted: bool) {
        self.is_wanted = wanted;
    }
}

impl<S: Space> PoseGraph<S> {
    /// The time of the newest node when a trajectory was first found in the rest of the map.
    pub fn placed_at(&self) -> Option<Time> {
        self.localisation.placed_at
    }

    /// Searches nodes without a guess if they have waited for long enough; optimises if that connects parts.
    pub(super) fn localise(&mut self, newest: NodeId) {
        let Some(time) = self.problem.nodes.get(&newest).map(|node| node.time) else { return };
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
