//! Uses the input trajectory as odometry, with the noise of its motion from knot to knot.

use portolan_geometry::Rigid3;

use super::motion_term::MotionTerm;
use super::{DenseTrajectory, Knots};

/// Fraction of the motions that may be jumps; they are left out of the estimate of the noise.
const JUMPS: f64 = 0.02;

/// Standard deviations of the error of the input's motion, per square root of a second.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct OdometryNoise {
    /// Metres.
    pub translation: f64,
    /// Radians.
    pub rotation: f64,
}

/// The terms of all motions of the input from knot to knot.
pub(crate) fn odometry_terms(
    trajectory: &DenseTrajectory,
    knots: &Knots,
    noise: OdometryNoise,
) -> Vec<MotionTerm> {
    motion_terms(|seconds| trajectory.joined_pose(seconds), trajectory, knots, noise)
}

/// The same for any motion.
pub(crate) fn motion_terms(
    pose: impl Fn(f64) -> Rigid3,
    trajectory: &DenseTrajectory,
    knots: &Knots,
    noise: OdometryNoise,
) -> Vec<MotionTerm> {
    let root = knots.spacing().sqrt();
    let (shift, turn) = (noise.translation * root, noise.rotation * root);
    (0..knots.count() - 1)
        .map(|i| {
            let motion = pose(knots.seconds(i)).inverse() * pose(knots.seconds(i + 1));
            MotionTerm::new(trajectory, knots, i, &motion, &[shift, shift, shift, turn, turn, turn])
        })
        .collect()
}

/// The noise that explains the deviation of the current trajectory from the motion of the input, within
/// bounds: an accurate input gets more weight, an inaccurate one less.
pub(crate) fn noise_found(trajectory: &DenseTrajectory, knots: &Knots) -> OdometryNoise {
    let unit = OdometryNoise { translation: 1.0, rotation: 1.0 };
    let terms = odometry_terms(trajectory, knots, unit);
    let deviation = |part: fn(&MotionTerm) -> f64| {
        (trimmed_mean(terms.iter().map(part).collect()) / (3.0 * knots.spacing())).sqrt()
    };
    OdometryNoise {
        translation: deviation(|t| t.translation.norm_squared()).clamp(0.003, 0.3),
        rotation: deviation(|t| t.rotation.norm_squared()).clamp(0.0003, 0.15),
    }
}

/// The mean of squares without the largest ones.
pub(crate) fn trimmed_mean(mut squares: Vec<f64>) -> f64 {
    squares.sort_by(f64::total_cmp);
    let kept = squares.len() - (squares.len() as f64 * JUMPS) as usize;
    squares[..kept].iter().sum::<f64>() / kept.max(1) as f64
}
