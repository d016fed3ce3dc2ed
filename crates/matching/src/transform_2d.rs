//! 2D rigid transforms of points in single precision.

use portolan_geometry::{Point3f, Rigid2};

/// A rotation about z and a translation in 2D, applied to points in single precision as quaternions do
/// it. The cell of a point on a border depends on this order of operations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform2d {
    /// Real part and z of the quaternion.
    quaternion: [f32; 2],
    /// Metres.
    translation: [f32; 2],
}

impl Transform2d {
    /// The transform of a pose.
    pub fn from_pose(pose: &Rigid2) -> Self {
        let translation = [pose.translation.x as f32, pose.translation.y as f32];
        Self { translation, ..Self::rotation(pose.angle as f32) }
    }

    /// A rotation by `angle` radians.
    pub fn rotation(angle: f32) -> Self {
        let half = angle / 2.0;
        Self { quaternion: [half.cos(), half.sin()], translation: [0.0; 2] }
    }

    /// The inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let [w, z] = self.quaternion;
        let back = Self { quaternion: [w, -z], translation: [0.0; 2] };
        let [x, y] = self.translation;
        let moved = back.apply(&Point3f::new(x, y, 0.0));
        Self { translation: [-moved.x, -moved.y], ..back }
    }

    /// The transformed point (metres); z is kept.
    #[inline]
    pub fn apply(&self, point: &Point3f) -> Point3f {
        let [w, z] = self.quaternion;
        let (cross_x, cross_y) = (-z * point.y, z * point.x);
        let (cross_x, cross_y) = (cross_x + cross_x, cross_y + cross_y);
        let x = (point.x + w * cross_x) - z * cross_y;
        let y = (point.y + w * cross_y) + z * cross_x;
        Point3f::new(x + self.translation[0], y + self.translation[1], point.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Vector2;

    #[test]
    fn the_transform_equals_that_of_the_pose() {
        let pose = Rigid2::new(1.5, -0.7, 2.2);
        let transform = Transform2d::from_pose(&pose);
        let (point, expected) =
            (Point3f::new(3.0, -4.0, 1.0), pose.transform_point(&Vector2::new(3.0, -4.0)));
        let moved = transform.apply(&point);
        assert!((moved.xy().coords.cast::<f64>() - expected).norm() < 1e-6 && moved.z == 1.0);
        assert!((transform.inverse().apply(&moved) - point).norm() < 1e-6);
    }
}
