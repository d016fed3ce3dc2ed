//! Poses in 3D as vertices.

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3};

use super::{GraphPose, InformationMatrix, may_be_pose, symmetric};
use crate::factors::{Se3BetweenInformation, Se3ErrorConvention, square_root_information};
use crate::{FactorId, Loss, Problem, ProblemError, VariableId};

impl GraphPose for Rigid3 {
    type Information = InformationMatrix<6>;
    const DIMENSION: usize = 6;
    const SPACE_DIMENSION: usize = 3;
    const ROTATION_ROWS: usize = 3;
    const TAGS: (&'static str, &'static str) = ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT");

    fn identity() -> Self {
        Rigid3::identity()
    }

    fn inverted(&self) -> Self {
        self.inverse()
    }

    fn is_finite(&self) -> bool {
        self.translation.vector.iter().chain(self.rotation.coords.iter()).all(|v| v.is_finite())
    }

    fn from_numbers(numbers: &[f64]) -> Option<(Self, bool)> {
        let &[x, y, z, qx, qy, qz, qw] = numbers else { return None };
        let q = na::Quaternion::new(qw, qx, qy, qz);
        let norm = q.norm();
        let pose = Rigid3::from_parts(na::Translation3::new(x, y, z), Quaternion::new_normalize(q));
        let good = may_be_pose(numbers) && norm > 1e-9 && pose.is_finite();
        good.then_some((pose, (norm - 1.0).abs() > 1e-3))
    }

    fn to_numbers(&self) -> Vec<f64> {
        let (t, q) = (self.translation.vector, self.rotation);
        vec![t.x, t.y, t.z, q.i, q.j, q.k, q.w]
    }

    fn information_from_upper(upper: &[f64]) -> Option<Self::Information> {
        symmetric(upper).map(InformationMatrix)
    }

    fn chi2(
        [from, to]: [&Self; 2],
        measurement: &Self,
        information: &Self::Information,
        convention: Se3ErrorConvention,
    ) -> f64 {
        let error = convention.error(&(measurement.inverse() * (from.inverse() * to)));
        (error.transpose() * information.0 * error).x
    }

    fn mean_information(information: &Self::Information) -> (f64, f64) {
        let d = information.0.diagonal();
        // The vector part of a quaternion is half the angle.
        ((d[0] + d[1] + d[2]) / 3.0, (d[3] + d[4] + d[5]) / 12.0)
    }

    fn rotation_entry(&self, i: usize, j: usize) -> f64 {
        self.rotation.to_rotation_matrix().matrix()[(i.min(2), j.min(2))]
    }

    fn translation_entry(&self, i: usize) -> f64 {
        self.translation.vector[i.min(2)]
    }

    fn with_nearest_rotation(&self, rows: &[[f64; 3]]) -> Option<Self> {
        let &[a, b, c] = rows else { return None };
        let matrix = na::Matrix3::from_rows(&[a.into(), b.into(), c.into()]);
        let svd = matrix.try_svd(true, true, f64::EPSILON, 100)?;
        let (u, v) = (svd.u?, svd.v_t?);
        // Rank two suffices: the third direction follows.
        if svd.singular_values[1] <= 1e-9 {
            return None;
        }
        let mirror = na::Vector3::new(1.0, 1.0, (u * v).determinant().signum());
        let rotation = na::Rotation3::from_matrix_unchecked(u * na::Matrix3::from_diagonal(&mirror) * v);
        Some(Self::from_parts(self.translation, Quaternion::from_rotation_matrix(&rotation)))
    }

    fn with_translation(&self, translation: &[f64; 3]) -> Self {
        Self::from_parts((*translation).into(), self.rotation)
    }

    fn add_variable(&self, problem: &mut Problem) -> VariableId {
        problem.add_se3(self)
    }

    fn read_variable(problem: &Problem, id: VariableId) -> Self {
        problem.se3(id)
    }

    fn write_variable(&self, problem: &mut Problem, id: VariableId) -> Result<(), ProblemError> {
        problem.set_values(id, &crate::sparse::se3_values(self))
    }

    fn add_edge(
        problem: &mut Problem,
        variables: [VariableId; 2],
        measurement: &Self,
        information: &Self::Information,
        convention: Se3ErrorConvention,
        loss: Loss,
    ) -> Result<(FactorId, bool), ProblemError> {
        let (root, repaired) = square_root_information(&information.0).ok_or(ProblemError::NotEvaluable)?;
        let measurement = *measurement;
        let factor =
            Se3BetweenInformation { variables, measurement, square_root_information: root, convention };
        Ok((problem.add_factor(factor, loss)?, repaired))
    }
}
