//! Interpolates and extrapolates a rigid motion at constant velocity in the moving frame.

use portolan_geometry::{
    Rigid3, Vector3, angle_axis_from_quaternion, nalgebra as na, quaternion_from_angle_axis,
};

/// A rigid motion with constant linear and angular velocity in the moving frame: the logarithm in SE(3) of
/// its end pose. A robot on a floor with constant wheel speeds moves like this, on an arc.
#[derive(Clone, Copy, Debug)]
pub(super) struct ScrewMotion {
    /// Rotation vector of the whole motion, radians.
    rotation: Vector3,
    /// Translation of the whole motion as integrated in the moving frame, metres.
    velocity: Vector3,
}

impl ScrewMotion {
    /// The screw motion with the end pose `motion`, with a rotation of less than half a turn.
    pub fn to(motion: &Rigid3) -> Self {
        let rotation = angle_axis_from_quaternion(&motion.rotation);
        Self { rotation, velocity: inverse_left_jacobian(&rotation, &motion.translation.vector) }
    }

    /// Pose after a fraction of the motion. Fractions above one and below zero extrapolate.
    pub fn fraction(&self, fraction: f64) -> Rigid3 {
        let rotation = self.rotation * fraction;
        let translation = left_jacobian(&rotation, &(self.velocity * fraction));
        Rigid3::from_parts(na::Translation3::from(translation), quaternion_from_angle_axis(&rotation))
    }
}

/// `V(ω) v = v + (1−cos θ)/θ² ω×v + (θ−sin θ)/θ³ ω×(ω×v)`: the translation with constant velocity v during a
/// rotation by ω.
fn left_jacobian(w: &Vector3, v: &Vector3) -> Vector3 {
    let angle = w.norm();
    let (a, b) = if angle < 1e-4 {
        (0.5, 1.0 / 6.0)
    } else {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / (angle * angle * angle))
    };
    let wv = w.cross(v);
    v + wv * a + w.cross(&wv) * b
}

/// `V(ω)⁻¹ v`, for angles below a full turn.
fn inverse_left_jacobian(w: &Vector3, v: &Vector3) -> Vector3 {
    let angle = w.norm();
    let b = if angle < 1e-4 {
        1.0 / 12.0
    } else {
        1.0 / (angle * angle) - 1.0 / (2.0 * angle * (angle / 2.0).tan())
    };
    let wv = w.cross(v);
    v - wv * 0.5 + w.cross(&wv) * b
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn half_of_an_arc_is_the_shorter_arc() {
        // A quarter of a circle of radius 2, driven to the left.
        let quarter = Rigid3::new(Vector3::new(2.0, 2.0, 0.0), Vector3::z() * std::f64::consts::FRAC_PI_2);
        let half = ScrewMotion::to(&quarter).fraction(0.5);
        let expected = Vector3::new(2.0_f64.sqrt(), 2.0 - 2.0_f64.sqrt(), 0.0);
        assert!((half.translation.vector - expected).norm() < 1e-12);
    }

    proptest! {
        #[test]
        fn fractions_compose(
            t in prop::array::uniform3(-5.0..5.0f64), w in prop::array::uniform3(-1.7..1.7f64),
            a in -1.5..1.5f64, tiny in prop::bool::ANY,
        ) {
            let w = Vector3::from(w) * if tiny { 1e-5 } else { 1.0 };
            let motion = Rigid3::new(Vector3::from(t), w);
            let screw = ScrewMotion::to(&motion);
            let whole = screw.fraction(a) * screw.fraction(1.0 - a);
            prop_assert!((whole.to_homogeneous() - motion.to_homogeneous()).norm() < 1e-7);
        }
    }
}
