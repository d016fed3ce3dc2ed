//! Verifies starts in a known map that the user gave: they can be wrong.
//!
//! Such a start constrains the trajectory weakly, and the trajectory is searched there. At the end its scans
//! are compared with the known map. If they confirm the place, the constraint is removed. Otherwise the
//! trajectory is searched in the whole known map, and a pose found there is accepted if scans confirm it. A
//! change that loses a confirmed place is undone.

use std::collections::BTreeSet;

use portolan_geometry::rotation_angle;
use portolan_optimization::{OptimizationData, TrajectoryConnectivity};

use super::PoseGraph;
use crate::{Space, TrajectoryId, of_trajectory};

/// Maximum error of a correct start, metres and radians: users do not give them more accurately.
const RIGHT: (f64, f64) = (0.5, 0.1);

impl<S: Space> PoseGraph<S> {
    /// Distance between the given and the found start of a trajectory, metres and radians; none where its
    /// scans fit the given start, or nothing better was found.
    pub fn error_of_given_start(&self, id: TrajectoryId) -> Option<(f64, f64)> {
        self.refuted_starts.get(&id).copied()
    }

    pub(super) fn doubt_given_starts(&mut self) {
        if !self.searches_whole_maps() {
            return;
        }
        let told: BTreeSet<TrajectoryId> =
            self.problem.given_starts.keys().map(|node_id| node_id.trajectory_id).collect();
        for id in told {
            self.doubt_given_start(id);
        }
    }

    fn doubt_given_start(&mut self, id: TrajectoryId) {
        // Pieces into which the trajectory was split have later numbers, and belong to the same start.
        let new: BTreeSet<TrajectoryId> =
            self.state.trajectories.keys().copied().filter(|other| *other >= id).collect();
        if self.stop.is_asked() {
            return;
        }
        let before = (self.state.clone(), self.problem.clone());
        let (waiting, placed_at) = (self.waiting.clone(), self.localisation.placed_at);
        let is_confirmed = |graph: &Self| graph.consistency_with_others(&new).is_confirmed();
        if is_confirmed(self) {
            // It is not needed any more, and would bias the result.
            self.problem.given_starts.retain(|node_id, _| !new.contains(&node_id.trajectory_id));
            self.run_optimization();
        } else {
            self.look_elsewhere(id, &new);
        }
        if is_confirmed(self) {
            self.note_error_of_start(id, &before.1);
        } else {
            (self.state, self.problem) = before;
            (self.waiting, self.localisation.placed_at) = (waiting, placed_at);
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

    fn note_error_of_start(&mut self, id: TrajectoryId, told: &OptimizationData) {
        let told = of_trajectory(&told.given_starts, id).next();
        let Some((found, told)) =
            told.and_then(|(first, told)| self.problem.nodes.get(&first).zip(Some(told)))
        else {
            return;
        };
        let error = told.inverse() * found.map_from_node;
        let (metres, radians) = (error.translation.vector.norm(), rotation_angle(&error));
        if metres > RIGHT.0 || radians > RIGHT.1 {
            self.refuted_starts.insert(id, (metres, radians));
        }
    }

    /// Removes the constraints between these trajectories and the rest of the map.
    pub(super) fn forget_ties_of(&mut self, new: &BTreeSet<TrajectoryId>) {
        self.problem.given_starts.retain(|node_id, _| !new.contains(&node_id.trajectory_id));
        self.state.constraints.retain(|constraint| {
            new.contains(&constraint.node_id.trajectory_id)
                == new.contains(&constraint.submap_id.trajectory_id)
        });
        self.state.connectivity = TrajectoryConnectivity::default();
        for (id, entry) in &self.state.trajectories {
            self.state.connectivity.add(*id);
            if let Some(start) = entry.initial_pose.as_ref().filter(|_| !new.contains(id)) {
                self.state.connectivity.connect(*id, start.to_trajectory_id, start.time);
            }
        }
        let frozen: Vec<TrajectoryId> = self.problem.frozen.iter().copied().collect();
        frozen.into_iter().for_each(|id| self.freeze_trajectory(id));
        let ties = self.state.constraints.iter();
        let ties = ties.filter(|c| c.node_id.trajectory_id != c.submap_id.trajectory_id).cloned();
        for constraint in ties.collect::<Vec<_>>() {
            self.connect_by(&constraint);
        }
    }
}
