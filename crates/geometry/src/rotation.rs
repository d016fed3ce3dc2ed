//! Rotations: exponential map, yaw, roll-pitch-yaw, minimal rotations.

use nalgebra as na;

use crate::{Quaternion, Vector3};

/// The direction in the xy plane to which the rotation takes the x axis, in (−π, π].
pub fn yaw(rotation: &Quaternion) -> f64 {
    let direction = rotation * Vector3::x();
    direction.y.atan2(direction.x)
}

/// The rotation by `‖v‖` about `v` (exponential map of SO(3)).
pub fn quaternion_from_angle_axis(v: &Vector3) -> Quaternion {
    let squared = v.norm_squared();
    let (w, scale) = if squared > 1e-8 {
        let norm = squared.sqrt();
        ((norm / 2.0).cos(), (norm / 2.0).sin() / norm)
    } else {
        (1.0, 0.5)
    };
    let xyz = v * scale;
    Quaternion::new_normalize(na::Quaternion::new(w, xyz.x, xyz.y, xyz.z))
}

/// The rotation vector of a rotation (logarithm of SO(3)), of length at most π.
pub fn angle_axis_from_quaternion(rotation: &Quaternion) -> Vector3 {
    let q = if rotation.w < 0.0 { -rotation.quaternion() } else { *rotation.quaternion() };
    let angle = 2.0 * q.vector().norm().atan2(q.w);
    let scale = if angle < 1e-7 { 2.0 } else { angle / (angle / 2.0).sin() };
    q.vector() * scale
}

/// The angle between two rotations, in [0, π].
pub fn angular_distance(a: &Quaternion, b: &Quaternion) -> f64 {
    angle_axis_from_quaternion(&(a.inverse() * b)).norm()
}

/// `Rz(yaw) Ry(pitch) Rx(roll)`.
pub fn rotation_from_roll_pitch_yaw(roll: f64, pitch: f64, yaw: f64) -> Quaternion {
    Quaternion::from_axis_angle(&Vector3::z_axis(), yaw)
        * Quaternion::from_axis_angle(&Vector3::y_axis(), pitch)
        * Quaternion::from_axis_angle(&Vector3::x_axis(), roll)
}

/// The inverse of [`rotation_from_roll_pitch_yaw`].
pub fn roll_pitch_yaw(rotation: &Quaternion) -> (f64, f64, f64) {
    rotation.euler_angles()
}

/// The smallest rotation that takes direction `from` to direction `to`. The identity if one of them has no
/// direction; half a revolution about some perpendicular axis if they are opposite.
pub fn rotation_between(from: &Vector3, to: &Vector3) -> Quaternion {
    let (Some(a), Some(b)) = (from.try_normalize(0.0), to.try_normalize(0.0)) else {
        return Quaternion::identity();
    };
    let cosine = a.dot(&b);
    if cosine < -1.0 + 1e-12 {
        let helper = if a.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        let axis = na::Unit::new_normalize(a.cross(&helper));
        return Quaternion::from_axis_angle(&axis, std::f64::consts::PI);
    }
    let axis = a.cross(&b);
    Quaternion::new_normalize(na::Quaternion::new(1.0 + cosine, axis.x, axis.y, axis.z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn yaw_is_measured_on_the_rotated_x_axis() {
        let rotation = rotation_from_roll_pitch_yaw(0.6789, 0.4321, 1.2345);
        assert!((yaw(&rotation) - 1.2345).abs() < 1e-9);
        let flat = rotation_from_roll_pitch_yaw(0.0, 0.0, 1.2345);
        assert!((yaw(&flat.inverse()) + 1.2345).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn exp_and_log_are_inverse(x in -1.8..1.8, y in -1.8..1.8, z in -1.8..1.8) {
            let v = Vector3::new(x, y, z);
            let back = angle_axis_from_quaternion(&quaternion_from_angle_axis(&v));
            prop_assert!((back - v).norm() < 1e-7);
        }

        #[test]
        fn minimal_rotation_reaches_its_target(a in prop::array::uniform3(-1.0..1.0f64), b in prop::array::uniform3(-1.0..1.0f64)) {
            let (a, b) = (Vector3::from(a), Vector3::from(b));
            prop_assume!(a.norm() > 1e-3 && b.norm() > 1e-3);
            let r = rotation_between(&a, &b);
            prop_assert!(((r * a).normalize() - b.normalize()).norm() < 1e-6);
            let back = rotation_between(&b, &a) * r;
            prop_assert!(back.angle() < 1e-5);
        }
    }
}
