//! Poses in 2D as vertices.

use nalgebra as na;
use portolan_geometry::{Rigid2, normalize_angle};

use super::{GraphPose, InformationMatrix, may_be_pose, symmetric};
use crate::factors::{Se2BetweenInformation, Se3ErrorConvention, square_root_information};
use crate::{FactorId, Loss, Problem, ProblemError, VariableId};

impl GraphPose for Rigid2 {
    type Information = InformationMatrix<3>;
    const DIMENSION: usize = 3;
    const SPACE_DIMENSION: usize = 2;
    // The second row follows from the first.
    const ROTATION_ROWS: usize = 1;
    const TAGS: (&'static str, &'static str) = ("VERTEX_SE2", "EDGE_SE2");

    fn identity() -> Self {
        Rigid2::identity()
    }

    fn inverted(&self) -> Self {
        self.inverse()
    }

    fn is_finite(&self) -> bool {
        Rigid2::is_finite(self)
    }

    fn from_numbers(numbers: &[f64]) -> Option<(Self, bool)> {
        let &[x, y, angle] = numbers else { return None };
        may_be_pose(numbers).then_some((Rigid2::new(x, y, angle), false))
    }

    fn to_numbers(&self) -> Vec<f64> {
        vec![self.translation.x, self.translation.y, self.angle]
    }

    fn information_from_upper(upper: &[f64]) -> Option<Self::Information> {
        symmetric(upper).map(InformationMatrix)
    }

    fn chi2(
        [from, to]: [&Self; 2],
        measurement: &Self,
        information: &Self::Information,
        _: Se3ErrorConvention,
    ) -> f64 {
        let error = measurement.inverse() * (from.inverse() * *to);
        let angle = normalize_angle(error.angle);
        let error = na::Vector3::new(error.translation.x, error.translation.y, angle);
        (error.transpose() * information.0 * error).x
    }

    fn mean_information(information: &Self::Information) -> (f64, f64) {
        let d = information.0.diagonal();
        ((d[0] + d[1]) / 2.0, d[2])
    }

    fn rotation_entry(&self, i: usize, j: usize) -> f64 {
        let (s, c) = self.angle.sin_cos();
        [[c, -s], [s, c]][i.min(1)][j.min(1)]
    }

    fn translation_entry(&self, i: usize) -> f64 {
        self.translation[i.min(1)]
    }

    fn with_nearest_rotation(&self, rows: &[[f64; 3]]) -> Option<Self> {
        let [c, minus_s, _] = *rows.first()?;
        // Without a direction there is no angle.
        let known = c.hypot(minus_s) > 1e-9;
        known.then(|| Self { translation: self.translation, angle: (-minus_s).atan2(c) })
    }

    fn with_translation(&self, translation: &[f64; 3]) -> Self {
        Self::new(translation[0], translation[1], self.angle)
    }

    fn add_variable(&self, problem: &mut Problem) -> VariableId {
        problem.add_se2(self)
    }

    fn read_variable(problem: &Problem, id: VariableId) -> Self {
        problem.se2(id)
    }

    fn write_variable(&self, problem: &mut Problem, id: VariableId) -> Result<(), ProblemError> {
        problem.set_values(id, &self.to_numbers())
    }

    fn add_edge(
        problem: &mut Problem,
        variables: [VariableId; 2],
        measurement: &Self,
        information: &Self::Information,
        _: Se3ErrorConvention,
        loss: Loss,
    ) -> Result<(FactorId, bool), ProblemError> {
        let (root, repaired) = square_root_information(&information.0).ok_or(ProblemError::NotEvaluable)?;
        let factor =
            Se2BetweenInformation { variables, measurement: *measurement, square_root_information: root };
        Ok((problem.add_factor(factor, loss)?, repaired))
    }
}
