//! Calibrates odometry in 2D: the scale of its distances, wrong if wheels have another size than assumed;
//! the direction of its motion, wrong if the scanner is mounted at another yaw than given; and the lever
//! arm between the scanner and the point whose motion odometry measures, wrong if the scanner is mounted
//! elsewhere.
//!
//! Matched scans show by how much the measured motion was too short, how far it deviated to the side, and
//! the displacement for each radian turned. These are states of Kalman filters whose measurements are the
//! innovations of the pose (calibration of odometry along with the pose: Martinelli, Tomatis, Siegwart,
//! "Simultaneous localization and odometry self calibration for mobile robot", Autonomous Robots 22,
//! 2007). Loads and floors change them slowly. Rotations are left as measured, since scans determine them
//! well enough by themselves.

use portolan_geometry::{Rigid2, Vector2};

/// Prior standard deviation of the scale and direction errors, as a fraction of the distance, and of each
/// component of the lever arm, metres.
const PRIOR: f64 = 0.05;
const PRIOR_OF_LEVER: f64 = 0.3;
/// Random walk of the states: variance added for each metre or radian.
const WALK: f64 = 1e-5;
/// Maximum innovation, in standard deviations: slips and stalls hardly change the calibration (Huber
/// 1964).
const LARGEST: f64 = 1.0;
/// Error that any odometry is expected to have and that is not corrected: fraction of the distance, or
/// metres for each radian. Search windows cover it.
const USUAL: f64 = 0.05;
/// Minimum size of a larger error for its correction, in standard deviations.
const SIGNIFICANT: f64 = 3.0;
/// Rotation above which a motion does not update the lever arm, radians.
const LARGEST_TURN: f64 = 0.5;

/// Corrections of odometry: factor of the distance, deviation to the left, and position of the scanner.
#[derive(Clone, Copy, Debug)]
pub struct OdometryScale {
    /// Errors along and to the left of the measured motion, as fractions of its length.
    along: Share,
    across: Share,
    /// Position of the scanner ahead and to the left of where odometry has it, metres.
    ahead: Share,
    left: Share,
}

/// Estimate and variance of the motion in excess of the measured one, for each metre or each radian of it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Share {
    offset: f64,
    variance: f64,
}

impl Share {
    fn unknown(sigma: f64) -> Self {
        Self { offset: 0.0, variance: sigma.powi(2) }
    }

    /// The offset if it is large and significant enough to be corrected, else 0.
    fn correction(&self) -> f64 {
        let off = self.offset.abs();
        if off < USUAL || off < SIGNIFICANT * self.variance.sqrt() { 0.0 } else { self.offset }
    }

    /// Updates the estimate by the excess of the motion over the measured one, metres, over the motion
    /// `moved`, metres or radians, with the standard deviation `sigma`, metres.
    fn add(&mut self, more: f64, moved: f64, sigma: f64) {
        self.variance += WALK * moved.abs();
        let variance = self.variance * moved.powi(2) + sigma.powi(2);
        let largest = LARGEST * variance.sqrt();
        let innovation = (more - self.offset * moved).clamp(-largest, largest);
        let gain = self.variance * moved / variance;
        self.offset += gain * innovation;
        self.variance *= 1.0 - gain * moved;
    }
}

impl Default for OdometryScale {
    fn default() -> Self {
        let (share, lever) = (Share::unknown(PRIOR), Share::unknown(PRIOR_OF_LEVER));
        Self { along: share, across: share, ahead: lever, left: lever }
    }
}

impl OdometryScale {
    /// The measured motion, corrected where the errors are significant.
    pub fn corrected(&self, measured: &Rigid2) -> Rigid2 {
        let (along, across) = (1.0 + self.along.correction(), self.across.correction());
        let lever = Vector2::new(self.ahead.correction(), self.left.correction());
        let turned = measured.rotation_matrix() * lever - lever;
        let scaled = measured.translation * along + to_left(&measured.translation) * across;
        Rigid2 { translation: scaled + turned, ..*measured }
    }

    /// Ratio of the distance by odometry to that by scans; none where it is not corrected.
    pub fn factor(&self) -> Option<f64> {
        let correction = self.along.correction();
        (correction != 0.0).then(|| 1.0 / (1.0 + correction))
    }

    /// Updates the calibration by the motion from matching, `moved`, with the standard deviation of its
    /// prediction along each axis, metres.
    pub fn add(&mut self, measured: &Rigid2, moved: &Rigid2, sigma: f64) {
        let more = moved.translation - self.corrected(measured).translation;
        // A small rotation moves the scanner perpendicular to its lever arm.
        let turned = moved.normalized_angle();
        if turned.abs() < LARGEST_TURN {
            let (ahead, left) = (self.ahead.correction(), self.left.correction());
            self.ahead.add(more.y + ahead * turned, turned, sigma);
            self.left.add(more.x - left * turned, -turned, sigma);
        }
        let metres = measured.translation.norm();
        if metres == 0.0 {
            return;
        }
        let ahead = measured.translation / metres;
        let (along, across) = (self.along.correction(), self.across.correction());
        self.along.add(more.dot(&ahead) + along * metres, metres, sigma);
        self.across.add(more.dot(&to_left(&ahead)) + across * metres, metres, sigma);
    }
}

fn to_left(direction: &Vector2) -> Vector2 {
    Vector2::new(-direction.y, direction.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMA: f64 = 0.025;

    /// Drives forwards in gentle bends, with a constant error of odometry.
    fn learned(factor: f64, noise: f64) -> OdometryScale {
        let mut scale = OdometryScale::default();
        for step in 0..600 {
            let (k, angle) = (f64::from(step), 0.08 * (0.11 * f64::from(step)).sin());
            let measured = Rigid2 { translation: Vector2::new(0.15, 0.02), angle };
            let moved = Rigid2 {
                translation: measured.translation * factor
                    + Vector2::new((7.1 * k).sin(), (3.7 * k).sin()) * noise,
                angle,
            };
            scale.add(&measured, &moved, SIGMA);
        }
        scale
    }

    #[test]
    fn wheels_of_another_size_are_learned() {
        for factor in [1.0, 1.2, 0.75] {
            let scale = learned(factor, 0.01);
            assert!((1.0 + scale.along.offset - factor).abs() < 0.02, "{factor}: {scale:?}");
            let measured = Rigid2 { translation: Vector2::new(2.0, 0.0), angle: 0.3 };
            assert!((scale.corrected(&measured).translation.x - 2.0 * factor).abs() < 0.04);
            assert_eq!(scale.corrected(&measured).angle, 0.3);
        }
    }

    #[test]
    fn slip_and_standstill_hardly_update_the_scale() {
        let mut scale = learned(1.0, 0.0);
        let slip = Rigid2 { translation: Vector2::new(-2.85, 0.0), angle: 1.4 };
        let measured = Rigid2 { translation: Vector2::new(0.15, 0.0), angle: 0.0 };
        scale.add(&measured, &slip, SIGMA);
        assert!(scale.along.offset.abs() < 0.02, "{scale:?}");
        let before = scale;
        scale.add(&Rigid2::identity(), &slip, SIGMA);
        assert_eq!((scale.along, scale.across), (before.along, before.across));
    }

    #[test]
    fn a_scanner_mounted_elsewhere_is_learned() {
        let (mut scale, lever) = (OdometryScale::default(), Rigid2::new(0.5, -0.2, 0.0));
        let step = |k: i32| Rigid2::new(0.1, 0.0, 0.1 * (0.2 * f64::from(k)).sin());
        for k in 0..600 {
            scale.add(&step(k), &(lever.inverse() * step(k) * lever), SIGMA);
        }
        assert!(
            (scale.ahead.offset - 0.5).abs() < 0.02 && (scale.left.offset + 0.2).abs() < 0.02,
            "{scale:?}"
        );
        assert!(scale.along.correction() == 0.0 && scale.across.correction() == 0.0, "{scale:?}");
        let turn = Rigid2::new(0.1, 0.0, 0.3);
        let off = scale.corrected(&turn).translation - (lever.inverse() * turn * lever).translation;
        assert!(off.norm() < 0.01, "{scale:?}");
    }

    #[test]
    fn a_scanner_mounted_at_another_yaw_is_learned() {
        let (mut scale, measured) = (OdometryScale::default(), Rigid2::new(0.15, 0.0, 0.02));
        let yaw = Rigid2::new(0.0, 0.0, 0.17);
        let moved = Rigid2 { translation: yaw.transform_point(&measured.translation), ..measured };
        (0..600).for_each(|_| scale.add(&measured, &moved, SIGMA));
        let off = scale.corrected(&measured).translation - moved.translation;
        assert!(off.norm() < 0.003, "{scale:?}");
    }
}
