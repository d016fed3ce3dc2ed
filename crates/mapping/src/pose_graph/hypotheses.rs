//! Hypotheses about the pose of a part of the map: the graph is changed as if one were true, and changed
//! back if scans do not confirm it.

use std::collections::BTreeSet;

use portolan_geometry::Time;
use portolan_optimization::OptimizationData;

use super::PoseGraph;
use super::agreement::WaitingMatches;
use super::state::GraphState;
use crate::{Space, TrajectoryId};

/// Everything that placing a part of the map changes in the graph.
pub(super) struct Snapshot<S: Space> {
    state: GraphState<S>,
    problem: OptimizationData,
    waiting: WaitingMatches,
    tied_by_odometry: BTreeSet<TrajectoryId>,
    placed_parts: BTreeSet<TrajectoryId>,
    placed_at: Option<Time>,
}

impl<S: Space> PoseGraph<S> {
    pub(super) fn snapshot(&self) -> Snapshot<S> {
        Snapshot {
            state: self.state.clone(),
            problem: self.problem.clone(),
            waiting: self.waiting.clone(),
            tied_by_odometry: self.tied_by_odometry.clone(),
            placed_parts: self.placed_parts.clone(),
            placed_at: self.localisation.placed_at,
        }
    }

    pub(super) fn restore(&mut self, snapshot: Snapshot<S>) {
        self.state = snapshot.state;
        self.problem = snapshot.problem;
        self.waiting = snapshot.waiting;
        self.tied_by_odometry = snapshot.tied_by_odometry;
        self.placed_parts = snapshot.placed_parts;
        self.localisation.placed_at = snapshot.placed_at;
    }
}
