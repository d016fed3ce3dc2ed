//! Estimates the position uncertainty along a path that no sensor measured.
//!
//! Where neither scans nor odometry measure the motion, the scanner is assumed to keep its velocity. The
//! velocity changes meanwhile as in a random walk: white acceleration of the spectral density `q`. With
//! the error `s` of the velocity at the beginning, the variance of the position after the time `t` is
//! `σ² = q t³ / 3 + s² t²` (Bar-Shalom, Li, Kirubarajan 2001, "Estimation with Applications to Tracking and
//! Navigation", 6.2.2). The same scanner shows how large `q` is where its motion is observed: the mean
//! speeds of successive path segments of the durations `t₁` and `t₂` differ by `q (t₁ + t₂) / 3` in the
//! mean square.

use portolan_geometry::{Rigid2, Time};
use portolan_numeric::CovarianceMatching;

use super::motion::LONGEST_UNMEASURED;

/// Spectral density of the acceleration before anything was learned, m²/s³: the speed changes by half a
/// metre per second within a second.
const DENSITY: f64 = 0.25;
/// Time constant of the estimated density, path segments.
const MEMORY: f64 = 50.0;
/// Minimum duration of a path segment, seconds: errors of poses hardly count over it.
const LEAST_SEGMENT: f64 = 1.0;
/// Speed below which the scanner may stand still, m/s.
const SLOW: f64 = 0.1;

/// Velocity of the scanner and its uncertainty.
#[derive(Clone, Copy, Debug)]
pub(super) struct Velocity {
    /// m/s.
    pub speed: f64,
    /// Standard deviation, m/s.
    pub sigma: f64,
}

impl Velocity {
    /// Whether the scanner may stand still: the error of constant velocity is small then.
    pub fn is_rest(&self) -> bool {
        self.speed < SLOW
    }
}

/// A path segment in which scans constrained the motion throughout.
#[derive(Clone, Copy, Debug)]
struct PathSegment {
    from: (Time, Rigid2),
    /// Duration, seconds, and mean speed, m/s, of the previous segment, which ended where this one began.
    before: Option<(f64, f64)>,
}

/// Learned changes of speed, and the time since which the motion has been unmeasured.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnmeasuredTravel {
    measured_at: Option<Time>,
    /// Velocity at that time.
    velocity: Velocity,
    density: CovarianceMatching,
    segment: Option<PathSegment>,
}

impl Default for UnmeasuredTravel {
    fn default() -> Self {
        let density = CovarianceMatching::new(MEMORY);
        Self { measured_at: None, velocity: Velocity { speed: 0.0, sigma: 0.0 }, density, segment: None }
    }
}

impl UnmeasuredTravel {
    /// Adds a pose to which scans or odometry measured the motion, or at which the scanner rests.
    pub fn add_measured(&mut self, time: Time, pose: &Rigid2, velocity: Velocity) {
        (self.measured_at, self.velocity) = (Some(time), velocity);
        let Some(segment) = self.segment else {
            self.segment = Some(PathSegment { from: (time, *pose), before: None });
            return;
        };
        let seconds = time.seconds_since(segment.from.0);
        if seconds < LEAST_SEGMENT {
            return;
        }
        let speed = (pose.translation - segment.from.1.translation).norm() / seconds;
        if let Some((seconds_before, speed_before)) = segment.before {
            let density = 3.0 * (speed - speed_before).powi(2) / (seconds + seconds_before);
            self.density.add(density / DENSITY);
        }
        self.segment = Some(PathSegment { from: (time, *pose), before: Some((seconds, speed)) });
    }

    /// The motion to this time was unmeasured.
    pub fn add_unmeasured(&mut self, time: Time) {
        self.segment = None;
        self.measured_at.get_or_insert(time);
    }

    /// Whether the scanner rested when its motion was last measured, or its motion has never been
    /// measured.
    pub fn rested(&self) -> bool {
        self.measured_at.is_none() || self.velocity.is_rest()
    }

    /// Standard deviation of the position along the path since the last measurement, metres.
    pub fn sigma(&self, time: Time) -> f64 {
        let seconds = self.measured_at.map_or(0.0, |measured| time.seconds_since(measured));
        let density = DENSITY * self.density.variance_factor();
        // After a long time the scanner may have stopped.
        let stopped = if seconds > LONGEST_UNMEASURED { 0.5 * self.velocity.speed } else { 0.0 };
        let velocity_variance = self.velocity.sigma.powi(2) + stopped.powi(2);
        (density * seconds.powi(3) / 3.0 + velocity_variance * seconds.powi(2)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Time {
        Time::from_ticks((seconds * 1e7).round() as i64)
    }

    const KNOWN: Velocity = Velocity { speed: 0.5, sigma: 0.0 };

    /// Follows a scanner with the speed `speed(t)`, m/s, ten times a second.
    fn after(seconds: u32, speed: impl Fn(f64) -> f64) -> UnmeasuredTravel {
        let (mut travel, mut x) = (UnmeasuredTravel::default(), 0.0);
        for i in 0..10 * seconds {
            let time = 0.1 * f64::from(i);
            travel.add_measured(at(time), &Rigid2::new(x, 0.0, 0.0), KNOWN);
            x += 0.1 * speed(time);
        }
        travel.add_unmeasured(at(f64::from(seconds)));
        travel
    }

    #[test]
    fn uncertainty_grows_slowly_at_steady_speed() {
        let (steady, unsteady) = (after(200, |_| 0.3), after(200, |t| 0.5 + 0.5 * t.sin()));
        let off = |travel: &UnmeasuredTravel, seconds| travel.sigma(at(199.9 + seconds));
        let (little, much) = (off(&steady, 1.5), off(&unsteady, 1.5));
        assert!(little < 0.1 && much > 0.3, "{little}, {much}");
        assert!(off(&steady, 3.0) > 0.5, "it may have stopped");
        assert!(!steady.rested() && UnmeasuredTravel::default().rested());
    }

    /// The mean square of the difference of mean speeds is that of the model.
    #[test]
    fn white_acceleration_is_measured() {
        let mut random = portolan_numeric::SplitMix64::new(3);
        let (mut travel, mut x, mut speed) = (UnmeasuredTravel::default(), 0.0, 0.0);
        for i in 0..20_000 {
            travel.add_measured(at(0.1 * f64::from(i)), &Rigid2::new(x, 0.0, 0.0), KNOWN);
            // Uniform, with the variance 0.04 m²/s³ · 0.1 s.
            speed += (12.0_f64 * 0.004).sqrt() * (random.uniform() - 0.5);
            x += 0.1 * (5.0 + speed);
        }
        let density = DENSITY * travel.density.variance_factor();
        assert!((0.02..0.08).contains(&density), "{density}");
    }
}
