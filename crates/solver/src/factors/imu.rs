//! IMU factors between consecutive nodes (slam3d §8).

use portolan_geometry::{Quaternion, Vector3};

use super::rotation::{Matrix3, put, put_residual, read_rotation, read_se3, skew, vector_part_jacobian};
use crate::sparse::{Factor, VariableId};

/// Rotation integrated between two nodes: `w vec( R_2* R_1 C ΔR C* )`, where C is the calibrated rotation
/// tracking_from_imu.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuRotation {
    /// First node, second node (poses in 3D), IMU calibration (rotation).
    pub variables: [VariableId; 3],
    /// Integrated rotation from the first to the second node, in the IMU's frame: first_from_second.
    pub first_from_second: Quaternion,
    /// Weight of the residual.
    pub weight: f64,
}

/// Change of velocity between the middles of two intervals:
/// `w ( R_2 C Δv − g ½(Δ1+Δ2) e_z − ((p3−p2)/Δ2 − (p2−p1)/Δ1) )`.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuAcceleration {
    /// First, second, third node (poses in 3D), gravity (scalar), IMU calibration (rotation).
    pub variables: [VariableId; 5],
    /// Integrated specific force between the middles of the intervals, in the IMU's frame at the second
    /// node, m/s.
    pub delta_velocity_in_second: Vector3,
    /// Seconds from the first to the second node; positive.
    pub first_duration: f64,
    /// Seconds from the second to the third node; positive.
    pub second_duration: f64,
    /// Weight of the residual, s/m.
    pub weight: f64,
}

impl Factor for ImuRotation {
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
        let &[first, second, calibration] = parameters else { return false };
        let (Some(first), Some(second)) = (read_se3(first), read_se3(second)) else { return false };
        let Some(calibration) = read_rotation(calibration) else { return false };
        let seen = second.rotation.inverse() * first.rotation;
        let turned = calibration * self.first_from_second * calibration.inverse();
        let error = seen * turned;
        put_residual(residual, 0, &(error.imag() * self.weight));
        if let Some([by_first, by_second, by_calibration]) = jacobians {
            let by_left_turn = vector_part_jacobian(&error) * self.weight;
            let second_from_map = second.rotation.inverse().to_rotation_matrix().into_inner();
            put(by_first, 3, 0, 3, &(by_left_turn * second_from_map));
            put(by_second, 3, 0, 3, &(by_left_turn * second_from_map * -1.0));
            // exp(δ) C ΔR C* exp(−δ): a rotation on the right becomes one on the left, transformed by the
            // rotation.
            let seen = seen.to_rotation_matrix().into_inner();
            let through = turned.to_rotation_matrix().into_inner();
            put(by_calibration, 3, 0, 0, &(by_left_turn * seen * (Matrix3::identity() - through)));
        }
        true
    }
}

impl Factor for ImuAcceleration {
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
        let &[first, second, third, gravity, calibration] = parameters else { return false };
        let (Some(first), Some(second), Some(third)) = (read_se3(first), read_se3(second), read_se3(third))
        else {
            return false;
        };
        let (Some(gravity), Some(calibration)) = (gravity.first(), read_rotation(calibration)) else {
            return false;
        };
        let in_second = calibration * self.delta_velocity_in_second;
        let imu = second.rotation * in_second;
        let middle = 0.5 * (self.first_duration + self.second_duration);
        let before = (second.translation.vector - first.translation.vector) / self.first_duration;
        let after = (third.translation.vector - second.translation.vector) / self.second_duration;
        let error = imu - Vector3::z() * (gravity * middle) - (after - before);
        put_residual(residual, 0, &(error * self.weight));
        if let Some([by_first, by_second, by_third, by_gravity, by_calibration]) = jacobians {
            let w = self.weight;
            let (v1, v2) = (w / self.first_duration, w / self.second_duration);
            put(by_first, 3, 0, 0, &(Matrix3::identity() * -v1));
            put(by_second, 3, 0, 0, &(Matrix3::identity() * (v1 + v2)));
            put(by_second, 3, 0, 3, &(skew(&imu) * (-2.0 * w)));
            put(by_third, 3, 0, 0, &(Matrix3::identity() * -v2));
            by_gravity.copy_from_slice(&[0.0, 0.0, -w * middle]);
            let rotation = second.rotation.to_rotation_matrix().into_inner();
            put(by_calibration, 3, 0, 0, &(rotation * skew(&in_second) * (-2.0 * w)));
        }
        true
    }
}
