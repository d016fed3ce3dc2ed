//! Estimates the motion of a planar scanner from scan to scan by point-to-line matching to the scan before
//! (Censi 2008, "An ICP variant using a point-to-line metric"), with correspondences by direction.

use std::f64::consts::TAU;

use portolan_geometry::nalgebra::{Matrix3, Vector3};
use portolan_geometry::{Rigid2, Time, Vector2};
use portolan_recording::LaserScan;

/// Interval between scans above which they are not compared, seconds.
const MAX_INTERVAL: f64 = 0.5;
/// Maximum number of scans that are used.
const MAX_SCANS: usize = 1500;
/// Number of directions that are distinguished: one for each degree.
const CELLS: usize = 360;
/// Maximum distances of a point from its line, one for each iteration, metres.
const GATES: [f64; 12] = [1.0, 0.7, 0.5, 0.4, 0.3, 0.2, 0.2, 0.15, 0.1, 0.1, 0.1, 0.1];
/// Number of directions to each side in which the nearest point is searched.
const REACH: usize = 6;
/// Distance between neighbours above which they belong to different surfaces, metres.
const EDGE: f64 = 0.4;
/// Minimum fraction of the points of a scan with a line after the last iteration.
const MATCHED: f64 = 0.6;
/// Minimum information in the weaker of two directions, as a fraction of the number of points, for the
/// motion to be determined.
const DETERMINED: f64 = 0.05;

/// A motion between two times, `first_from_second` in the frame of the scanner.
pub(crate) type TimedMotion = (Time, Time, Rigid2);

/// Scans of a scanner, in order of arrival, with their motions where these are determined.
#[derive(Debug, Default)]
pub(crate) struct ScanMotions {
    pub scans: Vec<PlacedScan>,
}

/// A scan and its motion from the scan before.
#[derive(Debug)]
pub(crate) struct PlacedScan {
    pub time: Time,
    pub places: Places,
    /// `before_from_this`, where the scan before was taken less than half a second ago and the motion is determined.
    pub motion: Option<Rigid2>,
}

/// A point of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Seen {
    /// Metres, in the frame of the scanner.
    pub place: Vector2,
    /// Fraction of the beams of the scan before this one, 0 to 1.
    pub share: f64,
}

/// The nearest point in each direction.
pub(crate) type Places = Vec<Option<Seen>>;

/// A point on a line of a scan, the normal of the line, and the point of the scan at which the line is.
pub(crate) struct OnLine {
    pub place: Vector2,
    pub normal: Vector2,
    pub seen: Seen,
}

impl ScanMotions {
    /// Takes the next scan.
    pub fn add(&mut self, time: Time, scan: &LaserScan) {
        if self.scans.len() >= MAX_SCANS {
            return;
        }
        let places = places(scan);
        let before = self.scans.last().filter(|b| (0.0..MAX_INTERVAL).contains(&time.seconds_since(b.time)));
        let motion = before.and_then(|before| matched(&before.places, &places, Rigid2::identity()));
        self.scans.push(PlacedScan { time, places, motion });
    }

    /// The motions that are determined.
    pub fn motions(&self) -> impl Iterator<Item = TimedMotion> {
        self.scans.windows(2).filter_map(|two| match two {
            [before, this] => Some((before.time, this.time, this.motion?)),
            _ => None,
        })
    }
}

/// The points of a scan: the nearest one in each direction.
pub(crate) fn places(scan: &LaserScan) -> Places {
    let limits = scan.range_min.max(0.05)..=scan.range_max;
    let beams = scan.ranges.len() as f64;
    let seen =
        scan.ranges.iter().enumerate().filter(|(_, range)| limits.contains(range)).map(|(i, range)| {
            let direction = f64::from(scan.angle_min) + f64::from(scan.angle_increment) * i as f64;
            let place = Vector2::new(direction.cos(), direction.sin()) * f64::from(*range);
            Seen { place, share: i as f64 / beams }
        });
    by_direction(seen)
}

/// The nearest point in each direction.
pub(crate) fn by_direction(seen: impl Iterator<Item = Seen>) -> Places {
    let mut places: Places = vec![None; CELLS];
    for seen in seen {
        if let Some(known) = places.get_mut(cell(&seen.place))
            && known.is_none_or(|known: Seen| seen.place.norm() < known.place.norm())
        {
            *known = Some(seen);
        }
    }
    places
}

fn cell(place: &Vector2) -> usize {
    ((place.y.atan2(place.x) / TAU + 0.5) * CELLS as f64) as usize % CELLS
}

/// Matches two scans from a `start`; returns `before_from_now`, or none where too few points fit or the
/// motion along a corridor is not constrained.
pub(crate) fn matched(before: &Places, now: &Places, start: Rigid2) -> Option<Rigid2> {
    let mut motion = start;
    let points = now.iter().flatten().count() as f64;
    let mut found = (0.0, 0.0);
    for gate in GATES {
        let (mut normal_matrix, mut right, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        for seen in now.iter().flatten() {
            let at = motion.transform_point(&seen.place);
            let Some(OnLine { place, normal, .. }) = line_near(before, &at) else { continue };
            let distance = normal.dot(&(at - place));
            if distance.abs() > gate {
                continue;
            }
            let row = Vector3::new(normal.x, normal.y, normal.y * at.x - normal.x * at.y);
            normal_matrix += row * row.transpose();
            right -= row * distance;
            count += 1.0;
        }
        let across = normal_matrix.fixed_view::<2, 2>(0, 0).symmetric_eigenvalues().min();
        found = (count, across);
        let change = normal_matrix.cholesky()?.solve(&right);
        motion = Rigid2::new(change.x, change.y, change.z) * motion;
        if !motion.is_finite() {
            return None;
        }
    }
    (found.0 > MATCHED * points && found.1 > DETERMINED * found.0).then_some(motion)
}

/// The line of a scan nearest to a position.
pub(crate) fn line_near(before: &Places, at: &Vector2) -> Option<OnLine> {
    let known = |c: usize| before.get(c % CELLS).copied().flatten();
    let first = cell(at) + CELLS - REACH;
    let distance = |seen: &Seen| (seen.place - at).norm_squared();
    let nearest = (first..=first + 2 * REACH)
        .filter_map(|c| Some((c, known(c)?)))
        .min_by(|a, b| distance(&a.1).total_cmp(&distance(&b.1)))?;
    let (c, seen) = nearest;
    let beside = [c + 1, c + CELLS - 1].into_iter().filter_map(known);
    let other = beside.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let along = other.place - seen.place;
    let length = along.norm();
    let normal = Vector2::new(-along.y, along.x) / length;
    (length > 0.0 && length < EDGE).then_some(OnLine { place: seen.place, normal, seen })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A room of 8 m by 5 m with a cupboard in a corner, seen from a pose in it, degree by degree.
    fn seen(pose: &Rigid2) -> Places {
        let beam = |degrees: i32| {
            let angle = pose.angle + f64::from(degrees).to_radians();
            let (s, c) = angle.sin_cos();
            let to_wall = |at: f64, step: f64, low: f64, high: f64| {
                if step > 0.0 { (high - at) / step } else { (low - at) / step }
            };
            let room =
                to_wall(pose.translation.x, c, -4.0, 4.0).min(to_wall(pose.translation.y, s, -2.5, 2.5));
            let local = f64::from(degrees).to_radians();
            Vector2::new(local.cos(), local.sin()) * room
        };
        by_direction((-90..90).map(beam).map(|place| Seen { place, share: 0.0 }))
    }

    #[test]
    fn motions_in_a_room_are_found() {
        for (x, y, angle) in [(0.1, 0.0, 0.05), (-0.15, 0.02, -0.2), (0.0, 0.0, 0.3)] {
            let (first, moved) = (Rigid2::new(0.3, -0.4, 0.2), Rigid2::new(x, y, angle));
            let found = matched(&seen(&first), &seen(&(first * moved)), Rigid2::identity()).unwrap();
            let off = found.inverse() * moved;
            assert!(off.translation.norm() < 0.01 && off.angle.abs() < 0.01, "{moved:?}: {found:?}");
        }
    }

    #[test]
    fn motion_along_a_bare_wall_is_unobservable() {
        let wall = |y: f64| -> Places {
            let place = |degrees: i32| Vector2::new(y / f64::from(degrees).to_radians().tan(), y);
            by_direction((20..160).map(place).map(|place| Seen { place, share: 0.0 }))
        };
        assert_eq!(matched(&wall(1.5), &wall(1.45), Rigid2::identity()), None);
    }
}
