//! Removes returns that move along with the scanner: those of the robot itself, or of a person who walks
//! beside it.
//!
//! Such returns fit a standing scanner, and in a corridor no others constrain the distance travelled. They
//! are detected by comparison with a scan from before the scanner moved. A return moves along if that scan
//! had a return at its position in the frame of the scanner, but not at its position in the world, and if
//! one of the two scans sees through the position where the other has the return. Returns for which this
//! repeats are left out of matching and of the map.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use portolan_geometry::{Duration, Point3f, Rigid2, Time, Vector2};
use portolan_sensor::RangeData;

/// Number of angular bins of a turn, one degree each.
const BINS: usize = 360;
/// Range bands: maximum range of returns, metres, and distance that the scanner must have moved since the
/// scan that they are compared with, metres; the newest such scan is used. At the far end of the second
/// band this distance is twice the maximum distance of two returns of one point. Returns farther away are
/// not compared.
const BANDS: [(f64, f64); 2] = [(5.0, 0.3), (20.0, 1.3)];
/// Rotation of the scanner, radians, that suffices instead of the distance.
const TURNED: f64 = 0.5;
/// Maximum age of a scan to compare with.
const OLDEST: Duration = Duration::from_ticks(50_000_000);
/// Maximum number of scans kept, however close their time stamps are.
const MOST_VIEWS: usize = 256;
/// Maximum distance of two returns of one point: a constant, metres, plus a fraction of their range.
const SAME: f64 = 0.05;
const SAME_SHARE: f64 = 0.03;
/// Maximum difference of returns of one body in consecutive scans, metres and degrees.
const FOLLOWED: f64 = 0.12;
const FOLLOWED_BINS: usize = 2;
/// Surplus of comparisons for moving along over those against it from which on a return is left out, and
/// maximum of this count.
const ENOUGH: i8 = 3;
const MOST: i8 = 8;
/// Maximum number of returns that move along for each static one.
const CONFIRMED_BY: usize = 4;
/// Fraction of the directions with returns that move along above which the motion is assumed to be wrong
/// instead.
const MOST_OF_SCAN: f64 = 0.5;

/// Detects returns that move along with the scanner, from scan to scan.
#[derive(Default)]
pub(super) struct CoMoving {
    /// Scans of the last seconds, at their matched poses.
    views: VecDeque<View>,
    /// For each direction of the newest scan, comparisons for minus those against its return moving along.
    marks: Vec<i8>,
}

/// The nearest return in each direction from the scanner. Its frame has its origin at the scanner and
/// turns with the robot.
struct Profile {
    aligned_from_scanner: Rigid2,
    /// In the frame of the scanner, metres.
    returns: Vec<Option<Vector2>>,
    /// Free range in each direction, metres.
    clear: Vec<f64>,
}

struct View {
    time: Time,
    local_from_scanner: Rigid2,
    profile: Profile,
}

/// A scan to be matched, with the marks of its returns.
pub(super) struct Marked {
    profile: Profile,
    marks: Vec<i8>,
    is_left_out: bool,
}

impl CoMoving {
    /// Marks the returns of a scan in the gravity-aligned tracking frame by those of the scans before.
    pub fn mark(&self, scan: &RangeData, aligned_from_scanner: Rigid2) -> Marked {
        let profile = Profile::of(scan, aligned_from_scanner);
        let known = self.views.back().map(|view| &view.profile);
        let mark = |bin: usize| {
            let (before, range) = (known?, profile.range(bin)?);
            let is_followed = |b: &usize| before.range(*b).is_some_and(|r| (r - range).abs() < FOLLOWED);
            // A return that remains in its direction inherits only from there, so that marks of a corner do
            // not run along the wall.
            let from = Some(bin).filter(is_followed).or_else(|| {
                (1..=FOLLOWED_BINS)
                    .flat_map(|d| [bin + d, bin + BINS - d])
                    .map(|b| b % BINS)
                    .find(is_followed)
            });
            self.marks.get(from?).copied()
        };
        let marks: Vec<i8> = (0..BINS).map(|bin| mark(bin).unwrap_or(0)).collect();
        let moving = marks.iter().filter(|mark| **mark >= ENOUGH).count();
        let seen = profile.returns.iter().flatten().count();
        let is_left_out = moving > 0 && moving as f64 <= MOST_OF_SCAN * seen as f64;
        Marked { profile, marks, is_left_out }
    }

    /// Updates the marks by a scan matched at this pose.
    pub fn learn(&mut self, time: Time, local_from_aligned: Rigid2, marked: Marked) {
        let Marked { profile, mut marks, .. } = marked;
        let local_from_scanner = local_from_aligned * profile.aligned_from_scanner;
        while self.views.front().is_some_and(|view| time - view.time > OLDEST)
            || self.views.len() >= MOST_VIEWS
        {
            self.views.pop_front();
        }
        let from_now = |view: &View| view.local_from_scanner.inverse() * local_from_scanner;
        let motions: Vec<(&View, Rigid2)> =
            self.views.iter().rev().map(|view| (view, from_now(view))).collect();
        let compared = BANDS.map(|(reach, moved)| {
            let has_moved =
                |m: &Rigid2| m.translation.norm() >= moved || m.normalized_angle().abs() >= TURNED;
            (reach, motions.iter().find(|(_, motion)| has_moved(motion)))
        });
        if compared.iter().any(|(_, view)| view.is_some()) {
            let verdict = |at: &Option<Vector2>| {
                let (at, range) = at.map(|at| (at, at.norm()))?;
                let (_, view) = compared.iter().find(|(reach, _)| range < *reach)?;
                view.map(|(view, motion)| compare(at, motion, (&view.profile, &profile)))
            };
            let verdicts: Vec<Option<Verdict>> = profile.returns.iter().map(verdict).collect();
            let count = |wanted| verdicts.iter().filter(|verdict| **verdict == Some(wanted)).count();
            // This scan, too, and not only odometry, must show that the scanner moved at all.
            let scanner_moved = CONFIRMED_BY * count(Verdict::Static) >= count(Verdict::CoMoving);
            for (mark, verdict) in marks.iter_mut().zip(&verdicts) {
                let change = match verdict {
                    Some(Verdict::CoMoving) => i8::from(scanner_moved),
                    Some(Verdict::Static | Verdict::PossiblyStatic) => -1,
                    Some(Verdict::Unknown) | None => 0,
                };
                *mark = (*mark + change).clamp(-ENOUGH, MOST);
            }
        }
        self.marks = marks;
        self.views.push_back(View { time, local_from_scanner, profile });
    }
}

impl Marked {
    /// The scan without returns that move along; none where all of it is used.
    pub fn without_co_moving(&self, scan: &RangeData) -> Option<RangeData> {
        if !self.is_left_out {
            return None;
        }
        let returns = scan.returns.retained(|point| !self.moves_along(point));
        let is_whole = returns.points.len() == scan.returns.points.len();
        (!is_whole).then(|| RangeData { origin: scan.origin, returns, misses: scan.misses.clone() })
    }

    fn moves_along(&self, point: &Point3f) -> bool {
        let (bin, range) = polar(self.profile.place(point));
        let is_nearest = self.profile.range(bin).is_some_and(|nearest| range - nearest < FOLLOWED);
        is_nearest && self.marks.get(bin).is_some_and(|mark| *mark >= ENOUGH)
    }
}

/// Result of the comparison of a return with an earlier scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// The earlier scan had a return there in the world, and none there in the frame of the scanner.
    Static,
    /// The earlier scan had a return there in both frames, so it may be static.
    PossiblyStatic,
    /// The earlier scan had a return there only in the frame of the scanner, and one of the two scans sees
    /// through.
    CoMoving,
    /// None of these: the earlier scan had a return in neither position, or no scan sees through.
    Unknown,
}

/// Compares the return at `at`, metres in the frame of the scanner, of the scan `now` with the scan
/// `before`.
fn compare(at: Vector2, before_from_now: &Rigid2, (before, now): (&Profile, &Profile)) -> Verdict {
    let in_world = before_from_now.transform_point(&at);
    match (before.nearest(in_world), before.nearest(at)) {
        (Some(_), None) => Verdict::Static,
        (Some(_), Some(_)) => Verdict::PossiblyStatic,
        (None, Some(partner)) => {
            let moved_away = now.sees_through(before_from_now.inverse().transform_point(&partner));
            let is_new = before.sees_through(in_world);
            if moved_away || is_new { Verdict::CoMoving } else { Verdict::Unknown }
        }
        (None, None) => Verdict::Unknown,
    }
}

impl Profile {
    fn of(scan: &RangeData, aligned_from_scanner: Rigid2) -> Self {
        let mut profile = Self { aligned_from_scanner, returns: vec![None; BINS], clear: vec![0.0; BINS] };
        for point in &scan.misses.points {
            let (bin, range) = polar(profile.place(point));
            if let Some(clear) = profile.clear.get_mut(bin) {
                *clear = clear.max(range);
            }
        }
        for point in &scan.returns.points {
            let place = profile.place(point);
            let (bin, range) = polar(place);
            if profile.range(bin).is_none_or(|nearest| range < nearest)
                && let (Some(known), Some(clear)) = (profile.returns.get_mut(bin), profile.clear.get_mut(bin))
            {
                (*known, *clear) = (Some(place), range);
            }
        }
        profile
    }

    /// A point of the gravity-aligned tracking frame in that of the scanner.
    fn place(&self, point: &Point3f) -> Vector2 {
        let aligned = Vector2::new(f64::from(point.x), f64::from(point.y));
        self.aligned_from_scanner.inverse().transform_point(&aligned)
    }

    fn range(&self, bin: usize) -> Option<f64> {
        self.returns.get(bin).copied().flatten().map(|at| at.norm())
    }

    /// The return nearest to a point, if both may be of the same surface.
    fn nearest(&self, place: Vector2) -> Option<Vector2> {
        let (bin, range) = polar(place);
        let apart = tolerance(range);
        let width = (apart / range.max(apart)).asin() / TAU * BINS as f64;
        let at = neighbours(bin, width as usize + 1).filter_map(|b| self.returns.get(b).copied().flatten());
        let distance = |at: &Vector2| (at - place).norm_squared();
        let nearest = at.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        (distance(&nearest) < apart * apart).then_some(nearest)
    }

    /// Whether the beams beside a point end well behind it.
    fn sees_through(&self, place: Vector2) -> bool {
        let (bin, range) = polar(place);
        let needed = range + 2.0 * tolerance(range);
        neighbours(bin, 1).all(|b| self.clear.get(b).is_some_and(|clear| *clear > needed))
    }
}

fn tolerance(range: f64) -> f64 {
    SAME + SAME_SHARE * range
}

/// Direction, degrees from −x, and range, metres.
fn polar(place: Vector2) -> (usize, f64) {
    let share = place.y.atan2(place.x) / TAU + 0.5;
    ((share * BINS as f64) as usize % BINS, place.norm())
}

/// Indices of a direction and of this number of directions to each side.
fn neighbours(bin: usize, width: usize) -> impl Iterator<Item = usize> {
    let width = width.min(BINS / 2 - 1);
    (0..=2 * width).map(move |i| (bin + BINS + i - width) % BINS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_sensor::PointCloud;

    /// Range in a hall of 20 m by 3 m with a pillar of 0.4 m by the wall every 2 m, in a direction.
    fn range(pose: &Rigid2, direction: f64) -> f64 {
        let angle = pose.angle + direction;
        let step = Vector2::new(angle.cos(), angle.sin()) * 0.02;
        let is_free = |at: &Vector2| {
            let pillar = at.x.rem_euclid(2.0) < 0.4 && at.y.abs() > 1.1;
            (-1.0..19.0).contains(&at.x) && at.y.abs() < 1.5 && !pillar
        };
        let mut at = pose.translation;
        while is_free(&at) {
            at += step;
        }
        (at - pose.translation).norm()
    }

    /// A scan of each degree of a half turn, with returns of a body that moves along at the ranges `body`
    /// by direction (degrees).
    fn scan(pose: &Rigid2, body: &dyn Fn(i32) -> Option<f64>) -> RangeData {
        let point = |degrees: i32| {
            let direction = f64::from(degrees).to_radians();
            let range = body(degrees).unwrap_or_else(|| range(pose, direction));
            Point3f::new((range * direction.cos()) as f32, (range * direction.sin()) as f32, 0.0)
        };
        RangeData {
            origin: Point3f::origin(),
            returns: PointCloud::new((-90..90).map(point).collect()),
            misses: PointCloud::default(),
        }
    }

    /// Number of returns that are left out of each scan of a drive through the hall.
    fn left_out(body: &dyn Fn(i32) -> Option<f64>, pose_at: impl Fn(f64) -> Rigid2) -> Vec<usize> {
        let mut co_moving = CoMoving::default();
        (0..60_u32)
            .map(|i| {
                let pose = pose_at(f64::from(i));
                let scan = scan(&pose, body);
                let marked = co_moving.mark(&scan, Rigid2::identity());
                let without = marked.without_co_moving(&scan);
                co_moving.learn(Time::from_ticks(i64::from(i) * 1_000_000), pose, marked);
                without.map_or(0, |without| 180 - without.returns.points.len())
            })
            .collect()
    }

    const DRIVEN: fn(f64) -> Rigid2 = |i| Rigid2::new(0.1 * i, 0.2, 0.1 * (0.3 * i).sin());

    #[test]
    fn returns_of_a_hall_are_not_co_moving() {
        assert_eq!(left_out(&|_| None, DRIVEN).iter().max(), Some(&0));
    }

    #[test]
    fn returns_fixed_to_the_robot_are_removed() {
        let post = |degrees: i32| (20..32).contains(&degrees).then_some(0.5);
        let counts = left_out(&post, DRIVEN);
        assert_eq!(counts[0], 0);
        assert!(counts[15..].iter().all(|count| (11..=12).contains(count)), "{counts:?}");
    }

    #[test]
    fn standstill_and_scans_that_move_along_entirely_mark_no_returns() {
        let post = |degrees: i32| (20..32).contains(&degrees).then_some(0.5);
        assert_eq!(left_out(&post, |_| Rigid2::new(5.0, 0.2, 0.0)).iter().max(), Some(&0));
        // Wheels that slip: all returns stay in place while the poses move.
        let same = |degrees: i32| Some(range(&DRIVEN(0.0), f64::from(degrees).to_radians()));
        assert_eq!(left_out(&same, DRIVEN).iter().max(), Some(&0));
    }
}
