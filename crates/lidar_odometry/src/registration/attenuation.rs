//! Attenuation: errors of normals act as information, so that translations come out too small by the
//! spurious fraction of it (Fuller, "Measurement Error Models", 1987, section 1.1), and planes hold the
//! scanner at its old position.

use nalgebra as na;
use portolan_geometry::Vector3;

use super::normal_equations::NormalEquations;
use crate::plane_map::PlaneMap;

/// Position error by attenuation.
pub(super) struct Attenuation {
    /// Unit vectors as columns, in the frame of the planes.
    directions: na::Matrix3<f64>,
    /// Variance along each, m².
    variances: Vector3,
}

impl Attenuation {
    /// Computed from the eigenvalues of the reliable information.
    pub fn of(equations: &NormalEquations, planes: &PlaneMap) -> Self {
        let reliable =
            na::SymmetricEigen::new(equations.hessian.fixed_view::<3, 3>(0, 0) - equations.unreliable[0]);
        // Where errors of normals are the only constraint of a translation, planes hold the scanner off
        // its true position by the range noise: beyond this displacement other planes are seen. The error
        // is at most a voxel, beyond which points are paired with other planes.
        let (distance, most) = (planes.settings().range_noise, f64::from(planes.edge()));
        let variance = |information: f64| {
            (distance * equations.spurious_translation / information.max(f64::MIN_POSITIVE)).min(most).powi(2)
        };
        Self { directions: reliable.eigenvectors, variances: reliable.eigenvalues.map(variance) }
    }

    pub fn covariance(&self) -> na::Matrix3<f64> {
        self.directions * na::Matrix3::from_diagonal(&self.variances) * self.directions.transpose()
    }

    /// Factor by which a prior is stiffened next to points of this information (1/m²), compared with no
    /// attenuation.
    pub fn stiffening(&self, information: &na::Matrix3<f64>) -> na::Matrix3<f64> {
        let columns = self.directions.column_iter().zip(&self.variances);
        columns.fold(na::Matrix3::identity(), |sum, (direction, variance)| {
            sum + direction * direction.transpose() * (direction.dot(&(information * direction)) * variance)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attenuation_follows_from_spurious_information() {
        let planes = PlaneMap::new(1.0);
        let (distance, most) = (planes.settings().range_noise, f64::from(planes.edge()));
        let mut equations = NormalEquations { spurious_translation: 10.0, ..NormalEquations::default() };
        equations.hessian.fixed_view_mut::<3, 3>(0, 0).set_diagonal(&na::Vector3::new(1e5, 20.0, 0.0));
        let attenuation = Attenuation::of(&equations, &planes);
        let covariance = attenuation.covariance();
        let expected = [distance * 1e-4, distance * 0.5, most].map(|error| error * error);
        assert!((covariance.diagonal() - na::Vector3::from(expected)).norm() < 1e-9, "{covariance}");
        // Points whose information is twice the spurious part weigh as much as a prior of the same error.
        let information = na::Matrix3::from_diagonal_element((distance * 0.5).powi(-2));
        let stiffer = attenuation.stiffening(&information);
        assert!((stiffer[(1, 1)] - 2.0).abs() < 1e-9 && (stiffer[(0, 0)] - 1.0).abs() < 1e-6, "{stiffer}");
    }
}
