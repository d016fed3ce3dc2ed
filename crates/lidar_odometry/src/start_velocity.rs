//! Estimates the initial velocity during the first sweeps, along a direction that planes do not constrain.
//!
//! Two sweeps a tenth of a second apart determine a velocity only to several metres a second, since they
//! are compared in cells of half a metre. Sweeps a second apart determine it to a twentieth of that,
//! but at the distance between posts other velocities fit as well. So all pairs are compared: the late
//! ones refine the rough estimate of the close ones. The likelihoods of all pairs are functions of the
//! error of the velocity and of an unknown acceleration (a histogram filter, as in
//! [`crate::shift_likelihood`]).

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Point3f, Vector3, to_f32};
use portolan_numeric::{median, probabilities};

use crate::correlation::{CorrelationReference, above_others};
use crate::settings::OdometrySettings;
use crate::settings::constants::initialise::ACCELERATION_STEPS;
use crate::settings::constants::shift_likelihood::REACH_SIGMAS;
use crate::shift_likelihood::Shifts;
use crate::tracker::RegisteredSweep;

/// The first sweeps at their assumed poses.
pub(crate) struct FirstSweepsPlaced<'a> {
    settings: &'a OdometrySettings,
    /// Oldest first.
    sweeps: Vec<PlacedSweep>,
}

/// A sweep in the local map, relative to the position of the last one.
struct PlacedSweep {
    /// Since the end of the first one.
    seconds: f64,
    /// Position of the scanner.
    place: Vector3,
    points: Vec<Point3f>,
    upright: Vec<Point3f>,
}

/// Error of the assumed motion.
#[derive(Clone, Copy)]
struct Motion {
    /// At the first sweep, m/s.
    velocity: f64,
    /// m/s².
    acceleration: f64,
}

/// Likelihood of shifts from one sweep to another.
struct Pair {
    /// Times of both sweeps, seconds.
    from: f64,
    to: f64,
    /// Log-likelihoods of evenly spaced shifts, relative to their median.
    logs: Vec<f64>,
    /// Distance between shifts, metres.
    step: f64,
    /// Index of the zero shift.
    middle: f64,
}

impl<'a> FirstSweepsPlaced<'a> {
    /// Uses the sweeps within the span of the travel correlation only, since velocities change.
    pub fn new(registered: &[RegisteredSweep], settings: &'a OdometrySettings) -> Self {
        let first_end = registered.first().map(|first| first.sweep.end);
        let seconds =
            |sweep: &RegisteredSweep| first_end.map_or(0.0, |first| sweep.sweep.end.seconds_since(first));
        let place = |sweep: &RegisteredSweep| sweep.local_from_tracking.translation.vector;
        let soon = registered.partition_point(|sweep| seconds(sweep) <= settings.witness.span);
        let registered = &registered[..soon];
        let last = registered.last().map_or_else(Vector3::zeros, place);
        let placed = |sweep: &RegisteredSweep| {
            let in_local = sweep.deskewed.returns.transformed(&to_f32(&sweep.local_from_tracking)).points;
            PlacedSweep::new(seconds(sweep), &place(sweep), &in_local, &last, settings)
        };
        Self { settings, sweeps: registered.iter().map(placed).collect() }
    }

    /// Error of the assumed velocity along a horizontal direction at the end of the first sweep, m/s. None
    /// where it is not measured, or is below the resolution of a correlation.
    pub fn velocity_error(&self, direction: &na::Vector2<f64>) -> Option<f64> {
        let correlation = &self.settings.correlation;
        let seconds = self.sweeps.last().map(|last| last.seconds).filter(|seconds| *seconds > 0.0)?;
        let sigmas = Motion {
            velocity: correlation.unknown() / seconds,
            acceleration: self.settings.motion_prior.acceleration / REACH_SIGMAS,
        };
        let pairs = self.pairs(direction, &sigmas);
        let motions = motions(&sigmas, 0.5 * correlation.resolution() / seconds);
        let logs: Vec<f64> = motions
            .iter()
            .map(|motion| {
                motion.log_prior(&sigmas) + pairs.iter().map(|pair| pair.log_of(motion)).sum::<f64>()
            })
            .collect();
        let probabilities = probabilities(&logs);
        let mean = |value: &dyn Fn(&Motion) -> f64| -> f64 {
            motions.iter().zip(&probabilities).map(|(motion, probability)| probability * value(motion)).sum()
        };
        let displacement = mean(&|motion| motion.displacement(seconds));
        let variance = mean(&|motion| (motion.displacement(seconds) - displacement).powi(2));
        let velocity = mean(&|motion| motion.velocity);
        let is_measured = correlation.is_measured(sigmas.spread(0.0, seconds), variance.sqrt());
        (is_measured && displacement.abs() >= correlation.resolution())
            .then(|| velocity * correlation.shrinkage(displacement))
    }

    /// Likelihoods of the shifts between all pairs of sweeps. Those of one sweep and several earlier ones
    /// are not independent: together they count once.
    fn pairs(&self, direction: &na::Vector2<f64>, sigmas: &Motion) -> Vec<Pair> {
        let correlation = &self.settings.correlation;
        let per = self.settings.registration.points_per_independent_one;
        let directions = [*direction];
        let mut pairs = Vec::new();
        for (i, before) in self.sweeps.iter().enumerate() {
            let reference = CorrelationReference::new(&before.points, correlation);
            for (j, after) in self.sweeps.iter().enumerate().skip(i + 1) {
                let (from, to) = (before.seconds, after.seconds);
                let Some(shifts) = Shifts::new(&directions, sigmas.spread(from, to), correlation) else {
                    continue;
                };
                let logs = reference.log_likelihoods(&before.place, &after.upright, &shifts, per);
                let Some(mut logs) = logs else { continue };
                let usual = median(&mut logs.clone()).unwrap_or(0.0);
                logs.iter_mut().for_each(|log| *log = (*log - usual) / j as f64);
                pairs.push(Pair { from, to, logs, step: shifts.step, middle: shifts.reach.into() });
            }
        }
        pairs
    }
}

impl PlacedSweep {
    /// A sweep with these points in the local map.
    fn new(
        seconds: f64,
        place: &Vector3,
        in_local: &[Point3f],
        last: &Vector3,
        settings: &OdometrySettings,
    ) -> Self {
        let seen_from = |place: &Vector3| -> Vec<Point3f> {
            let place = place.cast::<f32>();
            in_local.iter().map(|p| p - place).collect()
        };
        let upright = above_others(&seen_from(place), &settings.correlation);
        let place = place - last;
        let to_last = place.cast::<f32>();
        let upright = upright.iter().map(|p| p + to_last).collect();
        Self { seconds, place, points: seen_from(last), upright }
    }
}

/// All motions that are tested.
fn motions(sigmas: &Motion, velocity_step: f64) -> Vec<Motion> {
    let velocities = (REACH_SIGMAS * sigmas.velocity / velocity_step).ceil() as i32;
    let acceleration_step = REACH_SIGMAS * sigmas.acceleration / f64::from(ACCELERATION_STEPS);
    let with = |i: i32| {
        (-ACCELERATION_STEPS..=ACCELERATION_STEPS).map(move |j| Motion {
            velocity: f64::from(i) * velocity_step,
            acceleration: f64::from(j) * acceleration_step,
        })
    };
    (-velocities..=velocities).flat_map(with).collect()
}

impl Motion {
    /// Displacement until a time, seconds after the first sweep, metres.
    fn displacement(&self, seconds: f64) -> f64 {
        self.velocity * seconds + 0.5 * self.acceleration * seconds * seconds
    }

    fn log_prior(&self, sigmas: &Self) -> f64 {
        let of = |value: f64, sigma: f64| -0.5 * (value / sigma).powi(2);
        of(self.velocity, sigmas.velocity) + of(self.acceleration, sigmas.acceleration)
    }

    /// For standard deviations: that of the displacement from one time to another.
    fn spread(&self, from: f64, to: f64) -> f64 {
        (self.velocity * (to - from)).hypot(0.5 * self.acceleration * (to * to - from * from))
    }
}

impl Pair {
    /// The log-likelihood of a motion. A shift outside the tested range has that of most shifts.
    fn log_of(&self, motion: &Motion) -> f64 {
        let shift = motion.displacement(self.to) - motion.displacement(self.from);
        let at = shift / self.step + self.middle;
        let log = |i: f64| (i >= 0.0).then(|| self.logs.get(i as usize)).flatten();
        match (log(at.floor()), log(at.floor() + 1.0)) {
            (Some(low), Some(high)) => low + (high - low) * at.fract(),
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(x: f64, y: f64) -> impl Iterator<Item = Point3f> {
        (0..8).map(move |k| Point3f::new(x as f32, y as f32, 0.25 * k as f32 - 1.0))
    }

    /// Estimated error of the assumed velocity of a car that drove along x at 15 m/s and accelerated, from
    /// the first ten sweeps. Posts stand beside the road, a guard rail is seen up to 40 m ahead and
    /// behind, and another car remains beside this one.
    fn estimated_error(assumed: f64, acceleration: f64, posts: &[f64]) -> Option<f64> {
        let settings = OdometrySettings::default();
        let place = |velocity: f64, seconds: f64| Vector3::x() * velocity * seconds;
        let moved = |seconds: f64| 15.0 * seconds + 0.5 * acceleration * seconds * seconds;
        let last = place(assumed, 0.9);
        let sweeps = (0..10).map(|i| {
            let seconds = 0.1 * f64::from(i);
            let rail = (-100..=100).map(|i| (0.4 * f64::from(i), -4.0));
            let posts = posts.iter().map(|x| (x - moved(seconds), 6.1)).filter(|(x, _)| x.abs() < 50.0);
            let car = (0..5).flat_map(|i| [3.0, 4.6].map(|y| (8.1 + 0.9 * f64::from(i), y)));
            let from = place(assumed, seconds);
            let points: Vec<Point3f> =
                rail.chain(posts).chain(car).flat_map(|(x, y)| column(x + from.x, y)).collect();
            PlacedSweep::new(seconds, &from, &points, &last, &settings)
        });
        let placed = FirstSweepsPlaced { settings: &settings, sweeps: sweeps.collect() };
        placed.velocity_error(&na::Vector2::x())
    }

    const POSTS: [f64; 11] = [-43.7, -38.1, -29.2, -20.4, -6.7, 4.9, 17.2, 25.9, 31.8, 42.3, 57.6];

    #[test]
    fn posts_reveal_a_wrong_velocity() {
        for (assumed, acceleration) in [(12.0, 0.0), (18.5, 0.0), (13.5, -2.0)] {
            let error = estimated_error(assumed, acceleration, &POSTS).unwrap();
            assert!((assumed + error - 15.0).abs() < 0.6, "{assumed} {acceleration}: {error}");
        }
    }

    #[test]
    fn correct_and_unconstrained_velocities_are_kept() {
        assert_eq!(estimated_error(15.0, 0.0, &POSTS), None);
        // A guard rail alone, and a car that drives as fast as this one.
        assert_eq!(estimated_error(12.0, 0.0, &[]), None);
    }
}
