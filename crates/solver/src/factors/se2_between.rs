//! Relative poses in 2D.

use nalgebra as na;
use portolan_geometry::{Rigid2, normalize_angle};

use super::rotation::{Matrix3, read_se2};
use crate::sparse::{Factor, VariableId};

/// A measured pose `from_from_to` with one weight for translation and one for rotation (the residual of
/// sparse pose adjustment, slam2d §14.6): `( w_t (z_xy − R(θ_i)ᵀ(t_j − t_i)), w_r norm(z_θ − (θ_j − θ_i)) )`.
/// It can also relate a fixed frame (`from`) to a node.
#[derive(Clone, Debug, PartialEq)]
pub struct Se2Between {
    /// The two poses i and j.
    pub variables: [VariableId; 2],
    /// Pose of j in the frame of i.
    pub measurement: Rigid2,
    /// Weight of the translation residual, 1/m.
    pub translation_weight: f64,
    /// Weight of the rotation residual, 1/rad.
    pub rotation_weight: f64,
}

/// A measured relative pose with its information matrix in the convention of g2o's EDGE_SE2:
/// `e = z⁻¹ (x_i⁻¹ x_j)` as (x, y, θ), cost `½ eᵀΩe`.
#[derive(Clone, Debug, PartialEq)]
pub struct Se2BetweenInformation {
    /// The two poses i and j.
    pub variables: [VariableId; 2],
    /// Pose of j in the frame of i.
    pub measurement: Rigid2,
    /// `S` with `SᵀS = Ω`; see [`square_root_information`](super::square_root_information).
    pub square_root_information: Matrix3,
}

/// Pose of j in the frame of i, with derivatives with respect to both as columns (x, y, θ).
struct Relative {
    translation: na::Vector2<f64>,
    angle: f64,
    by_from: Matrix3,
    by_to: Matrix3,
}

fn relative(from: &Rigid2, to: &Rigid2) -> Relative {
    let (s, c) = from.angle.sin_cos();
    let d = to.translation - from.translation;
    let translation = na::Vector2::new(c * d.x + s * d.y, c * d.y - s * d.x);
    let (x, y) = (translation.x, translation.y);
    Relative {
        translation,
        angle: to.angle - from.angle,
        by_from: Matrix3::new(-c, -s, y, s, -c, -x, 0.0, 0.0, -1.0),
        by_to: Matrix3::new(c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0),
    }
}

/// Reads both poses and writes the derivatives of `linear · relative pose`.
fn write_jacobians(jacobians: Option<&mut [&mut [f64]]>, linear: &Matrix3, relative: &Relative) {
    if let Some([from, to]) = jacobians {
        from.copy_from_slice((linear * relative.by_from).as_slice());
        to.copy_from_slice((linear * relative.by_to).as_slice());
    }
}

impl Factor for Se2Between {
    fn variables(&self) -> &[VariableId] {
        &self.variables
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
        let &[from, to] = parameters else { return false };
        let (Some(from), Some(to)) = (read_se2(from), read_se2(to)) else { return false };
        let relative = relative(&from, &to);
        let translation = (self.measurement.translation - relative.translation) * self.translation_weight;
        let angle = normalize_angle(self.measurement.angle - relative.angle) * self.rotation_weight;
        residual.copy_from_slice(&[translation.x, translation.y, angle]);
        let (t, r) = (-self.translation_weight, -self.rotation_weight);
        write_jacobians(jacobians, &Matrix3::from_diagonal(&na::Vector3::new(t, t, r)), &relative);
        true
    }
}

impl Factor for Se2BetweenInformation {
    fn variables(&self) -> &[VariableId] {
        &self.variables
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
        let &[from, to] = parameters else { return false };
        let (Some(from), Some(to)) = (read_se2(from), read_se2(to)) else { return false };
        let relative = relative(&from, &to);
        let (s, c) = self.measurement.angle.sin_cos();
        // The difference of translations is rotated into the frame of the measured pose j.
        let turn = Matrix3::new(c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0);
        let translation = relative.translation - self.measurement.translation;
        let angle = normalize_angle(relative.angle - self.measurement.angle);
        let linear = self.square_root_information * turn;
        let error = linear * na::Vector3::new(translation.x, translation.y, angle);
        residual.copy_from_slice(error.as_slice());
        write_jacobians(jacobians, &linear, &relative);
        true
    }
}
