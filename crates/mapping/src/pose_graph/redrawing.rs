//! Draws submaps again when the map is finished.
//!
//! While mapping, a submap is drawn from scans at the poses of local SLAM, with the same weight for hits at
//! any distance. The optimisation moves the scans of a submap against each other, and occupied cells along
//! walls that far beams erased stay erased. The final submaps, which are displayed and used for localisation,
//! are drawn from the scans at their final poses.

use std::sync::Arc;

use rayon::prelude::*;

use super::PoseGraph;
use crate::{Space, SubmapId};

impl<S: Space> PoseGraph<S> {
    /// Draws all submaps of this job again, if the policy says so; none once the map is requested as it is.
    /// Submaps of a known map stay as they are.
    pub(super) fn redraw_submaps(&mut self) {
        if !self.policy.redraws {
            return;
        }
        let ids: Vec<SubmapId> = self.state.submaps.keys().copied().collect();
        let continues = || !self.stop.is_requested();
        let redrawn = ids.par_iter().filter(|_| continues()).filter_map(|id| Some((*id, self.redrawn(*id)?)));
        let redrawn: Vec<_> = redrawn.collect();
        if self.stop.is_requested() {
            return;
        }
        for (id, submap) in redrawn {
            self.search.delete_matcher(id);
            if let Some(entry) = self.state.submaps.get_mut(&id) {
                entry.submap = Some(Arc::new(submap));
            }
        }
    }

    pub(super) fn redrawn(&self, id: SubmapId) -> Option<S::Submap> {
        let entry = self.state.submaps.get(&id)?;
        let submap_from_map = self.problem.submaps.get(&id)?.inverse();
        let mut nodes = entry.node_ids.iter().filter_map(|node_id| {
            let map_from_node = self.problem.nodes.get(node_id)?.map_from_node;
            Some((&*self.state.nodes.get(node_id)?.data, submap_from_map * map_from_node))
        });
        S::redrawn(entry.submap.as_ref()?, &mut nodes)
    }
}
