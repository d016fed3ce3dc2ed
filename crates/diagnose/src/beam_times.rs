//! Estimates how long a planar scanner takes for a scan, from scans of one place that were taken at
//! different turn rates.
//!
//! A scan that takes a time `T` while the scanner turns is stretched by the angle turned. Two scans taken at
//! the same rate are stretched alike and do not constrain `T`; those taken at different rates fit best after
//! de-skewing with the right `T`. Each pair gives the normal equations of its relative pose and of `T`
//! (point to line, linear in `T`). The poses are eliminated (Schur complement), which leaves one number and
//! its information for each pair.

use portolan_geometry::nalgebra::{Matrix3, Vector3};
use portolan_geometry::{Rigid2, Vector2};

use crate::scan_motion::{OnLine, PlacedScan, Places, ScanMotions, Seen, by_direction, line_near, matched};

/// Maximum number of pairs that are compared: those whose turn rates differ most.
const PAIRS: usize = 200;
/// Maximum distance between the scans of a pair, in scans.
const APART: usize = 12;
/// Minimum difference between the turn rates of a pair, rad/s.
const LEAST_DIFFERENCE: f64 = 0.2;
/// Minimum number of pairs for an estimate.
const ENOUGH_PAIRS: usize = 30;
/// Maximum number of Gauss-Newton iterations.
const ROUNDS: usize = 8;
/// Change of the duration at which the iteration has converged, seconds.
const CONVERGED: f64 = 0.001;
/// Number of standard deviations for a duration to be certainly wrong, in excess of [`LEAST_ERROR`].
const SURE: f64 = 4.0;
/// Error of a duration below which it is not reported, seconds.
const LEAST_ERROR: f64 = 0.03;
/// Distance of a point from its line above which it belongs to another surface, metres.
const GATE: f64 = 0.1;

/// Time of a scan from its first beam to its last, negative if the last comes first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanDuration {
    /// Seconds.
    pub seconds: f64,
    /// Standard deviation, seconds.
    pub sigma: f64,
}

impl ScanDuration {
    /// Whether the duration certainly differs from the reported one, `assumed`, of scans that come at this
    /// interval, seconds.
    pub(crate) fn is_other_than(&self, assumed: f64, interval: f64) -> bool {
        let difference = (self.seconds - assumed).abs();
        difference - SURE * self.sigma > LEAST_ERROR && self.seconds.abs() < 1.1 * interval
    }
}

/// A scan, and the motion of the scanner while it was taken.
#[derive(Clone, Copy)]
struct MovingScan<'a> {
    places: &'a Places,
    /// Metres per second, in the frame of the scanner.
    velocity: Vector2,
    /// Radians per second.
    rate: f64,
}

impl<'a> MovingScan<'a> {
    /// From the motions from the scan before and to the scan after.
    fn at(scans: &'a [PlacedScan], index: usize) -> Option<Self> {
        let [before, scan, after] = scans.get(index.checked_sub(1)?..index + 2)? else { return None };
        let (from, to) = (scan.motion?, after.motion?);
        let seconds = after.time.seconds_since(before.time);
        let velocity = (from.translation + to.translation) / seconds;
        let rate = (from.angle + to.angle) / seconds;
        (seconds > 0.0).then_some(Self { places: &scan.places, velocity, rate })
    }

    /// Velocity of static points relative to the scanner, with the sign reversed.
    fn flow(&self, place: &Vector2) -> Vector2 {
        self.velocity + self.rate * Vector2::new(-place.y, place.x)
    }

    /// The scan de-skewed to its start, if it takes this duration, seconds.
    fn deskewed(&self, seconds: f64) -> Places {
        by_direction(self.places.iter().flatten().map(|seen| {
            let time = seconds * seen.share;
            let moved = Rigid2::new(self.velocity.x * time, self.velocity.y * time, self.rate * time);
            Seen { place: moved.transform_point(&seen.place), share: seen.share }
        }))
    }
}

/// Two scans of one place.
struct Pair<'a> {
    first: MovingScan<'a>,
    second: MovingScan<'a>,
    first_from_second: Rigid2,
}

/// Normal equation of the duration of scans from one pair, with the pose of the pair eliminated. It consists
/// of the information, of the information times the correction of the assumed duration, and of the
/// dependence of the pose on that correction.
struct DurationEquation {
    information: f64,
    gradient: f64,
    /// Step of the pose (x, y, angle) if the duration stays the same.
    step: Vector3<f64>,
    /// Amount by which the step decreases for each second that is added to the duration.
    step_per_second: Vector3<f64>,
}

impl Pair<'_> {
    /// Matches the scans after de-skewing; false if they do not fit.
    fn matches(&mut self, seconds: f64) -> bool {
        let (before, now) = (self.first.deskewed(seconds), self.second.deskewed(seconds));
        let found = matched(&before, &now, self.first_from_second);
        self.first_from_second = found.unwrap_or(self.first_from_second);
        found.is_some()
    }

    fn equation(&self, seconds: f64) -> Option<DurationEquation> {
        let (before, now) = (self.first.deskewed(seconds), self.second.deskewed(seconds));
        let motion = self.first_from_second;
        let (mut poses, mut mixed, mut right) = (Matrix3::zeros(), Vector3::zeros(), Vector3::zeros());
        let (mut of_time, mut right_of_time) = (0.0, 0.0);
        for seen in now.iter().flatten() {
            let at = motion.transform_point(&seen.place);
            let Some(OnLine { place, normal, seen: beside }) = line_near(&before, &at) else { continue };
            let distance = normal.dot(&(at - place));
            if distance.abs() > GATE {
                continue;
            }
            let row = Vector3::new(normal.x, normal.y, normal.y * at.x - normal.x * at.y);
            let flow = motion.rotation_matrix() * self.second.flow(&seen.place) * seen.share;
            let with_time = normal.dot(&(flow - self.first.flow(&beside.place) * beside.share));
            poses += row * row.transpose();
            mixed += row * with_time;
            right -= row * distance;
            of_time += with_time * with_time;
            right_of_time -= with_time * distance;
        }
        let solved = poses.cholesky()?;
        let (step, step_per_second) = (solved.solve(&right), solved.solve(&mixed));
        let information = of_time - mixed.dot(&step_per_second);
        let gradient = right_of_time - mixed.dot(&step);
        let is_solvable = information > 0.0 && gradient.is_finite();
        is_solvable.then_some(DurationEquation { information, gradient, step, step_per_second })
    }

    /// Applies the step of the pose that belongs to a change of the duration.
    fn improve(&mut self, equation: &DurationEquation, change: f64) {
        let step = equation.step - equation.step_per_second * change;
        self.first_from_second = Rigid2::new(step.x, step.y, step.z) * self.first_from_second;
    }
}

/// The duration of scans of one scanner, near an assumed one, seconds.
pub(crate) fn scan_duration(motions: &ScanMotions, assumed: f64) -> Option<ScanDuration> {
    let mut pairs = pairs(&motions.scans);
    pairs.retain_mut(|pair| pair.matches(assumed));
    let mut found = ScanDuration { seconds: assumed, sigma: f64::INFINITY };
    for _ in 0..ROUNDS {
        let equations: Vec<Option<DurationEquation>> =
            pairs.iter().map(|pair| pair.equation(found.seconds)).collect();
        let of_pairs = || equations.iter().flatten();
        if of_pairs().count() < ENOUGH_PAIRS {
            return None;
        }
        let information: f64 = of_pairs().map(|e| e.information).sum();
        let change = of_pairs().map(|e| e.gradient).sum::<f64>() / information;
        // Points of a pair are not independent, pairs nearly are: the error is computed from the scatter of
        // their equations.
        let spread: f64 = of_pairs().map(|e| (e.gradient - e.information * change).powi(2)).sum();
        found = ScanDuration { seconds: found.seconds + change, sigma: spread.sqrt() / information };
        for (pair, equation) in pairs.iter_mut().zip(&equations) {
            equation.iter().for_each(|equation| pair.improve(equation, change));
        }
        if change.abs() < CONVERGED {
            break;
        }
    }
    found.seconds.is_finite().then_some(found)
}

/// Pairs of scans with the largest differences in turn rate.
fn pairs(scans: &[PlacedScan]) -> Vec<Pair<'_>> {
    let moving: Vec<Option<MovingScan>> = (0..scans.len()).map(|i| MovingScan::at(scans, i)).collect();
    let at = |i: usize| moving.get(i).and_then(Option::as_ref);
    let mut best: Vec<(f64, usize, usize)> = Vec::new();
    for first in 0..scans.len() {
        let Some(scan) = at(first) else { continue };
        let joined = (first + 1..first + APART).map_while(|second| at(second).map(|other| (second, other)));
        let most = joined
            .map(|(second, other)| ((scan.rate - other.rate).abs(), first, second))
            .max_by(|a, b| a.0.total_cmp(&b.0));
        best.extend(most.filter(|(difference, ..)| *difference > LEAST_DIFFERENCE));
    }
    best.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    best.truncate(PAIRS);
    let pair = |(_, first, second): (f64, usize, usize)| {
        let motions = scans.get(first + 1..=second)?.iter();
        let first_from_second =
            motions.map(|scan| scan.motion).try_fold(Rigid2::identity(), |a, m| Some(a * m?))?;
        Some(Pair { first: *at(first)?, second: *at(second)?, first_from_second })
    };
    best.into_iter().filter_map(pair).collect()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use portolan_geometry::Time;
    use portolan_recording::{Header, LaserScan};

    use super::*;

    /// Range of a beam in a room of 8 m by 5 m.
    fn range(pose: &Rigid2, beam: f64) -> f64 {
        let (s, c) = (pose.angle + beam).sin_cos();
        let to_wall = |at: f64, step: f64, half: f64| (half * step.signum() - at) / step;
        to_wall(pose.translation.x, c, 4.0).min(to_wall(pose.translation.y, s, 2.5))
    }

    /// Five scans a second of a scanner that turns to and fro, each measured in this duration, seconds.
    fn scans(seconds: f64, turns: f64) -> ScanMotions {
        let pose =
            |t: f64| Rigid2::new(1.5 * (0.3 * t).sin(), 0.5 * (0.2 * t).cos(), turns * (1.1 * t).sin());
        let mut motions = ScanMotions::default();
        for k in 0..300 {
            let stamp = 0.2 * f64::from(k);
            let time = |i: u16| {
                let share = f64::from(i) / 180.0;
                stamp + if seconds < 0.0 { -seconds * (1.0 - share) } else { seconds * share }
            };
            let angle = |i: u16| PI * (f64::from(i) / 180.0 - 0.5);
            let time_of_scan = Time::from_ticks((stamp * 1e7) as i64);
            let scan = LaserScan {
                header: Header { stamp: time_of_scan, frame_id: "laser".into() },
                angle_min: angle(0) as f32,
                angle_max: angle(180) as f32,
                angle_increment: (PI / 180.0) as f32,
                time_increment: 0.0,
                scan_time: 0.0,
                range_min: 0.1,
                range_max: 30.0,
                ranges: (0..=180).map(|i| range(&pose(time(i)), angle(i)) as f32).collect(),
                intensities: Vec::new(),
            };
            motions.add(time_of_scan, &scan);
        }
        motions
    }

    #[test]
    fn a_scan_that_takes_time_is_bent_where_the_turn_rate_changes() {
        for seconds in [0.0, 0.05, 0.15, -0.1] {
            let found = scan_duration(&scans(seconds, 0.8), 0.0).unwrap();
            let is_close = (found.seconds - seconds).abs() < 0.004 + 0.1 * seconds.abs();
            assert!(is_close && found.sigma < 0.01, "{seconds}: {found:?}");
            assert_eq!(found.is_other_than(0.0, 0.2), seconds != 0.0, "{seconds}: {found:?}");
            assert!(!found.is_other_than(seconds, 0.2), "{seconds}: {found:?}");
        }
    }

    #[test]
    fn scan_durations_are_unknown_without_rotation() {
        assert_eq!(scan_duration(&scans(0.1, 0.05), 0.0), None);
    }
}
