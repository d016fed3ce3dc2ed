//! Verifies starts in a known map that the user gave: they can be wrong.
//!
//! Such a start constrains the trajectory weakly, and the trajectory is searched there. At the end its scans
//! are compared with the known map. If they confirm the place, the constraint is removed. Otherwise the
//! trajectory is searched in the whole known map, and a pose found there is accepted if scans confirm it. A
//! change that loses a confirmed place is undone.

use std::collections::BTreeSet;

use portolan_geometry::{Rigid3, rotation_angle};

use super::PoseGraph;
use crate::{NodeId, Space, TrajectoryId, of_trajectory};

/// Maximum error of a correct start, metres and radians: users do not give them more accurately.
const RIGHT: (f64, f64) = (0.5, 0.1);

impl<S: Space> PoseGraph<S> {
    /// Distance between the given and the found start of a trajectory, metres and radians; none where its
    /// scans fit the given start, or nothing better was found.
    pub fn error_of_given_start(&self, id: TrajectoryId) -> Option<(f64, f64)> {
        self.refuted_starts.get(&id).copied()
    }

    pub(super) fn verify_given_starts(&mut self) {
        if !self.searches_whole_maps() {
            return;
        }
        let with_start: BTreeSet<TrajectoryId> =
            self.problem.given_starts.keys().map(|node_id| node_id.trajectory_id).collect();
        for id in with_start {
            self.verify_given_start(id);
        }
    }

    fn verify_given_start(&mut self, id: TrajectoryId) {
        // Pieces into which the trajectory was split have later numbers, and belong to the same start.
        let new: BTreeSet<TrajectoryId> =
            self.state.trajectories.keys().copied().filter(|other| *other >= id).collect();
        if self.stop.is_requested() {
            return;
        }
        let before = self.snapshot();
        let given_start =
            of_trajectory(&self.problem.given_starts, id).next().map(|(node_id, pose)| (node_id, *pose));
        let is_confirmed = |graph: &Self| graph.consistency_with_others(&new).is_confirmed();
        if is_confirmed(self) {
            // It is not needed any more, and would bias the result.
            self.problem.given_starts.retain(|node_id, _| !new.contains(&node_id.trajectory_id));
            self.run_optimization();
        } else {
            self.look_elsewhere(id, &new);
        }
        if is_confirmed(self) {
            given_start.into_iter().for_each(|(first, given)| self.note_error_of_start(first, &given));
        } else {
            self.restore(before);
        }
    }

    /// Searches a trajectory in the whole rest of the map.
    fn look_elsewhere(&mut self, id: TrajectoryId, new: &BTreeSet<TrajectoryId>) {
        self.forget_ties_of(new);
        self.places.save_for(self.state.nodes.len());
        self.place(id, new);
        if self.is_joined(id, new) {
            self.close_loops_with(new);
            self.run_optimization();
        }
    }

    fn note_error_of_start(&mut self, first: NodeId, given: &Rigid3) {
        let Some(found) = self.problem.nodes.get(&first) else { return };
        let error = given.inverse() * found.map_from_node;
        let (metres, radians) = (error.translation.vector.norm(), rotation_angle(&error));
        if metres > RIGHT.0 || radians > RIGHT.1 {
            self.refuted_starts.insert(first.trajectory_id, (metres, radians));
        }
    }

    /// Removes the constraints between these trajectories and the rest of the map.
    pub(super) fn forget_ties_of(&mut self, new: &BTreeSet<TrajectoryId>) {
        self.problem.given_starts.retain(|node_id, _| !new.contains(&node_id.trajectory_id));
        self.state.constraints.retain(|constraint| {
            new.contains(&constraint.node_id.trajectory_id)
                == new.contains(&constraint.submap_id.trajectory_id)
        });
        self.state.connectivity = self.connectivity_by(|_| true, |id| !new.contains(&id));
    }
}
