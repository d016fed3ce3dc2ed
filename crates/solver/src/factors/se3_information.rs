//! Relative poses in 3D with a full information matrix.

use nalgebra as na;
use portolan_geometry::{Rigid3, Vector3};

use super::rotation::{Matrix3, inverse_left_jacobian, log, read_se3, skew, vector_part_jacobian};
use crate::sparse::{Factor, VariableId};

/// How the difference `E = z⁻¹ x_i⁻¹ x_j` between measured and estimated relative pose, with rotation R and
/// translation t, is mapped to six numbers. The conventions agree to first order except for a factor of two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Se3ErrorConvention {
    /// The logarithm of SE(3), `(V⁻¹ t, log R)`: translation along the screw motion, rotation vector.
    /// Information in 1/rad². Default: the published optima of the standard graphs use this convention.
    #[default]
    Logarithm,
    /// `(t, 2 vec(q))` with w ≥ 0: nearly the rotation vector, but large errors have less weight.
    DoubledQuaternion,
    /// `(t, vec(q))` with w ≥ 0: the error of EDGE_SE3:QUAT in the program g2o. Rotations have a quarter of
    /// their weight in the other conventions.
    Quaternion,
}

/// A measured relative pose with its information matrix, ordered (translation, rotation); cost `½ eᵀΩe`.
#[derive(Clone, Debug, PartialEq)]
pub struct Se3BetweenInformation {
    /// The two poses i and j.
    pub variables: [VariableId; 2],
    /// Pose of j in the frame of i.
    pub measurement: Rigid3,
    /// `S` with `SᵀS = Ω`; see [`square_root_information`](super::square_root_information).
    pub square_root_information: na::Matrix6<f64>,
    /// Definition of e.
    pub convention: Se3ErrorConvention,
}

/// An error of six numbers, with derivatives with respect to the translation of the difference and to a
/// half-angle rotation of it from the left.
struct Error {
    value: na::Vector6<f64>,
    by_translation: na::Matrix6x3<f64>,
    by_turn: na::Matrix6x3<f64>,
}

impl Se3ErrorConvention {
    /// The error for a difference of poses.
    pub fn error(self, difference: &Rigid3) -> na::Vector6<f64> {
        let t = difference.translation.vector;
        let (translation, rotation) = match self {
            Self::Logarithm => {
                let phi = log(&difference.rotation);
                (inverse_left_jacobian(&phi) * t, phi)
            }
            Self::DoubledQuaternion => (t, vector_part(difference) * 2.0),
            Self::Quaternion => (t, vector_part(difference)),
        };
        stack(&translation, &rotation)
    }

    fn linearize(self, difference: &Rigid3) -> Error {
        let value = self.error(difference);
        let (mut by_translation, mut by_turn) = (na::Matrix6x3::zeros(), na::Matrix6x3::zeros());
        let (upper, lower) = match self {
            Self::Logarithm => {
                let phi = log(&difference.rotation);
                let inverse = inverse_left_jacobian(&phi);
                let by_turn_of_phi = inverse * 2.0;
                by_turn.fixed_rows_mut::<3>(0).copy_from(
                    &(inverse_jacobian_change(&phi, &difference.translation.vector) * by_turn_of_phi),
                );
                (inverse, by_turn_of_phi)
            }
            Self::DoubledQuaternion => (Matrix3::identity(), signed_vector_jacobian(difference) * 2.0),
            Self::Quaternion => (Matrix3::identity(), signed_vector_jacobian(difference)),
        };
        by_translation.fixed_rows_mut::<3>(0).copy_from(&upper);
        by_turn.fixed_rows_mut::<3>(3).copy_from(&lower);
        Error { value, by_translation, by_turn }
    }
}

fn stack(upper: &Vector3, lower: &Vector3) -> na::Vector6<f64> {
    na::Vector6::new(upper.x, upper.y, upper.z, lower.x, lower.y, lower.z)
}

fn vector_part(difference: &Rigid3) -> Vector3 {
    let q = difference.rotation;
    if q.w < 0.0 { -q.imag() } else { q.imag() }
}

fn signed_vector_jacobian(difference: &Rigid3) -> Matrix3 {
    let by_turn = vector_part_jacobian(&difference.rotation);
    if difference.rotation.w < 0.0 { -by_turn } else { by_turn }
}

/// `∂(Jl⁻¹(φ) t)/∂φ`, from `Jl⁻¹(φ) t = t − ½ φ×t + c(θ) φ×(φ×t)` with
/// `c = 1/θ² − cot(θ/2)/(2θ)`.
fn inverse_jacobian_change(phi: &Vector3, t: &Vector3) -> Matrix3 {
    let squared = phi.norm_squared();
    let (c, slope) = if squared < 1e-4 {
        (1.0 / 12.0 + squared / 720.0, 1.0 / 360.0 + squared / 7560.0)
    } else {
        let theta = squared.sqrt();
        let (s, cot) = ((theta / 2.0).sin(), 1.0 / (theta / 2.0).tan());
        let c = 1.0 / squared - cot / (2.0 * theta);
        let derivative = -2.0 / (squared * theta) + cot / (2.0 * squared) + 1.0 / (4.0 * theta * s * s);
        (c, derivative / theta)
    };
    let cross = phi.cross(t);
    phi.cross(&cross) * phi.transpose() * slope + skew(t) * 0.5 - (skew(&cross) + skew(phi) * skew(t)) * c
}

impl Factor for Se3BetweenInformation {
    fn variables(&self) -> &[VariableId] {
        &self.variables
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
        let &[from, to] = parameters else { return false };
        let (Some(from), Some(to)) = (read_se3(from), read_se3(to)) else { return false };
        let root = &self.square_root_information;
        let d = to.translation.vector - from.translation.vector;
        let measured = self.measurement.rotation;
        let turned = (from.rotation * measured).inverse();
        let t = turned * d - measured.inverse_transform_vector(&self.measurement.translation.vector);
        let difference = Rigid3::from_parts(t.into(), turned * to.rotation);
        let Some([by_from, by_to]) = jacobians else {
            residual.copy_from_slice((root * self.convention.error(&difference)).as_slice());
            return true;
        };
        let error = self.convention.linearize(&difference);
        residual.copy_from_slice((root * error.value).as_slice());
        let turned = turned.to_rotation_matrix().into_inner();
        let by_translation = root * (error.by_translation * turned);
        let by_turn = root * (error.by_turn * turned);
        // A rotation of the frame i moves j about the origin of i, with the lever arm d.
        let by_turn_of_from = by_translation * (skew(&d) * 2.0) - by_turn;
        by_to[..18].copy_from_slice(by_translation.as_slice());
        by_to[18..].copy_from_slice(by_turn.as_slice());
        by_from[..18].copy_from_slice((-by_translation).as_slice());
        by_from[18..].copy_from_slice(by_turn_of_from.as_slice());
        true
    }
}
