//! Parts of the map after gaps without scans that matches placed elsewhere than odometry says.
//!
//! Corridors look alike, and three matches that agree may all be wrong; but wheels may have stalled in the gap. So both places are
//! hypotheses: the scans of the part are compared with what others drew at either place.

use std::collections::BTreeSet;

use portolan_geometry::{Rigid3, rotation_angle};

use super::PoseGraph;
use super::consistency::Consistency;
use crate::{Space, TrajectoryId};

impl<S: Space> PoseGraph<S> {
    /// Moves parts that were placed far from where odometry says back there, unless their scans agree better with the map where they are.
    pub(super) fn verify_places_after_gaps(&mut self) {
        let ids: Vec<TrajectoryId> = self.state.trajectories.keys().copied().collect();
        for id in ids {
            if self.stop.is_requested() {
                return;
            }
            // What was moved before may have brought the two sides of this gap together.
            if let Some(by) = self.motion_to_odometry(id) {
                self.try_odometry_hypothesis(id, &by);
            }
        }
    }

    /// What takes a part from its place in the map to where odometry says; none if it is about there: as far off as odometry may be.
    fn motion_to_odometry(&self, id: TrajectoryId) -> Option<Rigid3> {
        let gap = self.state.trajectories.get(&id)?.after_gap.filter(|gap| !gap.bridge.is_contradicted)?;
        let tie = self.odometry_over_gap(id)?;
        let expected = self.problem.submaps.get(&tie.submap_id)? * tie.submap_from_node;
        let placed = self.problem.nodes.get(&tie.node_id)?.map_from_node;
        let error = placed.inverse() * expected;
        let window = self.policy.loops.window(gap.path_length, gap.path_length);
        let is_near =
            error.translation.vector.norm() <= window.linear && rotation_angle(&error) <= window.angular;
        (!is_near).then(|| expected * placed.inverse())
    }

    fn try_odometry_hypothesis(&mut self, id: TrajectoryId, by: &Rigid3) {
        let part = BTreeSet::from([id]);
        let found = self.consistency_with_others(&part);
        if found.is_confirmed() {
            return;
        }
        let before = self.snapshot();
        self.forget_ties_of(&part);
        self.move_part(id, by);
        self.tie_over_gaps();
        self.close_loops_with(&part);
        self.run_optimization();
        let there = self.consistency_with_others(&part);
        let is_better = contradicted_share(&there) < contradicted_share(&found);
        tracing::debug!("trajectory {id} where it was found: {found:?}, where odometry says: {there:?}");
        if !is_better || self.stop.is_requested() {
            self.restore(before);
        }
    }
}

/// The share of places known to others at which scans contradict them.
fn contradicted_share(consistency: &Consistency) -> f64 {
    consistency.contradicted as f64 / consistency.places.max(1) as f64
}
