//! Relative poses in space.

use nalgebra as na;
use portolan_geometry::Rigid3;

use super::rotation::{inverse_left_jacobian, log, put, put_residual, read_se3, skew, vector_part_jacobian};
use crate::sparse::{Factor, VariableId};

/// A measured pose `from_from_to` with one weight for translation and one for rotation (the residual of
/// sparse pose adjustment, slam3d §9.1):
/// `( w_t (z_t − R_iᵀ(t_j − t_i)), w_r angleaxis(R_jᵀ R_i R_z) )`. Also relates a fixed frame (`from`) to a
/// node.
#[derive(Clone, Debug, PartialEq)]
pub struct Se3Between {
    /// The two poses i and j.
    pub variables: [VariableId; 2],
    /// Pose j seen from pose i.
    pub measurement: Rigid3,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
}

/// A measured relative pose with its information matrix in the convention of g2o's EDGE_SE3:QUAT:
/// `e = z⁻¹ x_i⁻¹ x_j` as (x, y, z, qx, qy, qz) with the quaternion's w ≥ 0, cost `½ eᵀΩe`. The vector part is
/// about half the rotation vector; it is not doubled.
#[derive(Clone, Debug, PartialEq)]
pub struct Se3BetweenInformation {
    /// The two poses i and j.
    pub variables: [VariableId; 2],
    /// Pose j seen from pose i.
    pub measurement: Rigid3,
    /// `S` with `SᵀS = Ω`; see [`square_root_information`](super::square_root_information).
    pub square_root_information: na::Matrix6<f64>,
}

/// Derivatives by the tangents of both poses, column by column.
pub(super) struct PairJacobians<'a> {
    pub from: &'a mut [f64],
    pub to: &'a mut [f64],
}

/// The weighted residual of sparse pose adjustment between two poses.
pub(super) fn weighted_residual(
    (from, to): (&Rigid3, &Rigid3),
    measurement: &Rigid3,
    (translation_weight, rotation_weight): (f64, f64),
    residual: &mut [f64],
    jacobians: Option<PairJacobians<'_>>,
) {
    let d = to.translation.vector - from.translation.vector;
    let from_from_map = from.rotation.inverse().to_rotation_matrix().into_inner();
    let seen = from_from_map * d;
    let error = to.rotation.inverse() * (from.rotation * measurement.rotation);
    let angle_axis = log(&error);
    put_residual(residual, 0, &((measurement.translation.vector - seen) * translation_weight));
    put_residual(residual, 3, &(angle_axis * rotation_weight));
    if let Some(PairJacobians { from, to: by_to }) = jacobians {
        let translation = from_from_map * translation_weight;
        put(from, 6, 0, 0, &translation);
        put(by_to, 6, 0, 0, &-translation);
        // Factors of two: tangents are half-angle vectors.
        put(from, 6, 0, 3, &(translation * skew(&d) * -2.0));
        let to_from_map = to.rotation.inverse().to_rotation_matrix().into_inner();
        let rotation = inverse_left_jacobian(&angle_axis) * to_from_map * (2.0 * rotation_weight);
        put(from, 6, 3, 3, &rotation);
        put(by_to, 6, 3, 3, &-rotation);
    }
}

impl Factor for Se3Between {
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
        let pair = match jacobians {
            Some([from, to]) => Some(PairJacobians { from, to }),
            _ => None,
        };
        let weights = (self.translation_weight, self.rotation_weight);
        weighted_residual((&from, &to), &self.measurement, weights, residual, pair);
        true
    }
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
        let d = to.translation.vector - from.translation.vector;
        let measured = self.measurement.rotation;
        let turned = (from.rotation * measured).inverse();
        let translation =
            turned * d - measured.inverse_transform_vector(&self.measurement.translation.vector);
        let mut rotation = turned * to.rotation;
        if rotation.w < 0.0 {
            rotation = na::Unit::new_unchecked(-rotation.into_inner());
        }
        let root = &self.square_root_information;
        let mut error = na::Vector6::zeros();
        error.fixed_rows_mut::<3>(0).copy_from(&translation);
        error.fixed_rows_mut::<3>(3).copy_from(&rotation.imag());
        residual.copy_from_slice((root * error).as_slice());
        if let Some([by_from, by_to]) = jacobians {
            let turned = turned.to_rotation_matrix().into_inner();
            let by_rotation = vector_part_jacobian(&rotation) * turned;
            let upper = root.fixed_columns::<3>(0) * turned;
            let lower = root.fixed_columns::<3>(3) * by_rotation;
            // The frame i turns about its own origin: the translation error sees it with the lever d.
            let lever: na::Matrix6x3<f64> = upper * (skew(&d) * 2.0) - lower;
            by_to[..18].copy_from_slice(upper.as_slice());
            by_to[18..].copy_from_slice(lower.as_slice());
            by_from[..18].copy_from_slice((-upper).as_slice());
            by_from[18..].copy_from_slice(lever.as_slice());
        }
        true
    }
}

/// The error of [`Se3BetweenInformation`] before weighting.
pub(crate) fn se3_error(from: &Rigid3, to: &Rigid3, measurement: &Rigid3) -> na::Vector6<f64> {
    let error = measurement.inverse() * (from.inverse() * to);
    let q = error.rotation.quaternion();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let (t, v) = (error.translation.vector, q.imag() * sign);
    na::Vector6::new(t.x, t.y, t.z, v.x, v.y, v.z)
}
