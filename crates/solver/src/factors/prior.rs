//! Prior factors on one variable.

use nalgebra as na;
use portolan_geometry::{Quaternion, Rigid2, Rigid3, Vector3, normalize_angle};

use super::rotation::{Matrix3, put, put_residual, read_rotation, read_se2, read_se3, vector_part_jacobian};
use crate::sparse::{Factor, VariableId};

/// Prior on a 2D pose: `( w_t (t − t*), w_r norm(θ − θ*) )`.
#[derive(Clone, Debug, PartialEq)]
pub struct Se2Prior {
    /// The 2D pose.
    pub variable: VariableId,
    /// Prior value.
    pub pose: Rigid2,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
}

/// Prior on a pose: `( w_t (t − t*), 2 w_r vec(q*⁻¹ ⊗ q) )`. The sign of the quaternion is chosen with w ≥ 0,
/// so that the rotation residual is approximately the rotation vector in the frame of the prior.
#[derive(Clone, Debug, PartialEq)]
pub struct Se3Prior {
    /// The pose.
    pub variable: VariableId,
    /// Prior value.
    pub pose: Rigid3,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
}

/// Prior on a rotation: `2 w vec(q*⁻¹ ⊗ q)`. The sign of the quaternion is chosen with w ≥ 0, so that the
/// residual is approximately the rotation vector in the frame of the prior.
#[derive(Clone, Debug, PartialEq)]
pub struct RotationPrior {
    /// The rotation.
    pub variable: VariableId,
    /// Prior value.
    pub rotation: Quaternion,
    /// Weight of the residual, 1/rad.
    pub weight: f64,
}

/// Prior on up to four numbers of a Euclidean, 2D or scalar variable: `w (x − x*)`.
#[derive(Clone, Debug, PartialEq)]
pub struct EuclideanPrior {
    /// The variable.
    pub variable: VariableId,
    /// Prior value; as many numbers as the variable has.
    pub target: na::Vector4<f64>,
    /// Number of components of `target` that are used.
    pub dimension: usize,
    /// Weight of every component.
    pub weight: f64,
}

impl Factor for Se2Prior {
    fn variables(&self) -> &[VariableId] {
        std::slice::from_ref(&self.variable)
    }

    fn residual_dimension(&self) -> usize {
        3
    }

    fn evaluate(
        &self,
        parameters: &[&[f64]],
        residual: &mut [f64],
        jacobians: Option<&mut [&mut [f64]]>,
    ) -> bool {
        let Some(pose) = parameters.first().and_then(|p| read_se2(p)) else { return false };
        let (t, r) = (self.translation_weight, self.rotation_weight);
        let d = (pose.translation - self.pose.translation) * t;
        residual.copy_from_slice(&[d.x, d.y, normalize_angle(pose.angle - self.pose.angle) * r]);
        if let Some([jacobian]) = jacobians {
            put(jacobian, 3, 0, 0, &na::Matrix3::from_diagonal(&na::Vector3::new(t, t, r)));
        }
        true
    }
}

impl Factor for Se3Prior {
    fn variables(&self) -> &[VariableId] {
        std::slice::from_ref(&self.variable)
    }

    fn residual_dimension(&self) -> usize {
        6
    }

    fn evaluate(
        &self,
        parameters: &[&[f64]],
        residual: &mut [f64],
        jacobians: Option<&mut [&mut [f64]]>,
    ) -> bool {
        let Some(pose) = parameters.first().and_then(|p| read_se3(p)) else { return false };
        let (turn, by_rotation) = turn_between(&self.pose.rotation, &pose.rotation, self.rotation_weight);
        let translation = pose.translation.vector - self.pose.translation.vector;
        put_residual(residual, 0, &(translation * self.translation_weight));
        put_residual(residual, 3, &turn);
        if let Some([jacobian]) = jacobians {
            put(jacobian, 6, 0, 0, &(na::Matrix3::identity() * self.translation_weight));
            put(jacobian, 6, 3, 3, &by_rotation);
        }
        true
    }
}

/// Twice the weighted vector part of the rotation from `from` to `to`, and its derivative with respect to
/// `to`.
fn turn_between(from: &Quaternion, to: &Quaternion, weight: f64) -> (Vector3, Matrix3) {
    let mut error = from.inverse() * to;
    if error.w < 0.0 {
        error = na::Unit::new_unchecked(-error.into_inner());
    }
    let turned = from.inverse().to_rotation_matrix().into_inner();
    (error.imag() * (2.0 * weight), vector_part_jacobian(&error) * turned * (2.0 * weight))
}

impl Factor for RotationPrior {
    fn variables(&self) -> &[VariableId] {
        std::slice::from_ref(&self.variable)
    }

    fn residual_dimension(&self) -> usize {
        3
    }

    fn evaluate(
        &self,
        parameters: &[&[f64]],
        residual: &mut [f64],
        jacobians: Option<&mut [&mut [f64]]>,
    ) -> bool {
        let Some(rotation) = parameters.first().and_then(|p| read_rotation(p)) else { return false };
        let (turn, by_rotation) = turn_between(&self.rotation, &rotation, self.weight);
        put_residual(residual, 0, &turn);
        if let Some([jacobian]) = jacobians {
            put(jacobian, 3, 0, 0, &by_rotation);
        }
        true
    }
}

impl Factor for EuclideanPrior {
    fn variables(&self) -> &[VariableId] {
        std::slice::from_ref(&self.variable)
    }

    fn residual_dimension(&self) -> usize {
        self.dimension.min(4)
    }

    fn evaluate(
        &self,
        parameters: &[&[f64]],
        residual: &mut [f64],
        jacobians: Option<&mut [&mut [f64]]>,
    ) -> bool {
        let Some(x) = parameters.first().filter(|x| x.len() == self.residual_dimension()) else {
            return false;
        };
        for ((r, x), target) in residual.iter_mut().zip(*x).zip(&self.target) {
            *r = self.weight * (x - target);
        }
        if let Some([jacobian]) = jacobians {
            let stride = self.residual_dimension() + 1;
            jacobian.iter_mut().step_by(stride).for_each(|v| *v = self.weight);
        }
        true
    }
}
