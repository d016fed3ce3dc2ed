//! What planar and spatial pose graphs have in common.

use std::fmt::Debug;
use std::ops::Mul;

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid2, Rigid3, normalize_angle};

use crate::factors::{
    Se2BetweenInformation, Se3BetweenInformation, Se3ErrorConvention, square_root_information,
};
use crate::{FactorId, Loss, Problem, ProblemError, VariableId};

/// A pose that can be a vertex: [`Rigid2`] or [`Rigid3`].
pub trait GraphPose: Copy + PartialEq + Debug + Send + Sync + 'static + Mul<Output = Self> {
    /// Symmetric matrix of the size of the error.
    type Information: Copy + PartialEq + Debug + Send + Sync + AsRef<[f64]> + 'static;
    /// Components of the error, and degrees of freedom.
    const DIMENSION: usize;
    /// Size of the rotation matrix, and components of the translation.
    const SPACE_DIMENSION: usize;
    /// Rows of a rotation matrix that determine it, and that the relaxed problem is solved for.
    const ROTATION_ROWS: usize;
    /// Tags of vertices and edges in g2o files.
    const TAGS: (&'static str, &'static str);

    /// The pose that changes nothing.
    fn identity() -> Self;
    /// The way back.
    fn inverted(&self) -> Self;
    /// Whether every number is finite.
    fn is_finite(&self) -> bool;
    /// From numbers as they stand in files; also whether they had to be normalised by much. `None` when they
    /// make up no pose.
    fn from_numbers(numbers: &[f64]) -> Option<(Self, bool)>;
    /// Numbers as they stand in files.
    fn to_numbers(&self) -> Vec<f64>;
    /// A symmetric matrix from its upper triangle, row by row.
    fn information_from_upper(upper: &[f64]) -> Option<Self::Information>;
    /// `eᵀΩe` of an edge; the convention matters in space only.
    fn chi2(
        ends: [&Self; 2],
        measurement: &Self,
        information: &Self::Information,
        convention: Se3ErrorConvention,
    ) -> f64;
    /// Mean information per component of translation and of rotation.
    fn mean_information(information: &Self::Information) -> (f64, f64);
    /// Row `i`, column `j` of the rotation matrix.
    fn rotation_entry(&self, i: usize, j: usize) -> f64;
    /// Component `i` of the translation.
    fn translation_entry(&self, i: usize) -> f64;
    /// The pose with the nearest rotation to a matrix given by its determining rows, if there is one.
    fn with_nearest_rotation(&self, rows: &[[f64; 3]]) -> Option<Self>;
    /// The pose with another translation.
    fn with_translation(&self, translation: &[f64; 3]) -> Self;
    /// Adds a vertex to a problem.
    fn add_variable(&self, problem: &mut Problem) -> VariableId;
    /// Reads a vertex from a problem.
    fn read_variable(problem: &Problem, id: VariableId) -> Self;
    /// Puts a vertex of a problem to this pose.
    fn write_variable(&self, problem: &mut Problem, id: VariableId) -> Result<(), ProblemError>;
    /// Adds an edge to a problem; also tells whether its information had to be repaired.
    fn add_edge(
        problem: &mut Problem,
        variables: [VariableId; 2],
        measurement: &Self,
        information: &Self::Information,
        convention: Se3ErrorConvention,
        loss: Loss,
    ) -> Result<(FactorId, bool), ProblemError>;
}

/// A matrix from its upper triangle, row by row, as files have it.
fn symmetric<const N: usize>(upper: &[f64]) -> Option<na::SMatrix<f64, N, N>> {
    if upper.len() != N * (N + 1) / 2 || !upper.iter().all(|v| v.is_finite()) {
        return None;
    }
    let mut matrix = na::SMatrix::zeros();
    let mut rest = upper.iter();
    for i in 0..N {
        for j in i..N {
            let value = *rest.next()?;
            matrix[(i, j)] = value;
            matrix[(j, i)] = value;
        }
    }
    Some(matrix)
}

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
        let pose = Rigid2::new(x, y, angle);
        pose.is_finite().then_some((pose, false))
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
        let good = norm.is_finite() && norm > 1e-9 && pose.is_finite();
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
        // A quaternion's vector part is half the angle.
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
        // Rank two is enough: the third direction follows.
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

/// A symmetric information matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InformationMatrix<const N: usize>(pub na::SMatrix<f64, N, N>);

impl<const N: usize> AsRef<[f64]> for InformationMatrix<N> {
    fn as_ref(&self) -> &[f64] {
        self.0.as_slice()
    }
}
