//! By which factor odometry measures distances wrong, as wheels of another size than assumed make it.
//!
//! Matched scans say by how much measured motion was too short. The factor is the state of a Kalman filter whose
//! measurements are the innovations of the pose (calibration of odometry along with the pose: Martinelli, Tomatis,
//! Siegwart, "Simultaneous localization and odometry self calibration for mobile robot", Autonomous Robots 22, 2007).
//! Loads and floors change it slowly. Turns are left as measured: scans tell them well enough by themselves.

use portolan_geometry::Rigid2;

/// Standard deviation of the factor before anything was seen.
const PRIOR: f64 = 0.05;
/// What is known of it grows uncertain by this variance for each metre.
const WALK_PER_METRE: f64 = 1e-5;
/// An innovation counts as at most so many standard deviations: a slip or a stall says little of the wheels (Huber 1964).
const LARGEST: f64 = 1.0;
/// Errors up to this share are expected of any odometry, and searches are wide enough for them.
const USUAL: f64 = 0.05;
/// A larger one is corrected if it is so many standard deviations.
const SIGNIFICANT: f64 = 3.0;

/// What measured distances are to be multiplied by.
#[derive(Clone, Copy, Debug)]
pub struct OdometryScale {
    factor: f64,
    variance: f64,
}

impl Default for OdometryScale {
    fn default() -> Self {
        Self { factor: 1.0, variance: PRIOR.powi(2) }
    }
}

impl OdometryScale {
    /// The motion that was measured, corrected if that is called for.
    pub fn corrected(&self, measured: &Rigid2) -> Rigid2 {
        let off = (self.factor - 1.0).abs();
        if off < USUAL || off < SIGNIFICANT * self.variance.sqrt() {
            return *measured;
        }
        Rigid2 { translation: measured.translation * self.factor, ..*measured }
    }

    /// Takes what the motion was by matching, with the standard deviation that predictions of it have along each axis,
    /// metres.
    pub fn add(&mut self, measured: &Rigid2, moved: &Rigid2, sigma: f64) {
        let metres = measured.translation.norm();
        if metres == 0.0 {
            return;
        }
        self.variance += WALK_PER_METRE * metres;
        let innovation = moved.translation.dot(&measured.translation) / metres - self.factor * metres;
        let innovation = innovation.clamp(-LARGEST * sigma, LARGEST * sigma);
        let gain = self.variance * metres / (self.variance * metres.powi(2) + sigma.powi(2));
        self.factor += gain * innovation;
        self.variance *= 1.0 - gain * metres;
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Vector2;

    use super::*;

    const SIGMA: f64 = 0.025;

    /// Drives on and bends to and fro, with odometry that is always off by the same.
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
            assert!((scale.factor - factor).abs() < 0.02, "{factor}: {scale:?}");
            let measured = Rigid2 { translation: Vector2::new(2.0, 0.0), angle: 0.3 };
            assert!((scale.corrected(&measured).translation.x - 2.0 * factor).abs() < 0.04);
            assert_eq!(scale.corrected(&measured).angle, 0.3);
        }
    }

    #[test]
    fn a_slip_and_standing_teach_next_to_nothing() {
        let mut scale = learned(1.0, 0.0);
        let slip = Rigid2 { translation: Vector2::new(-2.85, 0.0), angle: 1.4 };
        let measured = Rigid2 { translation: Vector2::new(0.15, 0.0), angle: 0.0 };
        scale.add(&measured, &slip, SIGMA);
        assert!((scale.factor - 1.0).abs() < 0.02, "{scale:?}");
        let before = scale;
        scale.add(&Rigid2::identity(), &slip, SIGMA);
        assert_eq!((scale.factor, scale.variance), (before.factor, before.variance));
    }
}
