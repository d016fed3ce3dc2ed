//! Finds degenerate directions: those in which all information of a scan may be spurious.

use nalgebra as na;
use portolan_geometry::Vector3;
use portolan_motion::DegenerateDirections;

use super::normal_equations::NormalEquations;

/// The eigenvectors of the translational and the rotational half of the information that errors of normals
/// alone could explain (Zhang, Kaess and Singh, "On degeneracy of optimization-based state estimation
/// problems", 2016). In a direction that no plane faces, n·d is the error of the normal; about an axis
/// that nothing constrains, (p × n)·d is that error times the distance of p from the axis. Unreliable
/// planes do not count as constraints here.
pub(super) fn degenerate_directions(equations: &NormalEquations) -> DegenerateDirections {
    let degenerate = |at: usize, spurious: &na::Matrix3<f64>| -> Vec<Vector3> {
        let half = equations.hessian.fixed_view::<3, 3>(at, at) - equations.unreliable[at / 3];
        let eigen = na::SymmetricEigen::new(half);
        let directions = (0..3).map(|i| (eigen.eigenvalues[i], eigen.eigenvectors.column(i).into_owned()));
        let is_degenerate = |(value, d): &(f64, Vector3)| *value <= d.dot(&(spurious * d));
        directions.filter(is_degenerate).map(|(_, direction)| direction).collect()
    };
    let spurious_translation = na::Matrix3::from_diagonal_element(equations.spurious_translation);
    DegenerateDirections {
        translations: degenerate(0, &spurious_translation),
        rotations: degenerate(3, &equations.spurious_rotation),
    }
}
