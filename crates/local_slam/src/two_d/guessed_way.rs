//! How far the scanner may be from where it is believed, along a way that nothing told.
//!
//! Where neither scans nor odometry tell how far it went, it is taken to go on as fast as before. Its velocity changes meanwhile as
//! in a random walk: white acceleration of the spectral density `q`, and with the error `s` of the velocity at the beginning
//! the way is off by `σ² = q t³ / 3 + s² t²` after the time `t` (Bar-Shalom, Li, Kirubarajan 2001, "Estimation with Applications to
//! Tracking and Navigation", 6.2.2). How large `q` is the same scanner tells where scans tell its way: the mean speeds
//! of successive stretches of `t₁` and `t₂` differ by `q (t₁ + t₂) / 3` in the mean square.

use portolan_geometry::{Rigid2, Time};
use portolan_numeric::CovarianceMatching;

use super::motion::LONGEST_UNMEASURED;

/// Spectral density of the acceleration before anything was learned, m²/s³: the speed changes by half a metre per second
/// within a second.
const DENSITY: f64 = 0.25;
/// About so many stretches are remembered.
const MEMORY: f64 = 50.0;
/// Of at least so many seconds, over which errors of poses hardly count.
const STRETCH: f64 = 1.0;
/// More slowly, m/s, it may as well stand.
const SLOW: f64 = 0.1;

/// What is known of the velocity of the scanner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Velocity {
    /// m/s.
    pub speed: f64,
    /// Standard deviation, m/s.
    pub sigma: f64,
}

impl Velocity {
    /// Whether it may as well stand: constant velocity guesses little then.
    pub fn is_rest(&self) -> bool {
        self.speed < SLOW
    }
}

/// A stretch in which scans told the way throughout.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    from: (Time, Rigid2),
    /// Seconds and mean speed, m/s, of the stretch before, which ended where this one began.
    before: Option<(f64, f64)>,
}

/// What was learned of changes of speed, and since when nothing has told the way.
#[derive(Clone, Copy, Debug)]
pub(super) struct GuessedWay {
    told: Option<Time>,
    /// Then.
    velocity: Velocity,
    density: CovarianceMatching,
    stretch: Option<Stretch>,
}

impl Default for GuessedWay {
    fn default() -> Self {
        let density = CovarianceMatching::new(MEMORY);
        Self { told: None, velocity: Velocity { speed: 0.0, sigma: 0.0 }, density, stretch: None }
    }
}

impl GuessedWay {
    /// The way to here was told by scans or odometry, or the scanner rests.
    pub fn add_known(&mut self, time: Time, pose: &Rigid2, velocity: Velocity) {
        (self.told, self.velocity) = (Some(time), velocity);
        let Some(stretch) = self.stretch else {
            self.stretch = Some(Stretch { from: (time, *pose), before: None });
            return;
        };
        let seconds = time.seconds_since(stretch.from.0);
        if seconds < STRETCH {
            return;
        }
        let speed = (pose.translation - stretch.from.1.translation).norm() / seconds;
        if let Some((seconds_before, speed_before)) = stretch.before {
            let density = 3.0 * (speed - speed_before).powi(2) / (seconds + seconds_before);
            self.density.add(density / DENSITY);
        }
        self.stretch = Some(Stretch { from: (time, *pose), before: Some((seconds, speed)) });
    }

    /// Nothing told the way to here.
    pub fn is_guessed(&mut self, time: Time) {
        self.stretch = None;
        self.told.get_or_insert(time);
    }

    /// Whether it rested when its way was told last, or nothing has ever told it.
    pub fn rested(&self) -> bool {
        self.told.is_none() || self.velocity.is_rest()
    }

    /// How far the way to here may be off if nothing has told it since it was told last, metres.
    pub fn sigma(&self, time: Time) -> f64 {
        let seconds = self.told.map_or(0.0, |told| time.seconds_since(told));
        let density = DENSITY * self.density.variance_factor();
        // After long it may as well have stopped.
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
    fn after(seconds: u32, speed: impl Fn(f64) -> f64) -> GuessedWay {
        let (mut way, mut x) = (GuessedWay::default(), 0.0);
        for i in 0..10 * seconds {
            let time = 0.1 * f64::from(i);
            way.add_known(at(time), &Rigid2::new(x, 0.0, 0.0), KNOWN);
            x += 0.1 * speed(time);
        }
        way.is_guessed(at(f64::from(seconds)));
        way
    }

    #[test]
    fn a_scanner_that_hardly_changes_its_speed_is_followed_for_longer() {
        let (steady, unsteady) = (after(200, |_| 0.3), after(200, |t| 0.5 + 0.5 * t.sin()));
        let off = |way: &GuessedWay, seconds| way.sigma(at(199.9 + seconds));
        let (little, much) = (off(&steady, 1.5), off(&unsteady, 1.5));
        assert!(little < 0.1 && much > 0.3, "{little}, {much}");
        assert!(off(&steady, 3.0) > 0.5, "it may have stopped");
        assert!(!steady.rested() && GuessedWay::default().rested());
    }

    /// The mean square of the difference of mean speeds is that of the model.
    #[test]
    fn white_acceleration_is_measured() {
        let mut random = portolan_numeric::SplitMix64::new(3);
        let (mut way, mut x, mut speed) = (GuessedWay::default(), 0.0, 0.0);
        for i in 0..20_000 {
            way.add_known(at(0.1 * f64::from(i)), &Rigid2::new(x, 0.0, 0.0), KNOWN);
            // Uniform, with the variance 0.04 m²/s³ · 0.1 s.
            speed += (12.0_f64 * 0.004).sqrt() * (random.uniform() - 0.5);
            x += 0.1 * (5.0 + speed);
        }
        let density = DENSITY * way.density.variance_factor();
        assert!((0.02..0.08).contains(&density), "{density}");
    }
}
