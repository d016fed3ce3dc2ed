//! Rigid transforms in three dimensions. The product is nalgebra's; callers that build long chains
//! renormalise them.

use nalgebra as na;

use crate::Rigid2;
use crate::rotation::yaw;

/// Column of two `f64`.
pub type Vector2 = na::Vector2<f64>;
/// Column of two `f32`.
pub type Vector2f = na::Vector2<f32>;
/// Column of three `f64`.
pub type Vector3 = na::Vector3<f64>;
/// Column of three `f32`.
pub type Vector3f = na::Vector3<f32>;
/// A point of a scan: `f32` metres.
pub type Point3f = na::Point3<f32>;
/// A unit quaternion.
pub type Quaternion = na::UnitQuaternion<f64>;
/// A rigid transform, `p_a = R p_b + t`.
pub type Rigid3 = na::Isometry3<f64>;
/// A rigid transform in single precision, for points.
pub type Rigid3f = na::Isometry3<f32>;

/// The 2D part `((x, y), yaw)` of a pose.
pub fn project_2d(pose: &Rigid3) -> Rigid2 {
    Rigid2::new(pose.translation.x, pose.translation.y, yaw(&pose.rotation))
}

/// The pose in the plane z = 0.
pub fn embed_3d(pose: &Rigid2) -> Rigid3 {
    Rigid3::from_parts(
        na::Translation3::new(pose.translation.x, pose.translation.y, 0.0),
        Quaternion::from_axis_angle(&Vector3::z_axis(), pose.angle),
    )
}

/// Single precision, for transforming points.
pub fn to_f32(pose: &Rigid3) -> Rigid3f {
    let q = pose.rotation.quaternion();
    Rigid3f::from_parts(
        na::Translation3::new(
            pose.translation.x as f32,
            pose.translation.y as f32,
            pose.translation.z as f32,
        ),
        na::UnitQuaternion::new_unchecked(na::Quaternion::new(
            q.w as f32, q.i as f32, q.j as f32, q.k as f32,
        )),
    )
}

/// Double precision.
pub fn to_f64(pose: &Rigid3f) -> Rigid3 {
    let q = pose.rotation.quaternion();
    Rigid3::from_parts(
        na::Translation3::new(
            f64::from(pose.translation.x),
            f64::from(pose.translation.y),
            f64::from(pose.translation.z),
        ),
        Quaternion::new_normalize(na::Quaternion::new(
            f64::from(q.w),
            f64::from(q.i),
            f64::from(q.j),
            f64::from(q.k),
        )),
    )
}

/// The angle of the rotation, in [0, π].
pub fn rotation_angle(pose: &Rigid3) -> f64 {
    let q = pose.rotation.quaternion();
    2.0 * q.vector().norm().atan2(q.w.abs())
}

/// A pose from translation and quaternion `(x, y, z, w)` as stored in files. The quaternion is normalised if
/// its norm is within 1e-3 of one. Otherwise, or if a number is not finite, the result is `None`.
pub fn pose_from_xyz_quaternion(translation: [f64; 3], quaternion_xyzw: [f64; 4]) -> Option<Rigid3> {
    let [x, y, z, w] = quaternion_xyzw;
    let q = na::Quaternion::new(w, x, y, z);
    let finite = translation.iter().chain(&quaternion_xyzw).all(|v| v.is_finite());
    if !finite || (q.norm() - 1.0).abs() >= 1e-3 {
        return None;
    }
    Some(Rigid3::from_parts(na::Translation3::from(translation), Quaternion::new_normalize(q)))
}

/// Whether translation and rotation are finite and the quaternion has unit norm to 1e-3.
pub fn is_valid_pose(pose: &Rigid3) -> bool {
    let q = pose.rotation.quaternion();
    pose.translation.vector.iter().all(|v| v.is_finite()) && (q.norm() - 1.0).abs() < 1e-3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rotation_from_roll_pitch_yaw;

    #[test]
    fn embedding_and_projection_are_inverse() {
        let pose = Rigid2::new(1.0, -2.0, 0.7);
        let back = project_2d(&embed_3d(&pose));
        assert!((back.translation - pose.translation).norm() < 1e-12 && (back.angle - 0.7).abs() < 1e-12);
    }

    #[test]
    fn embedded_translation_acts_like_the_one_in_2d() {
        let pose = Rigid3::from_parts(
            na::Translation3::new(1.0, 2.0, 3.0),
            rotation_from_roll_pitch_yaw(0.1, 0.2, 0.3),
        );
        let a = pose * embed_3d(&Rigid2::new(1.0, 2.0, 0.0));
        let b = pose * Rigid3::translation(1.0, 2.0, 0.0);
        assert!((a.to_homogeneous() - b.to_homogeneous()).norm() < 1e-9);
    }

    #[test]
    fn bad_quaternions_are_refused() {
        assert!(pose_from_xyz_quaternion([0.0; 3], [0.0; 4]).is_none());
        assert!(pose_from_xyz_quaternion([f64::NAN, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]).is_none());
        assert!(pose_from_xyz_quaternion([0.0; 3], [0.0, 0.0, 0.0, 1.0005]).is_some());
    }
}
