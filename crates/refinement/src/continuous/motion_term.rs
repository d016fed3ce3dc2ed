//! Measurements of the motion from knot to knot, from any sensor, as terms of the optimisation.

use nalgebra::Matrix3;
use portolan_geometry::{Rigid3, Vector3, angle_axis_from_quaternion};

use super::{DenseTrajectory, Knots};

/// Number of standard deviations above which motions lose weight (Cauchy): inputs jump, wheels slip.
const ROBUST: f64 = 3.0;

/// One motion between neighbouring knots, linearised: the residual is
/// `(translation + τ₁ − τ₀ − φ₀ × motion, rotation + φ₁ − φ₀)` in world axes, weighted along three axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MotionTerm {
    knot: usize,
    pub translation: Vector3,
    pub rotation: Vector3,
    /// The measured translation, rotated into the world by the current trajectory.
    motion: Vector3,
    /// Columns: the axes of the weights.
    axes: Matrix3<f64>,
    /// Inverse variances of translation and rotation.
    weights: [f64; 6],
}

impl MotionTerm {
    /// The term of a motion (tracking frame at the knot from tracking frame at the next) with standard
    /// deviations of translation (metres) and rotation (radians) along the axes of the tracking frame;
    /// infinite ones do not constrain.
    pub fn new(
        trajectory: &DenseTrajectory,
        knots: &Knots,
        knot: usize,
        motion: &Rigid3,
        deviations: &[f64; 6],
    ) -> Self {
        let from = trajectory.pose(knots.seconds(knot));
        let to = trajectory.pose(knots.seconds(knot + 1));
        let moved = from.rotation * motion.translation.vector;
        let translation = to.translation.vector - from.translation.vector - moved;
        let rotation =
            angle_axis_from_quaternion(&(to.rotation * (from.rotation * motion.rotation).inverse()));
        let axes = from.rotation.to_rotation_matrix().into_inner();
        let weights = deviations.map(|d| 1.0 / (d * d));
        Self { knot, translation, rotation, motion: moved, axes, weights }.robust()
    }

    /// Reduces the weights of translation and rotation according to their residuals.
    fn robust(mut self) -> Self {
        for (first, residual) in [(0, self.translation), (3, self.rotation)] {
            let along = self.axes.tr_mul(&residual);
            let squares: f64 = (0..3).map(|k| self.weights[first + k] * along[k] * along[k]).sum();
            let weight = 1.0 / (1.0 + squares / (3.0 * ROBUST * ROBUST));
            self.weights[first..first + 3].iter_mut().for_each(|w| *w *= weight);
        }
        self
    }

    /// The first of both knots.
    pub fn knot(&self) -> usize {
        self.knot
    }

    /// The residual along the axes of the tracking frame: translation, rotation.
    pub fn along_axes(&self) -> [f64; 6] {
        let (t, r) = (self.axes.tr_mul(&self.translation), self.axes.tr_mul(&self.rotation));
        [t.x, t.y, t.z, r.x, r.y, r.z]
    }

    /// Rows of the Jacobian with respect to the increments (translation, rotation) of both knots, residual,
    /// and weight.
    pub fn rows(&self) -> [([f64; 12], f64, f64); 6] {
        std::array::from_fn(|row| {
            let axis: Vector3 = self.axes.column(row % 3).into_owned();
            let first = if row < 3 { 0 } else { 3 };
            let mut jacobian = [0.0; 12];
            jacobian[first..first + 3].copy_from_slice((-axis).as_slice());
            jacobian[6 + first..9 + first].copy_from_slice(axis.as_slice());
            let residual = if row < 3 {
                // −(φ × m)·a = −φ·(m × a).
                jacobian[3..6].copy_from_slice((-self.motion.cross(&axis)).as_slice());
                self.translation.dot(&axis)
            } else {
                self.rotation.dot(&axis)
            };
            (jacobian, residual, self.weights[row])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Time;

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
        let start: Vec<f64> = (0..18).map(|i| 0.01 * f64::from(i % 5) - 0.02).collect();
        trajectory.apply(&knots, &start);
        let motion = Rigid3::new(Vector3::new(0.9, 0.2, 0.1), Vector3::new(0.0, 0.2, 0.9));
        let term = |t: &DenseTrajectory| MotionTerm::new(t, &knots, 0, &motion, &[1.0; 6]);
        let before = term(&trajectory);
        for k in 0..12 {
            let mut step = vec![0.0; 18];
            step[k] = 1e-6;
            let mut moved = trajectory.clone();
            moved.apply(&knots, &step);
            let after = term(&moved);
            let change =
                ((after.translation - before.translation) / 1e-6, (after.rotation - before.rotation) / 1e-6);
            for (row, (jacobian, _, _)) in before.rows().into_iter().enumerate() {
                let axis: Vector3 = before.axes.column(row % 3).into_owned();
                let numeric = if row < 3 { change.0.dot(&axis) } else { change.1.dot(&axis) };
                // The logarithm is linearised, with an error of half the (small) residual.
                assert!(
                    (numeric - jacobian[k]).abs() < 0.2,
                    "row {row}, unknown {k}: {numeric} {}",
                    jacobian[k]
                );
            }
        }
    }

    #[test]
    fn jumps_are_downweighted() {
        let pose = |x: f64| Rigid3::translation(x, 0.0, 0.0);
        let poses = [0.0, 1.0, 2.0].map(|s| (Time::from_unix_seconds(s), pose(s)));
        let trajectory = DenseTrajectory::new(&poses).unwrap();
        let knots = Knots::new(trajectory.duration(), 1.0);
        let weight = |x: f64| MotionTerm::new(&trajectory, &knots, 0, &pose(x), &[0.1; 6]).rows()[0].2;
        assert!(weight(1.0) > 99.0 && weight(3.0) < 20.0);
    }
}
