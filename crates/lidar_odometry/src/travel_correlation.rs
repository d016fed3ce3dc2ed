//! A second, independent measurement of the distance travelled, which does not use planes: upright
//! structures in the newest sweeps are correlated with those in sweeps about a second before. Where single
//! sweeps are so sparse that two of them do not constrain the shift, those of half a second together do;
//! and within a second a wrong velocity amounts to metres.
//!
//! It measures translations that are degenerate for planes and that no sensor measures. Cars ahead are the
//! densest structure that a sparse lidar sees, and they move with the platform: the search is limited to
//! the range that accelerations allow since the last measurement. The result is the mean of all shifts by
//! their likelihood ([`crate::shift_likelihood`]), and none where most of them remain possible.

use std::collections::VecDeque;

use portolan_geometry::nalgebra as na;
use portolan_geometry::{Point3f, Time, Vector3, to_f32};

use crate::correlation::{CorrelationReference, above_others};
use crate::segment::{MotionSource, SegmentCorrection, TrajectorySegment};
use crate::settings::{CorrelationSettings, MotionPriorSettings, OdometrySettings, WitnessSettings};
use crate::sweep::Sweep;

/// Upright structures of the last sweeps, and the translations that planes do not constrain.
#[derive(Clone)]
pub(crate) struct TravelCorrelation {
    settings: WitnessSettings,
    /// Limits the error of the assumed motion to that by unmeasured accelerations since the last
    /// agreement.
    prior: MotionPriorSettings,
    correlation: CorrelationSettings,
    /// Maximum number of points of a sweep that are used: twice as many as are registered, as only some
    /// are upright.
    max_points: usize,
    /// Number of neighbouring points, and so voxels, that count as one, since they share their errors.
    points_per_independent_one: f64,
    /// Oldest first.
    seen: VecDeque<Seen>,
    attempted_at: Option<Time>,
    /// The last measurement along all degenerate translations.
    last_measurement: Option<TravelMeasurement>,
    /// Degenerate translations of the last sweep, in the local map, orthonormal.
    open: Vec<Vector3>,
    /// Time since which there has been a horizontal one among them.
    open_since: Option<Time>,
}

/// Time of a measurement, and its standard deviation, metres.
#[derive(Clone, Copy)]
struct TravelMeasurement {
    at: Time,
    sigma: f64,
}

/// Points of a sweep in the local map.
#[derive(Clone)]
struct Seen {
    end: Time,
    /// Position of the scanner.
    place: Vector3,
    points: Vec<Point3f>,
    /// The upright ones, once they have been selected.
    upright: Option<Vec<Point3f>>,
}

/// Difference between the actual and the assumed motion, in the local map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Discrepancy {
    /// Metres, until now.
    pub shift: Vector3,
    /// Time over which it arose, seconds.
    pub seconds: f64,
    /// Power of time with which it grew: 2 where the velocity was correct and changed, 1 where it was
    /// wrong from the beginning.
    pub power: i32,
}

impl TravelCorrelation {
    pub fn new(settings: &OdometrySettings) -> Self {
        let (prior, correlation) = (settings.motion_prior.clone(), settings.correlation.clone());
        let max_points = 2 * settings.sweep.wanted_points as usize;
        let points_per_independent_one = settings.registration.points_per_independent_one;
        let settings = settings.witness.clone();
        let (seen, open) = (VecDeque::new(), Vec::new());
        Self {
            settings,
            prior,
            correlation,
            max_points,
            points_per_independent_one,
            seen,
            attempted_at: None,
            last_measurement: None,
            open,
            open_since: None,
        }
    }

    /// Adds a registered sweep: its points in the local map, and the position of the scanner.
    pub fn add(&mut self, end: Time, points: &[Point3f], place: &Vector3) {
        let longest = self.settings.span + self.group();
        while self.seen.front().is_some_and(|first| end.seconds_since(first.end) > longest) {
            self.seen.pop_front();
        }
        let seen = self.seen(end, points.iter().copied(), points.len(), place);
        self.seen.push_back(seen);
    }

    /// Takes the translations since `start` that a sweep leaves degenerate for planes, orthonormal, in the
    /// local map.
    pub fn set_degenerate(&mut self, start: Time, open: Vec<Vector3>) {
        self.open_since = match open.iter().any(is_horizontal) {
            true => self.open_since.or(Some(start)),
            false => None,
        };
        self.open = open;
    }

    /// Whether the degenerate translations were measured recently.
    pub fn measured_recently(&self, end: Time) -> bool {
        self.last_measurement.is_some_and(|last| end.seconds_since(last.at) <= self.settings.span)
    }

    /// Whether the distance travelled is a guess: a horizontal translation has been degenerate, and
    /// unmeasured here, for 1.5 times the span between the compared sweeps.
    pub fn is_guess(&self, end: Time) -> bool {
        let is_long =
            |since: Option<Time>| since.is_none_or(|s| end.seconds_since(s) > 1.5 * self.settings.span);
        self.open_since.is_some()
            && is_long(self.open_since)
            && is_long(self.last_measurement.map(|last| last.at))
    }

    /// Difference between the actual and the predicted motion along degenerate translations; none if the
    /// prediction is kept. To be called for each sweep before it is registered.
    pub fn measure(&mut self, sweep: &Sweep, segment: &TrajectorySegment) -> Option<Discrepancy> {
        if segment.source.is_measured() || self.open.is_empty() {
            return None;
        }
        let is_due = |attempted| sweep.end.seconds_since(attempted) > self.settings.interval;
        if !self.attempted_at.is_none_or(is_due) {
            return None;
        }
        self.attempted_at = Some(sweep.end);
        let (end, to_end) = (segment.end(), segment.deskewing(&SegmentCorrection::default()));
        let (local_from_end, here) = (to_f32(&end), end.translation.vector);
        let points = sweep.points.iter().map(|p| local_from_end * to_end.moved(&p.position, p.time));
        let now = self.seen(sweep.end, points, sweep.points.len(), &here);
        let discrepancy = self.compare(now)?;
        // A shift below the resolution of the correlation may be noise, and an accelerometer is more
        // precise.
        if segment.source != MotionSource::ConstantVelocity
            && discrepancy.shift.norm() < self.correlation.resolution()
        {
            return None;
        }
        self.correct(sweep.end, &discrepancy);
        Some(discrepancy)
    }

    fn seen(&self, end: Time, points: impl Iterator<Item = Point3f>, count: usize, place: &Vector3) -> Seen {
        let stride = count.div_ceil(self.max_points).max(1);
        Seen { end, place: *place, points: points.step_by(stride).collect(), upright: None }
    }

    /// Compares a sweep at its assumed pose, and those right before it, with those about a second before.
    /// None where the shift is not measured: not more precisely than before, or not to within a cell.
    fn compare(&mut self, mut now: Seen) -> Option<Discrepancy> {
        self.seen.iter_mut().chain([&mut now]).for_each(|seen| seen.pick(&self.correlation));
        let sigma = self.sigma(now.end);
        let group = self.group();
        let age = |seen: &Seen| now.end.seconds_since(seen.end);
        let oldest = age(self.seen.front()?);
        let (half, span) = (0.5 * group, self.settings.span.min(oldest - 0.5 * group));
        let is_before = |seen: &&Seen| (age(seen) - span).abs() <= half;
        let before: Vec<&Seen> = self.seen.iter().filter(is_before).collect();
        let after: Vec<&Seen> = self.seen.iter().filter(|seen| age(seen) < half).chain([&now]).collect();
        if before.is_empty() || span < group {
            return None;
        }
        let here = now.place.cast::<f32>();
        let at_scanner = |points: &mut dyn Iterator<Item = &Point3f>| -> Vec<Point3f> {
            points.map(|p| p - here).collect()
        };
        // All points are used as reference, upright or not: a structure that beams meet only in part does
        // not count as upright.
        let all_before = at_scanner(&mut before.iter().flat_map(|seen| &seen.points));
        let reference = CorrelationReference::new(&all_before, &self.correlation);
        let upright_after = at_scanner(&mut after.iter().flat_map(|seen| seen.upright.iter().flatten()));
        let mean_place = before.iter().map(|seen| seen.place).sum::<Vector3>() / before.len() as f64;
        let seen_from = mean_place - now.place;
        let along = self.horizontal_directions();
        let posterior = reference.posterior(
            &seen_from,
            &upright_after,
            &along,
            sigma,
            self.points_per_independent_one,
        )?;
        let remaining = sigma * posterior.remaining_variance.sqrt();
        let mean_age = |group: &[&Seen]| group.iter().map(|seen| age(seen)).sum::<f64>() / group.len() as f64;
        let seconds = mean_age(&before) - mean_age(&after);
        if !self.correlation.is_measured(sigma, remaining) {
            return None;
        }
        let power = if self.measured_recently(now.end) { 2 } else { 1 };
        self.last_measurement =
            Some(TravelMeasurement { at: now.end, sigma: remaining.max(self.correlation.resolution()) });
        let shift = posterior.shift * self.correlation.shrinkage(posterior.shift.norm());
        Some(Discrepancy { shift, seconds, power })
    }

    /// Horizontal degenerate directions, orthonormal.
    pub fn horizontal_directions(&self) -> Vec<na::Vector2<f64>> {
        let mut found: Vec<na::Vector2<f64>> = Vec::new();
        for open in self.open.iter().filter(|open| is_horizontal(open)) {
            let rest = found.iter().fold(open.xy(), |rest, other| rest - other * other.dot(&rest));
            found.extend(rest.try_normalize(0.1));
        }
        found
    }

    /// Time over which sweeps are combined, seconds: several thousand points where single ones have 1,400.
    fn group(&self) -> f64 {
        0.5 * self.settings.span
    }

    /// Standard deviation of the assumed motion, metres.
    fn sigma(&self, end: Time) -> f64 {
        let unknown = self.correlation.unknown();
        self.last_measurement.map_or(unknown, |last| {
            (last.sigma + self.prior.by_acceleration(end.seconds_since(last.at))).min(unknown)
        })
    }

    /// Moves the stored sweeps by a discrepancy.
    fn correct(&mut self, end: Time, discrepancy: &Discrepancy) {
        for seen in &mut self.seen {
            let shift = discrepancy.shift_at(end.seconds_since(seen.end)).cast::<f32>();
            seen.points.iter_mut().chain(seen.upright.iter_mut().flatten()).for_each(|p| *p += shift);
            seen.place += shift.cast::<f64>();
        }
    }
}

/// Whether a direction in a level frame is nearer to horizontal than to vertical.
pub(crate) fn is_horizontal(direction: &Vector3) -> bool {
    direction.z.abs() < std::f64::consts::FRAC_1_SQRT_2
}

impl Seen {
    /// Selects the upright points.
    fn pick(&mut self, settings: &CorrelationSettings) {
        let here = self.place.cast::<f32>();
        let points = &self.points;
        self.upright.get_or_insert_with(|| {
            let at_scanner: Vec<Point3f> = points.iter().map(|p| p - here).collect();
            above_others(&at_scanner, settings).iter().map(|p| p + here).collect()
        });
    }
}

impl Discrepancy {
    /// The shift at this time before now, seconds.
    fn shift_at(&self, age: f64) -> Vector3 {
        self.shift * (1.0 - age / self.seconds.max(1e-3)).max(0.0).powi(self.power)
    }

    /// The prediction, corrected by the discrepancy.
    pub fn applied_to(&self, predicted: &TrajectorySegment) -> TrajectorySegment {
        let seconds = predicted.seconds();
        predicted.clone().changed(|since, pose| pose.translation.vector += self.shift_at(seconds - since))
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::{Duration, Rigid3};

    use super::*;
    use crate::sweep::SweepPoint;
    use crate::testing::street;

    fn time(seconds: f64) -> Time {
        Time::from_unix_seconds(100.0) + Duration::from_seconds(seconds)
    }

    /// The final result along a street, where a car moved differently than assumed: metres along x at a
    /// time.
    fn discrepancy(
        moved: fn(f64) -> f64,
        assumed: fn(f64) -> f64,
        source: MotionSource,
    ) -> (TravelCorrelation, Option<Discrepancy>) {
        let mut travel = TravelCorrelation::new(&OdometrySettings::default());
        let pose = |x: f64| Rigid3::translation(x, 0.0, 0.0);
        for at in (0..14).map(|i| 0.1 * f64::from(i)) {
            let place = pose(assumed(at));
            let points: Vec<Point3f> = street(&pose(moved(at))).iter().map(|p| to_f32(&place) * p).collect();
            travel.add(time(at), &points, &place.translation.vector);
            travel.set_degenerate(time(at), vec![Vector3::x()]);
        }
        let points = street(&pose(moved(1.4)));
        let points = points.iter().map(|p| SweepPoint { time: 0.0, position: *p, intensity: 0.0 }).collect();
        let mut segment =
            TrajectorySegment::new(time(1.3), time(1.4), |t| pose(assumed(t.seconds_since(time(0.0)))));
        segment.source = source;
        let found = travel.measure(&Sweep { end: time(1.4), points }, &segment);
        (travel, found)
    }

    #[test]
    fn a_wrong_velocity_is_detected_and_corrected() {
        let (_, found) = discrepancy(|t| 4.0 * t, |t| 2.0 * t, MotionSource::ConstantVelocity);
        let found = found.unwrap();
        // It was wrong from the beginning.
        let error = found.shift - Vector3::x() * (2.0 * found.seconds);
        assert!(error.norm() < 0.15 && found.seconds > 0.8, "{found:?}");
        let predicted = TrajectorySegment::new(time(1.3), time(1.4), |t| {
            Rigid3::translation(2.0 * t.seconds_since(time(0.0)), 0.0, 0.0)
        });
        let corrected = found.applied_to(&predicted);
        assert!((corrected.end().translation.x - predicted.end().translation.x - found.shift.x).abs() < 1e-9);
        assert!((corrected.translation().x - 0.4).abs() < 0.03, "{}", corrected.translation());
    }

    #[test]
    fn correct_and_measured_motions_are_not_corrected() {
        let (travel, right) = discrepancy(|t| 4.0 * t, |t| 4.0 * t, MotionSource::ConstantVelocity);
        assert!(right.unwrap().shift.norm() < 0.1 && travel.measured_recently(time(1.4)), "{right:?}");
        let (_, measured) = discrepancy(|t| 4.0 * t, |t| 2.0 * t, MotionSource::Standing);
        assert_eq!(measured, None);
        let inertial = MotionSource::Inertial { velocity_sigma: 0.1 };
        // Below the resolution of a correlation, and above.
        assert_eq!(discrepancy(|t| 4.0 * t, |t| 3.9 * t, inertial).1, None);
        assert!(discrepancy(|t| 4.0 * t, |t| 3.0 * t, inertial).1.unwrap().shift.x > 0.7);
    }

    /// Walls of a corridor along x as far as the scanner sees them, with posts between them if
    /// `has_posts`.
    fn corridor(seen_from: f32, has_posts: bool) -> Vec<Point3f> {
        let column = |x: f32, y: f32| (0..12).map(move |k| Point3f::new(x, y, 0.25 * k as f32 - 1.2));
        let walls = (-12..=12).flat_map(|i| [-1.5, 1.5].map(|y| column(0.3 * i as f32, y)));
        let mut points: Vec<Point3f> = walls.flatten().collect();
        let posts = (-4..=4)
            .map(|i| 2.3 * i as f32 + 0.3 * (i * i % 5) as f32 - seen_from)
            .filter(|x| has_posts && x.abs() < 9.0);
        points.extend(posts.flat_map(|x| [-0.9, 0.9].map(|y| column(x, y))).flatten());
        points
    }

    #[test]
    fn posts_constrain_the_travel_along_a_corridor_and_uniform_walls_do_not() {
        let guesses_after = |has_posts: bool| {
            let mut travel = TravelCorrelation::new(&OdometrySettings::default());
            for i in 0..30 {
                let (at, x) = (0.1 * f64::from(i), 0.1 * i as f32);
                let points = corridor(x, has_posts);
                let sweep_points =
                    points.iter().map(|p| SweepPoint { time: 0.0, position: *p, intensity: 0.0 });
                let sweep = Sweep { end: time(at), points: sweep_points.collect() };
                let pose = move |t: Time| Rigid3::translation(t.seconds_since(time(0.0)), 0.0, 0.0);
                let segment = TrajectorySegment::new(time(at - 0.1), time(at), pose);
                travel.measure(&sweep, &segment);
                let in_local: Vec<Point3f> =
                    points.iter().map(|p| p + Vector3::x().cast::<f32>() * x).collect();
                travel.add(time(at), &in_local, &(Vector3::x() * f64::from(x)));
                travel.set_degenerate(time(at), vec![Vector3::x()]);
            }
            (travel.is_guess(time(2.9)), travel.measured_recently(time(2.9)))
        };
        assert_eq!([false, true].map(guesses_after), [(true, false), (false, true)]);
    }

    #[test]
    fn without_upright_structures_the_travel_becomes_a_guess() {
        let mut travel = TravelCorrelation::new(&OdometrySettings::default());
        let guessed: Vec<bool> = (0..40)
            .map(|i| {
                let at = time(0.1 * f64::from(i));
                travel.set_degenerate(at, vec![if i < 5 { Vector3::z() } else { Vector3::y() }]);
                travel.is_guess(at)
            })
            .collect();
        assert_eq!(guessed.iter().position(|guess| *guess), Some(21));
    }

    #[test]
    fn a_long_gap_along_which_the_distance_is_degenerate_is_a_guess_at_once() {
        let after_gap = |seconds: f64, open: Vector3| {
            let mut travel = TravelCorrelation::new(&OdometrySettings::default());
            travel.set_degenerate(time(1.0), Vec::new());
            travel.set_degenerate(time(1.0), vec![open]);
            travel.is_guess(time(1.0 + seconds))
        };
        assert!(after_gap(4.0, Vector3::x()));
        assert!(!after_gap(4.0, Vector3::z()) && !after_gap(0.1, Vector3::x()));
    }
}
