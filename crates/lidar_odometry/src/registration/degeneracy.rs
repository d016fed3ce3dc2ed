//! Degenerate directions: those in which the information of a scan could as well be spurious.

use nalgebra as na;
use portolan_geometry::Vector3;

use super::normal_equations::NormalEquations;

/// Unit vectors of the directions that a scan does not constrain, in the frame of the planes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DegenerateDirections {
    /// Translations along these are not constrained.
    pub translations: Vec<Vector3>,
    /// Rotations about these are not constrained.
    pub rotations: Vec<Vector3>,
}

impl DegenerateDirections {
    /// Whether the scan constrains all directions.
    pub fn is_empty(&self) -> bool {
        self.translations.is_empty() && self.rotations.is_empty()
    }

    /// The eigenvectors of both halves of the information that errors of normals alone could explain (Zhang, Kaess and
    /// Singh, "On degeneracy of optimization-based state estimation problems", 2016). In a direction in which no plane
    /// faces, n·d is the error of the normal; about an axis about which nothing can turn, (p × n)·d is that error times
    /// the distance of p from the axis. Unreliable planes constrain nothing here.
    pub(super) fn of(equations: &NormalEquations) -> Self {
        let degenerate = |at: usize, spurious: &na::Matrix3<f64>| -> Vec<Vector3> {
            let half = equations.hessian.fixed_view::<3, 3>(at, at) - equations.unreliable[at / 3];
            let eigen = na::SymmetricEigen::new(half);
            let directions =
                (0..3).map(|i| (eigen.eigenvalues[i], eigen.eigenvectors.column(i).into_owned()));
            let is_degenerate = |(value, d): &(f64, Vector3)| *value <= d.dot(&(spurious * d));
            directions.filter(is_degenerate).map(|(_, direction)| direction).collect()
        };
        let spurious_translation = na::Matrix3::from_diagonal_element(equations.spurious_translation);
        Self {
            translations: degenerate(0, &spurious_translation),
            rotations: degenerate(3, &equations.spurious_rotation),
        }
    }
}
