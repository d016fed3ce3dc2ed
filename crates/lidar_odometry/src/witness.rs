//! A second witness of the way travelled, which knows nothing of planes: what stands upright in the newest sweeps, correlated
//! with what stood upright in sweeps about a second before. Where single sweeps are so sparse that two of them tell nothing,
//! those of half a second together do; and within a second a wrong velocity shows as metres.
//!
//! Where planes leave translations open, and no sensor measures them, the witness tells them. Cars ahead are the densest
//! thing that a sparse lidar sees, and they move along: what is believed is looked for no farther off than an acceleration can
//! have taken it since the witness last agreed, and a place that agrees with what is believed counts before others.

use std::collections::VecDeque;

use portolan_geometry::{Point3f, Rigid3, Time, Vector3, to_f32};

use crate::correlation::{Peak, UprightReference, Window, upright};
use crate::segment::{MotionSource, SegmentCorrection, TrajectorySegment};
use crate::settings::{CorrelationSettings, MotionPriorSettings, OdometrySettings, WitnessSettings};
use crate::sweep::Sweep;

/// What stood upright in the last sweeps, and what planes leave open.
#[derive(Clone)]
pub(crate) struct Witness {
    settings: WitnessSettings,
    /// What is believed goes wrong by no more than unseen accelerations since the witness last agreed.
    prior: MotionPriorSettings,
    correlation: CorrelationSettings,
    /// So many points of a sweep are looked at, at most: twice as many as are registered, as only some stand upright.
    max_points: usize,
    /// Where less of the newest sweeps is met again, it is chance, as where less of a sweep lies on planes.
    least_share: f64,
    /// Oldest first.
    seen: VecDeque<Seen>,
    asked_at: Option<Time>,
    /// When it last told anything.
    told_at: Option<Time>,
    /// When it last agreed with what was believed, and with nothing else.
    agreed_at: Option<Time>,
    /// Translations that planes left open in the last sweep, in the local map, orthonormal.
    open: Vec<Vector3>,
    /// Since when horizontal ones among them are.
    open_since: Option<Time>,
}

/// Points of a sweep in the local map.
#[derive(Clone)]
struct Seen {
    end: Time,
    /// Where it was taken.
    place: Vector3,
    points: Vec<Point3f>,
    /// Whether only those are left that stand upright: they are picked when the witness is first asked.
    is_picked: bool,
}

/// How much farther it came than is believed, in the local map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Discrepancy {
    /// Metres, until now.
    pub shift: Vector3,
    /// Seconds that it came about in.
    pub seconds: f64,
    /// With which power of time: 2 where the velocity was right and changed, 1 where it was wrong from the beginning.
    pub power: i32,
}

impl Witness {
    pub fn new(settings: &OdometrySettings) -> Self {
        let (prior, correlation) = (settings.motion_prior.clone(), settings.correlation.clone());
        let max_points = 2 * settings.sweep.wanted_points as usize;
        let least_share = settings.registration.min_matched_fraction;
        let settings = settings.witness.clone();
        let (seen, open) = (VecDeque::new(), Vec::new());
        Self {
            settings,
            prior,
            correlation,
            max_points,
            least_share,
            seen,
            asked_at: None,
            told_at: None,
            agreed_at: None,
            open,
            open_since: None,
        }
    }

    /// Remembers a sweep that was registered: its points in the local map, and where it was taken.
    pub fn add(&mut self, end: Time, points: &[Point3f], place: &Vector3) {
        let longest = self.settings.span + self.group();
        while self.seen.front().is_some_and(|first| end.seconds_since(first.end) > longest) {
            self.seen.pop_front();
        }
        let seen = self.seen(end, points.iter().copied(), points.len(), place);
        self.seen.push_back(seen);
    }

    /// Takes note of the translations that planes leave open in a sweep, orthonormal, in the local map.
    pub fn leaves_open(&mut self, end: Time, open: Vec<Vector3>) {
        self.open_since = match open.iter().any(is_horizontal) {
            true => self.open_since.or(Some(end)),
            false => None,
        };
        self.open = open;
    }

    /// Whether what planes leave open was told lately.
    pub fn has_told(&self, end: Time) -> bool {
        self.told_at.is_some_and(|told| end.seconds_since(told) <= self.settings.span)
    }

    /// Whether planes left the way open, and the witness did not clearly agree with it, for half as long again as it looks back,
    /// so that it is a guess: what it tells of a wrong way may be as wrong.
    pub fn is_guess(&self, end: Time) -> bool {
        let is_long =
            |since: Option<Time>| since.is_none_or(|s| end.seconds_since(s) > 1.5 * self.settings.span);
        self.open_since.is_some() && is_long(self.open_since) && is_long(self.agreed_at)
    }

    /// How much farther it came than a prediction says, as far as planes left that open; none if nothing is to be changed. To be
    /// asked of each sweep before it is registered.
    pub fn hear(&mut self, sweep: &Sweep, segment: &TrajectorySegment) -> Option<Discrepancy> {
        if segment.source.is_measured() || self.open.is_empty() {
            return None;
        }
        let is_due = |asked| sweep.end.seconds_since(asked) > self.settings.interval;
        if !self.asked_at.is_none_or(is_due) {
            return None;
        }
        self.asked_at = Some(sweep.end);
        let (end, to_end) = (segment.end(), segment.deskewing(&SegmentCorrection::default()));
        let (local_from_end, here) = (to_f32(&end), end.translation.vector);
        let points = sweep.points.iter().map(|p| local_from_end * to_end.moved(&p.position, p.time));
        let now = self.seen(sweep.end, points, sweep.points.len(), &here);
        let told = self.compare(now)?;
        let shift: Vector3 = self.open.iter().map(|open| open * open.dot(&told.shift)).sum();
        // What a correlation does not resolve is its noise as likely as not, and an accelerometer knows better.
        let (squared, resolution) = (shift.norm_squared(), 0.5 * f64::from(self.correlation.cell));
        if segment.source != MotionSource::ConstantVelocity && squared < resolution * resolution {
            return None;
        }
        let gain = squared / (squared + resolution * resolution);
        let discrepancy = Discrepancy { shift: shift * gain, ..told };
        self.correct(sweep.end, &discrepancy);
        Some(discrepancy)
    }

    fn seen(&self, end: Time, points: impl Iterator<Item = Point3f>, count: usize, place: &Vector3) -> Seen {
        let stride = count.div_ceil(self.max_points).max(1);
        Seen { end, place: *place, points: points.step_by(stride).collect(), is_picked: false }
    }

    /// Compares a sweep where it is believed to have been taken, and those right before it, with those about a second before.
    /// None where that tells nothing.
    fn compare(&mut self, mut now: Seen) -> Option<Discrepancy> {
        let half = 0.5 * self.group();
        let oldest = now.end.seconds_since(self.seen.front()?.end);
        let span = self.settings.span.min(oldest - half);
        if span < self.group() {
            return None;
        }
        self.seen.iter_mut().chain([&mut now]).for_each(|seen| seen.pick(&self.correlation));
        let age = |seen: &&Seen| now.end.seconds_since(seen.end);
        let before: Vec<&Seen> = self.seen.iter().filter(|s| (age(s) - span).abs() <= half).collect();
        let after: Vec<&Seen> = self.seen.iter().filter(|s| age(s) < half).chain([&now]).collect();
        if before.is_empty() {
            return None;
        }
        let mean_age = |group: &[&Seen]| group.iter().map(age).sum::<f64>() / group.len() as f64;
        let at_scanner = |group: &[&Seen]| -> Vec<Point3f> {
            let here = now.place.cast::<f32>();
            group.iter().flat_map(|seen| &seen.points).map(|p| p - here).collect()
        };
        let reach = self.reach(now.end);
        let window = Window { linear: reach + f64::from(self.correlation.cell), angular: 0.0 };
        let reference = UprightReference::of_upright(&at_scanner(&before), &self.correlation);
        let after_at_scanner = at_scanner(&after);
        let peaks = reference.peaks_of_upright(&after_at_scanner, &Rigid3::identity(), window);
        let (shift, agrees) = self.likeliest(&peaks, reach)?;
        let agrees = agrees && self.falls_along_open(&reference, &after_at_scanner, &shift);
        let power = if self.has_told(now.end) { 2 } else { 1 };
        self.told_at = Some(now.end);
        self.agreed_at = if agrees { self.told_at } else { self.agreed_at };
        Some(Discrepancy { shift, seconds: mean_age(&before) - mean_age(&after), power })
    }

    /// Sweeps of so many seconds are put together: several thousand points where single ones have 1,400.
    fn group(&self) -> f64 {
        0.5 * self.settings.span
    }

    /// How far off what is believed may be, metres.
    fn reach(&self, end: Time) -> f64 {
        let since = self.told_at.map_or(f64::MAX, |told| end.seconds_since(told));
        (self.near() + self.prior.by_acceleration(since)).min(self.correlation.farthest)
    }

    /// Places that are no farther apart are one to a correlation, metres.
    fn near(&self) -> f64 {
        1.5 * f64::from(self.correlation.cell)
    }

    /// The place that agrees with what is believed if there is one, else the best if there is no other; with it, whether it
    /// agrees and there is no other. Peaks come in order.
    fn likeliest(&self, peaks: &[Peak], reach: f64) -> Option<(Vector3, bool)> {
        let is_possible =
            |peak: &&Peak| peak.pose.translation.vector.norm() <= reach && peak.share >= self.least_share;
        let peaks: Vec<&Peak> = peaks.iter().filter(is_possible).collect();
        let best = *peaks.first()?;
        let apart =
            |a: &Peak, b: &Rigid3| (a.pose.translation.vector - b.translation.vector).norm() > self.near();
        let agrees = |peak: &&&Peak| {
            !apart(peak, &Rigid3::identity()) && peak.share >= self.correlation.nearly_as_good * best.share
        };
        let agreeing = peaks.iter().find(agrees).copied();
        let found = agreeing.unwrap_or(best);
        let is_clear = !peaks.iter().any(|other| apart(other, &found.pose));
        (is_clear || agreeing.is_some())
            .then(|| (found.pose.translation.vector + found.between, is_clear && agreeing.is_some()))
    }

    /// Whether less is met again to both sides along each horizontal direction that planes leave open. Along a corridor
    /// without doors nearly as much is met wherever it is taken to be.
    fn falls_along_open(&self, reference: &UprightReference, upright: &[Point3f], shift: &Vector3) -> bool {
        let share = |shift: Vector3| reference.share_of_upright(upright, &shift);
        let enough = self.correlation.nearly_as_good * share(*shift);
        let aside = 2.0 * self.near();
        let mut horizontal = self.open.iter().filter(|open| is_horizontal(open));
        horizontal.all(|open| [-aside, aside].iter().all(|by| share(shift + open * *by) < enough))
    }

    /// Moves what was seen where a discrepancy says that it is.
    fn correct(&mut self, end: Time, discrepancy: &Discrepancy) {
        for seen in &mut self.seen {
            let shift = discrepancy.shift_at(end.seconds_since(seen.end)).cast::<f32>();
            seen.points.iter_mut().for_each(|p| *p += shift);
            seen.place += shift.cast::<f64>();
        }
    }
}

fn is_horizontal(direction: &Vector3) -> bool {
    direction.z.abs() < std::f64::consts::FRAC_1_SQRT_2
}

impl Seen {
    /// Keeps what stands upright.
    fn pick(&mut self, settings: &CorrelationSettings) {
        if self.is_picked {
            return;
        }
        let here = self.place.cast::<f32>();
        let at_scanner: Vec<Point3f> = self.points.iter().map(|p| p - here).collect();
        self.points = upright(&at_scanner, settings).iter().map(|p| p + here).collect();
        self.is_picked = true;
    }
}

impl Discrepancy {
    /// How much farther it had come so many seconds ago.
    fn shift_at(&self, age: f64) -> Vector3 {
        self.shift * (1.0 - age / self.seconds.max(1e-3)).max(0.0).powi(self.power)
    }

    /// A prediction corrected by it.
    pub fn applied_to(&self, predicted: &TrajectorySegment) -> TrajectorySegment {
        let seconds = predicted.seconds();
        predicted.clone().changed(|since, pose| pose.translation.vector += self.shift_at(seconds - since))
    }
}

#[cfg(test)]
mod tests {
    use portolan_geometry::Duration;

    use super::*;
    use crate::sweep::SweepPoint;
    use crate::testing::street;

    fn time(seconds: f64) -> Time {
        Time::from_unix_seconds(100.0) + Duration::from_seconds(seconds)
    }

    /// What a witness says in the end along a street, where a car went otherwise than is believed: metres along x at a time.
    fn heard(
        way: fn(f64) -> f64,
        believed: fn(f64) -> f64,
        source: MotionSource,
    ) -> (Witness, Option<Discrepancy>) {
        let mut witness = Witness::new(&OdometrySettings::default());
        let pose = |x: f64| Rigid3::translation(x, 0.0, 0.0);
        for at in (0..14).map(|i| 0.1 * f64::from(i)) {
            let place = pose(believed(at));
            let points: Vec<Point3f> = street(&pose(way(at))).iter().map(|p| to_f32(&place) * p).collect();
            witness.add(time(at), &points, &place.translation.vector);
            witness.leaves_open(time(at), vec![Vector3::x()]);
        }
        let points = street(&pose(way(1.4)));
        let points = points.iter().map(|p| SweepPoint { time: 0.0, position: *p, intensity: 0.0 }).collect();
        let mut segment =
            TrajectorySegment::new(time(1.3), time(1.4), |t| pose(believed(t.seconds_since(time(0.0)))));
        segment.source = source;
        let heard = witness.hear(&Sweep { end: time(1.4), points }, &segment);
        (witness, heard)
    }

    #[test]
    fn a_wrong_velocity_is_seen_and_corrected() {
        let (_, heard) = heard(|t| 4.0 * t, |t| 2.0 * t, MotionSource::ConstantVelocity);
        let heard = heard.unwrap();
        // It was wrong from the beginning.
        let error = heard.shift - Vector3::x() * (2.0 * heard.seconds);
        assert!(error.norm() < 0.15 && heard.seconds > 0.8, "{heard:?}");
        let predicted = TrajectorySegment::new(time(1.3), time(1.4), |t| {
            Rigid3::translation(2.0 * t.seconds_since(time(0.0)), 0.0, 0.0)
        });
        let corrected = heard.applied_to(&predicted);
        assert!((corrected.end().translation.x - predicted.end().translation.x - heard.shift.x).abs() < 1e-9);
        assert!((corrected.translation().x - 0.4).abs() < 0.03, "{}", corrected.translation());
    }

    #[test]
    fn what_is_right_or_measured_is_left_alone() {
        let (witness, right) = heard(|t| 4.0 * t, |t| 4.0 * t, MotionSource::ConstantVelocity);
        assert!(right.unwrap().shift.norm() < 0.1 && witness.has_told(time(1.4)), "{right:?}");
        let (_, measured) = heard(|t| 4.0 * t, |t| 2.0 * t, MotionSource::Standing);
        assert_eq!(measured, None);
        let inertial = MotionSource::Inertial { velocity_sigma: 0.1 };
        // Less than a correlation resolves, and more.
        assert_eq!(heard(|t| 4.0 * t, |t| 3.9 * t, inertial).1, None);
        assert!(heard(|t| 4.0 * t, |t| 3.0 * t, inertial).1.unwrap().shift.x > 0.7);
    }

    /// Walls of a corridor along x as far as the scanner sees them, and posts between them if there are any.
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
    fn along_uniform_walls_the_way_is_a_guess_though_nearly_everything_is_met_again() {
        let guesses_after = |has_posts: bool| {
            let mut witness = Witness::new(&OdometrySettings::default());
            for i in 0..30 {
                let (at, x) = (0.1 * f64::from(i), 0.1 * i as f32);
                let points = corridor(x, has_posts);
                let sweep_points =
                    points.iter().map(|p| SweepPoint { time: 0.0, position: *p, intensity: 0.0 });
                let sweep = Sweep { end: time(at), points: sweep_points.collect() };
                let pose = move |t: Time| Rigid3::translation(t.seconds_since(time(0.0)), 0.0, 0.0);
                let segment = TrajectorySegment::new(time(at - 0.1), time(at), pose);
                witness.hear(&sweep, &segment);
                let in_local: Vec<Point3f> =
                    points.iter().map(|p| p + Vector3::x().cast::<f32>() * x).collect();
                witness.add(time(at), &in_local, &(Vector3::x() * f64::from(x)));
                witness.leaves_open(time(at), vec![Vector3::x()]);
            }
            assert!(witness.has_told(time(2.9)));
            witness.is_guess(time(2.9))
        };
        assert!(guesses_after(false) && !guesses_after(true));
    }

    #[test]
    fn where_nothing_stands_upright_the_way_is_a_guess_after_a_while() {
        let mut witness = Witness::new(&OdometrySettings::default());
        let guessed: Vec<bool> = (0..40)
            .map(|i| {
                let at = time(0.1 * f64::from(i));
                witness.leaves_open(at, vec![if i < 5 { Vector3::z() } else { Vector3::y() }]);
                witness.is_guess(at)
            })
            .collect();
        assert_eq!(guessed.iter().position(|guess| *guess), Some(21));
    }
}
