//! Rigid transforms in 2D.

use std::f64::consts::PI;
use std::ops::Mul;

use nalgebra as na;

use crate::Vector2;

/// A 2D pose. The angle is not wrapped, so that optimisation can pass ±π.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid2 {
    /// Metres.
    pub translation: Vector2,
    /// Radians, not wrapped.
    pub angle: f64,
}

/// The angle wrapped into [−π, π]; ±π are kept. An angle that is not finite is kept, too.
pub fn normalize_angle(angle: f64) -> f64 {
    if (-PI..=PI).contains(&angle) || !angle.is_finite() {
        return angle;
    }
    let wrapped = angle.rem_euclid(2.0 * PI);
    if wrapped > PI { wrapped - 2.0 * PI } else { wrapped }
}

impl Rigid2 {
    /// From coordinates in metres and radians.
    pub fn new(x: f64, y: f64, angle: f64) -> Self {
        Self { translation: Vector2::new(x, y), angle }
    }

    /// The identity.
    pub fn identity() -> Self {
        Self::new(0.0, 0.0, 0.0)
    }

    /// The rotation alone, as a 2×2 matrix.
    pub fn rotation_matrix(&self) -> na::Matrix2<f64> {
        let (s, c) = self.angle.sin_cos();
        na::Matrix2::new(c, -s, s, c)
    }

    /// The inverse transform.
    pub fn inverse(&self) -> Self {
        let translation = -(self.rotation_matrix().transpose() * self.translation);
        Self { translation, angle: -self.angle }
    }

    /// The angle in [−π, π].
    pub fn normalized_angle(&self) -> f64 {
        normalize_angle(self.angle)
    }

    /// Whether every coordinate is finite.
    pub fn is_finite(&self) -> bool {
        self.translation.x.is_finite() && self.translation.y.is_finite() && self.angle.is_finite()
    }

    /// The transformed point.
    pub fn transform_point(&self, point: &Vector2) -> Vector2 {
        self.point_transform()(point)
    }

    /// A function that transforms points: for many points, sine and cosine are computed once.
    #[inline]
    pub fn point_transform(&self) -> impl Fn(&Vector2) -> Vector2 + Copy + use<> {
        let (rotation, translation) = (self.rotation_matrix(), self.translation);
        move |point| rotation * point + translation
    }
}

impl Default for Rigid2 {
    fn default() -> Self {
        Self::identity()
    }
}

#[allow(clippy::suspicious_arithmetic_impl)] // angles of a product add up
impl Mul for Rigid2 {
    type Output = Self;
    fn mul(self, rhs: Self) -> Self {
        Self { translation: self.transform_point(&rhs.translation), angle: self.angle + rhs.angle }
    }
}

impl Mul<&Rigid2> for &Rigid2 {
    type Output = Rigid2;
    fn mul(self, rhs: &Rigid2) -> Rigid2 {
        *self * *rhs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn angles_wrap_by_whole_turns() {
        for (angle, expected) in [(PI, PI), (-PI, -PI), (2.0 * PI, 0.0), (5.0 * PI, PI), (0.3, 0.3)] {
            assert!((normalize_angle(angle) - expected).abs() < 1e-9, "{angle}");
        }
        assert!((normalize_angle(-5.0 * PI).abs() - PI).abs() < 1e-9);
        assert!(normalize_angle(f64::NAN).is_nan());
    }

    proptest! {
        #[test]
        fn group_laws(a in prop::array::uniform3(-9.0..9.0f64), b in prop::array::uniform3(-9.0..9.0f64), c in prop::array::uniform3(-9.0..9.0f64)) {
            let [a, b, c] = [a, b, c].map(|[x, y, t]| Rigid2::new(x, y, t));
            let identity = a * a.inverse();
            prop_assert!(identity.translation.norm() < 1e-9 && identity.angle.abs() < 1e-9);
            let (left, right) = ((a * b) * c, a * (b * c));
            prop_assert!((left.translation - right.translation).norm() < 1e-9);
            prop_assert!((left.angle - right.angle).abs() < 1e-9);
        }
    }
}
