//! A motion in 3D as a uniform quintic B-spline of position and of roll, pitch and yaw: derivatives
//! are exact, and accelerations and their derivatives continuous.

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Quaternion, Rigid3, Vector3};

use super::{Motion, MotionState, Rolling};

/// Time between control points, seconds.
pub(crate) const KNOT_SPACING: f64 = 0.05;
/// Control point: x, y, z in metres and roll, pitch, yaw in radians (yaw unwrapped).
pub(crate) type Control = [f64; 6];

/// A motion along control points, at rest before and after.
#[derive(Clone, Debug)]
pub struct SplineMotion {
    controls: Vec<Control>,
    /// Distance travelled up to each knot, metres.
    travelled: Vec<f64>,
    duration: f64,
}

/// Value and two derivatives of the six basis functions over the unit interval.
struct Basis([[f64; 6]; 3]);

impl Basis {
    /// The pieces of the quintic B-spline (de Boor, "A practical guide to splines", chapter X) at `u` in
    /// [0, 1], and their first two derivatives by u.
    fn at(u: f64) -> Self {
        let v = 1.0 - u;
        let (u2, v2) = (u * u, v * v);
        let (u3, v3) = (u2 * u, v2 * v);
        let (u4, v4) = (u2 * u2, v2 * v2);
        // The middle pieces as polynomials in u, and mirrored in v.
        let second = |u: f64, u2: f64, u3: f64, u4: f64| {
            let u5 = u4 * u;
            [
                (26.0 - 50.0 * u + 20.0 * u2 + 20.0 * u3 - 20.0 * u4 + 5.0 * u5) / 120.0,
                (-50.0 + 40.0 * u + 60.0 * u2 - 80.0 * u3 + 25.0 * u4) / 120.0,
                (40.0 + 120.0 * u - 240.0 * u2 + 100.0 * u3) / 120.0,
            ]
        };
        let third = |u: f64, u2: f64, u3: f64, u4: f64| {
            let u5 = u4 * u;
            [
                (66.0 - 60.0 * u2 + 30.0 * u4 - 10.0 * u5) / 120.0,
                (-120.0 * u + 120.0 * u3 - 50.0 * u4) / 120.0,
                (-120.0 + 360.0 * u2 - 200.0 * u3) / 120.0,
            ]
        };
        let outer = |_: f64, _: f64, v3: f64, v4: f64, v: f64| [v4 * v / 120.0, -v4 / 24.0, v3 / 6.0];
        let (b0, b5) = (outer(v, v2, v3, v4, v), outer(u, u2, u3, u4, u));
        let (b1, b4) = (second(u, u2, u3, u4), second(v, v2, v3, v4));
        let (b2, b3) = (third(u, u2, u3, u4), third(v, v2, v3, v4));
        Self([
            [b0[0], b1[0], b2[0], b3[0], b4[0], b5[0]],
            // Mirrored pieces change the sign of the first derivative.
            [b0[1], b1[1], b2[1], -b3[1], -b4[1], -b5[1]],
            [b0[2], b1[2], b2[2], b3[2], b4[2], b5[2]],
        ])
    }
}

impl SplineMotion {
    /// A motion near the control points, which are `KNOT_SPACING` apart from time 0 on; none without
    /// control points.
    pub(crate) fn new(controls: Vec<Control>, duration: f64) -> Option<Self> {
        controls.first()?;
        let mut motion = Self { travelled: vec![0.0], controls, duration };
        let mut total = 0.0;
        for knot in 1..motion.controls.len() {
            let time = (knot - 1) as f64 * KNOT_SPACING;
            total += motion.distance(time, KNOT_SPACING);
            motion.travelled.push(total);
        }
        Some(motion)
    }

    /// A platform at rest at a position with a yaw.
    pub fn standing(position: Vector3, yaw: f64, duration: f64) -> Self {
        let control = [position.x, position.y, position.z, 0.0, 0.0, yaw];
        Self { controls: vec![control], travelled: vec![0.0], duration }
    }

    /// All six channels and their first two time derivatives at a time.
    fn channels(&self, time: f64) -> [Control; 3] {
        let at = time.clamp(0.0, self.duration.max(0.0)) / KNOT_SPACING;
        let knot = at.floor();
        let Basis(basis) = Basis::at(at - knot);
        let last = self.controls.len() - 1;
        let first = knot as usize;
        let mut sums = [[0.0; 6]; 3];
        for i in 0..6 {
            let control = &self.controls[(first + i).saturating_sub(2).min(last)];
            for (sum, weights) in sums.iter_mut().zip(&basis) {
                for (value, c) in sum.iter_mut().zip(control) {
                    *value += weights[i] * c;
                }
            }
        }
        let is_outside = !(0.0..=self.duration).contains(&time);
        let rate = if is_outside { 0.0 } else { 1.0 / KNOT_SPACING };
        sums[1].iter_mut().for_each(|v| *v *= rate);
        sums[2].iter_mut().for_each(|v| *v *= rate * rate);
        sums
    }

    /// Distance travelled during `span` seconds from `time` on, metres, by Simpson's rule.
    fn distance(&self, time: f64, span: f64) -> f64 {
        let speed = |share: f64| {
            let [_, rates, _] = self.channels(time + share * span);
            Vector3::new(rates[0], rates[1], rates[2]).norm()
        };
        (speed(0.0) + 4.0 * speed(0.5) + speed(1.0)) * span / 6.0
    }
}

impl Motion for SplineMotion {
    fn duration(&self) -> f64 {
        self.duration
    }

    fn state(&self, time: f64) -> MotionState {
        let [value, rate, second] = self.channels(time);
        let ([_, _, _, roll, pitch, yaw], [_, _, _, dr, dp, dy]) = (value, rate);
        let [_, _, _, ddr, ddp, ddy] = second;
        let ((sr, cr), (sp, cp)) = (libm::sincos(roll), libm::sincos(pitch));
        let velocity = Vector3::new(rate[0], rate[1], rate[2]);
        let acceleration = Vector3::new(second[0], second[1], second[2]);
        // ω = ψ̇ z + θ̇ y + φ̇ x, in the frame of the body, and its derivative.
        let omega = Vector3::new(dr - dy * sp, dp * cr + dy * cp * sr, -dp * sr + dy * cp * cr);
        let alpha = Vector3::new(
            ddr - ddy * sp - dy * dp * cp,
            ddp * cr - dp * dr * sr + ddy * cp * sr - dy * dp * sp * sr + dy * dr * cp * cr,
            -ddp * sr - dp * dr * cr + ddy * cp * cr - dy * dp * sp * cr - dy * dr * cp * sr,
        );
        MotionState {
            map_from_base: Rigid3::from_parts(
                na::Translation3::new(value[0], value[1], value[2]),
                rotation(roll, pitch, yaw),
            ),
            velocity_in_map: velocity,
            acceleration_in_map: acceleration,
            angular_velocity_in_base: omega,
            angular_acceleration_in_base: alpha,
        }
    }
}

impl Rolling for SplineMotion {
    fn rolled(&self, time: f64) -> (f64, f64) {
        let time = time.clamp(0.0, self.duration);
        let knot = ((time / KNOT_SPACING) as usize).min(self.travelled.len() - 1);
        let start = knot as f64 * KNOT_SPACING;
        let travelled = self.travelled[knot] + self.distance(start, time - start);
        (travelled, self.channels(time)[0][5])
    }
}

/// `Rz(yaw) Ry(pitch) Rx(roll)`, with the functions that are the same on every platform.
pub(crate) fn rotation(roll: f64, pitch: f64, yaw: f64) -> Quaternion {
    let [(sr, cr), (sp, cp), (sy, cy)] = [roll, pitch, yaw].map(|angle| libm::sincos(0.5 * angle));
    Quaternion::new_normalize(na::Quaternion::new(
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{angle_axis_from_quaternion, rotation_from_roll_pitch_yaw};
    use portolan_worlds::Random;

    #[test]
    fn the_basis_is_a_partition_of_one_with_right_derivatives() {
        let h = 1e-5;
        for i in 1..20 {
            let u = f64::from(i) / 20.0;
            let (Basis(b), Basis(plus), Basis(minus)) = (Basis::at(u), Basis::at(u + h), Basis::at(u - h));
            assert!((b[0].iter().sum::<f64>() - 1.0).abs() < 1e-14 && b[1].iter().sum::<f64>().abs() < 1e-13);
            for k in 0..6 {
                assert!(((plus[0][k] - minus[0][k]) / (2.0 * h) - b[1][k]).abs() < 1e-9, "{u} {k}");
                assert!(((plus[1][k] - minus[1][k]) / (2.0 * h) - b[2][k]).abs() < 1e-8, "{u} {k}");
            }
        }
        // Pieces fit together.
        let (Basis(end), Basis(start)) = (Basis::at(1.0), Basis::at(0.0));
        for order in 0..3 {
            assert!((0..5).all(|k| (end[order][k + 1] - start[order][k]).abs() < 1e-14));
        }
    }

    #[test]
    fn derivatives_are_those_of_the_motion() {
        let mut random = Random::new(2, "spline", 0);
        let controls = (0..100).map(|_| [0; 6].map(|_| 0.3 * random.gaussian())).collect();
        let motion = SplineMotion::new(controls, 4.9).unwrap();
        let h = 1e-5;
        for i in 1..90 {
            let t = f64::from(i) * 0.0537;
            let (s, plus, minus) = (motion.state(t), motion.state(t + h), motion.state(t - h));
            let velocity =
                (plus.map_from_base.translation.vector - minus.map_from_base.translation.vector) / (2.0 * h);
            assert!((velocity - s.velocity_in_map).norm() < 1e-5 * (1.0 + velocity.norm()));
            let acceleration = (plus.velocity_in_map - minus.velocity_in_map) / (2.0 * h);
            assert!((acceleration - s.acceleration_in_map).norm() < 1e-4 * (1.0 + acceleration.norm()));
            let turned = minus.map_from_base.rotation.inverse() * plus.map_from_base.rotation;
            let omega = angle_axis_from_quaternion(&turned) / (2.0 * h);
            assert!((omega - s.angular_velocity_in_base).norm() < 1e-4 * (1.0 + omega.norm()));
            let alpha = (plus.angular_velocity_in_base - minus.angular_velocity_in_base) / (2.0 * h);
            assert!((alpha - s.angular_acceleration_in_base).norm() < 1e-3 * (1.0 + alpha.norm()));
        }
        let (a, b) = (rotation(0.3, -0.4, 2.0), rotation_from_roll_pitch_yaw(0.3, -0.4, 2.0));
        assert!(a.angle_to(&b) < 1e-12);
    }

    #[test]
    fn velocity_is_zero_before_and_after() {
        let motion = SplineMotion::new(vec![[0.0; 6], [1.0; 6], [2.0; 6]], 0.1).unwrap();
        assert_eq!(motion.state(9.0).velocity_in_map, Vector3::zeros());
        assert_eq!(motion.state(9.0).map_from_base, motion.state(0.1).map_from_base);
        assert!(motion.rolled(9.0).0 > motion.rolled(0.05).0);
    }
}
