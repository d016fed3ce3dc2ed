//! The input trajectory as odometry: how much its motion from knot to knot may be wrong.

use portolan_geometry::{Vector3, angle_axis_from_quaternion};

use super::{DenseTrajectory, Knots};

/// Standard deviations of the error of the input's motion, per square root of a second.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct OdometryNoise {
    /// Metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
}

/// One motion between neighbouring knots, linearised: the residual is
/// `(translation + τ₁ − τ₀ − φ₀ × motion, rotation + φ₁ − φ₀)` in world axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OdometryTerm {
    pub translation: Vector3,
    pub rotation: Vector3,
    /// The motion of the input, turned as the current trajectory is.
    pub motion: Vector3,
    /// Inverse variances.
    pub weights: [f64; 2],
}

/// The terms of all motions from knot to knot.
pub(crate) fn odometry_terms(
    trajectory: &DenseTrajectory,
    knots: &Knots,
    noise: OdometryNoise,
) -> Vec<OdometryTerm> {
    let weight = |deviation: f64| 1.0 / (deviation * deviation * knots.spacing());
    (0..knots.count() - 1)
        .map(|i| {
            let (from, to) = (knots.seconds(i), knots.seconds(i + 1));
            let (input, current) = (
                [trajectory.input_pose(from), trajectory.input_pose(to)],
                [trajectory.pose(from), trajectory.pose(to)],
            );
            let turn = [0, 1].map(|k: usize| current[k].rotation * input[k].rotation.inverse());
            let motion = turn[0] * (input[1].translation.vector - input[0].translation.vector);
            OdometryTerm {
                translation: current[1].translation.vector - current[0].translation.vector - motion,
                rotation: angle_axis_from_quaternion(&(turn[1] * turn[0].inverse())),
                motion,
                weights: [weight(noise.translation), weight(noise.rotation)],
            }
        })
        .collect()
}

/// The noise that explains how far the current trajectory has departed from the motion of the input, within
/// bounds: an input that was already good is trusted more, one that was not is trusted less.
pub(crate) fn noise_found(trajectory: &DenseTrajectory, knots: &Knots) -> OdometryNoise {
    let unit = OdometryNoise { translation: 1.0, rotation: 1.0 };
    let terms = odometry_terms(trajectory, knots, unit);
    let deviation = |part: fn(&OdometryTerm) -> f64| {
        let squares: f64 = terms.iter().map(part).sum();
        (squares / (3.0 * terms.len() as f64 * knots.spacing())).sqrt()
    };
    OdometryNoise {
        translation: deviation(|t| t.translation.norm_squared()).clamp(0.003, 0.3),
        rotation: deviation(|t| t.rotation.norm_squared()).clamp(0.0003, 0.15),
    }
}

impl OdometryTerm {
    /// Rows of the Jacobian with respect to the increments (shift, turn) of both knots, and the residual.
    pub fn rows(&self) -> [([f64; 12], f64, f64); 6] {
        let m = self.motion;
        // −φ × m = m × φ.
        let cross = [[0.0, -m.z, m.y], [m.z, 0.0, -m.x], [-m.y, m.x, 0.0]];
        std::array::from_fn(|row| {
            let mut jacobian = [0.0; 12];
            if row < 3 {
                jacobian[row] = -1.0;
                jacobian[6 + row] = 1.0;
                jacobian[3..6].copy_from_slice(&cross[row]);
                (jacobian, self.translation[row], self.weights[0])
            } else {
                jacobian[row] = -1.0;
                jacobian[6 + row] = 1.0;
                (jacobian, self.rotation[row - 3], self.weights[1])
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Rigid3, Time};

    #[test]
    fn jacobians_agree_with_differences() {
        let poses: Vec<(Time, Rigid3)> = (0..21)
            .map(|i| {
                let s = f64::from(i) * 0.1;
                let pose = Rigid3::new(Vector3::new(s, 0.3 * s * s, 0.1), Vector3::new(0.1, 0.2 * s, s));
                (Time::from_unix_seconds(s), pose)
            })
            .collect();
        let mut trajectory = DenseTrajectory::new(&poses).unwrap();
        let knots = Knots::new(trajectory.duration(), 1.0);
        let noise = OdometryNoise { translation: 0.1, rotation: 0.01 };
        let start: Vec<f64> = (0..18).map(|i| 0.01 * f64::from(i % 5) - 0.02).collect();
        trajectory.apply(&knots, &start);
        let terms = odometry_terms(&trajectory, &knots, noise);
        for k in 0..12 {
            let mut step = vec![0.0; 18];
            step[k] = 1e-6;
            let mut moved = trajectory.clone();
            moved.apply(&knots, &step);
            let changed = odometry_terms(&moved, &knots, noise)[0];
            for (row, (jacobian, residual, _)) in terms[0].rows().into_iter().enumerate() {
                let numeric = (changed.rows()[row].1 - residual) / 1e-6;
                // The logarithm is taken as linear, which is off by half the (small) correction.
                assert!(
                    (numeric - jacobian[k]).abs() < 0.05,
                    "row {row}, unknown {k}: {numeric} {}",
                    jacobian[k]
                );
            }
        }
    }
}
