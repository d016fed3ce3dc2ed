//! Detects and drops loop closures that all others together contradict.

use portolan_geometry::{Dimension, Rigid3, rotation_angle};
use portolan_numeric::median;

use super::PoseGraph;
use crate::{Constraint, Space};

/// A loop closure is contradicted if its residual in the optimised graph exceeds this factor times the median
/// residual, and the limits below in metres and radians. (Of normally distributed errors along three axes not
/// one in 10¹² is so large.)
const TIMES_MEDIAN: f64 = 5.0;
/// Minimum residuals of a contradicted loop closure in 2D, metres and radians: as much as cells and bent
/// submaps explain.
const MIN_IN_PLANE: (f64, f64) = (0.2, 0.05);
/// The same in 3D, where scans fit planes within a centimetre.
const MIN_IN_SPACE: (f64, f64) = (0.05, 0.015);
/// Minimum number of loop closures; fewer cannot outvote one of them.
const MIN_LOOP_CLOSURES: usize = 5;

impl<S: Space> PoseGraph<S> {
    /// How many loop closures were dropped because the others contradict them.
    pub fn contradicted_loop_closures(&self) -> u64 {
        self.contradicted
    }

    /// Drops the contradicted ones that this run has found (loaded ones are not touched: they have no
    /// score). The robust loss has kept them from bending the graph much. Returns how many there were.
    pub(super) fn drop_contradicted_loop_closures(&mut self) -> usize {
        let found = |c: &Constraint| c.is_loop_closure() && c.score.is_some();
        let errors: Vec<Option<(f64, f64)>> = self
            .state
            .constraints
            .iter()
            .map(|c| if found(c) { self.disagreement(c) } else { None })
            .collect();
        let (mut translations, mut rotations): (Vec<f64>, Vec<f64>) =
            errors.iter().flatten().copied().unzip();
        if translations.len() < MIN_LOOP_CLOSURES {
            return 0;
        }
        let (metres, radians) = match S::DIMENSION {
            Dimension::TwoD => MIN_IN_PLANE,
            Dimension::ThreeD => MIN_IN_SPACE,
        };
        let translation_limit = metres.max(TIMES_MEDIAN * median(&mut translations).unwrap_or(0.0));
        let rotation_limit = radians.max(TIMES_MEDIAN * median(&mut rotations).unwrap_or(0.0));
        let mut errors = errors.iter();
        let before = self.state.constraints.len();
        self.state.constraints.retain(|_| {
            let error = errors.next().copied().flatten();
            error.is_none_or(|(metres, radians)| metres <= translation_limit && radians <= rotation_limit)
        });
        let dropped = before - self.state.constraints.len();
        self.contradicted += dropped as u64;
        dropped
    }

    /// Residual of a constraint, metres and radians, without its degenerate direction.
    pub(super) fn disagreement(&self, constraint: &Constraint) -> Option<(f64, f64)> {
        let error = self.error_of(constraint)?;
        let shift = error.translation.vector;
        let shift = constraint.open.map_or(shift, |open| open.closed_part(&shift));
        Some((shift.norm(), rotation_angle(&error)))
    }

    /// Pose of the node in the graph, relative to its pose by the constraint.
    pub(super) fn error_of(&self, constraint: &Constraint) -> Option<Rigid3> {
        let map_from_submap = self.problem.submaps.get(&constraint.submap_id)?;
        let map_from_node = self.problem.nodes.get(&constraint.node_id)?.map_from_node;
        Some(constraint.submap_from_node.inverse() * map_from_submap.inverse() * map_from_node)
    }
}
