//! Relative poses in 3D.

use portolan_geometry::Rigid3;

use super::rotation::{inverse_left_jacobian, log, put, put_residual, read_se3, skew};
use crate::sparse::{Factor, VariableId};

/// A measured pose `from_from_to` with one weight for translation and one for rotation (the residual of
/// sparse pose adjustment, slam3d §9.1): `( w_t (z_t − R_iᵀ(t_j − t_i)), w_r angleaxis(R_jᵀ R_i R_z) )`. It
/// can also relate a fixed frame (`from`) to a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Se3Between {
    /// The two poses i and j.
    pub variables: [VariableId; 2],
    /// Pose of j in the frame of i.
    pub measurement: Rigid3,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
}

/// Derivatives with respect to the tangents of both poses, column by column.
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
