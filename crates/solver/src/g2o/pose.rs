//! Interface of poses in 2D and in 3D as vertices.

mod three_d;
mod two_d;

use std::fmt::Debug;
use std::ops::Mul;

use nalgebra as na;

use crate::factors::Se3ErrorConvention;
use crate::{FactorId, Loss, Problem, ProblemError, VariableId};

/// A pose that can be a vertex: [`Rigid2`](portolan_geometry::Rigid2) or
/// [`Rigid3`](portolan_geometry::Rigid3).
pub trait GraphPose: Copy + PartialEq + Debug + Send + Sync + 'static + Mul<Output = Self> {
    /// Symmetric matrix of the size of the error.
    type Information: Copy + PartialEq + Debug + Send + Sync + AsRef<[f64]> + 'static;
    /// Number of components of the error, which is the number of degrees of freedom.
    const DIMENSION: usize;
    /// Size of the rotation matrix, and number of components of the translation.
    const SPACE_DIMENSION: usize;
    /// Number of rows of a rotation matrix that determine it and that the relaxed problem solves for.
    const ROTATION_ROWS: usize;
    /// Tags of vertices and edges in g2o files.
    const TAGS: (&'static str, &'static str);

    /// The identity.
    fn identity() -> Self;
    /// The inverse.
    fn inverted(&self) -> Self;
    /// Whether every number is finite.
    fn is_finite(&self) -> bool;
    /// A pose from numbers as stored in files, and whether the quaternion had to be normalised by much.
    /// `None` if they are not a pose.
    fn from_numbers(numbers: &[f64]) -> Option<(Self, bool)>;
    /// Numbers as stored in files.
    fn to_numbers(&self) -> Vec<f64>;
    /// A symmetric matrix from its upper triangle, row by row.
    fn information_from_upper(upper: &[f64]) -> Option<Self::Information>;
    /// `eᵀΩe` of an edge; the convention matters in 3D only.
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
    /// The pose with the rotation nearest to a matrix given by its determining rows, if there is one.
    fn with_nearest_rotation(&self, rows: &[[f64; 3]]) -> Option<Self>;
    /// The pose with another translation.
    fn with_translation(&self, translation: &[f64; 3]) -> Self;
    /// Adds a vertex to a problem.
    fn add_variable(&self, problem: &mut Problem) -> VariableId;
    /// Reads a vertex from a problem.
    fn read_variable(problem: &Problem, id: VariableId) -> Self;
    /// Sets a vertex of a problem to this pose.
    fn write_variable(&self, problem: &mut Problem, id: VariableId) -> Result<(), ProblemError>;
    /// Adds an edge to a problem; also returns whether its information matrix had to be repaired.
    fn add_edge(
        problem: &mut Problem,
        variables: [VariableId; 2],
        measurement: &Self,
        information: &Self::Information,
        convention: Se3ErrorConvention,
        loss: Loss,
    ) -> Result<(FactorId, bool), ProblemError>;
}

/// Limit of coordinates and angles of a pose: sums along chains of edges, and their squares, stay finite.
const LARGEST: f64 = 1e100;

/// Whether the numbers of a vertex or a measurement can be a pose.
fn may_be_pose(numbers: &[f64]) -> bool {
    numbers.iter().all(|number| number.abs() <= LARGEST)
}

/// A symmetric information matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InformationMatrix<const N: usize>(pub na::SMatrix<f64, N, N>);

impl<const N: usize> AsRef<[f64]> for InformationMatrix<N> {
    fn as_ref(&self) -> &[f64] {
        self.0.as_slice()
    }
}

/// A matrix from its upper triangle, row by row, as stored in files.
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
