//! Times of points that have none, from their directions.
//!
//! A spinning lidar measures its points in the order of their azimuth, so the share of the turn that
//! has passed tells when. Directions say nothing about when a turn began: it is taken to begin at the first
//! point, at the stamp or one turn before it. The head turns the way in which most neighbouring points
//! follow each other.

use std::f32::consts::TAU;

use portolan_geometry::{Duration, Time};

use crate::seam::sense_of_turn;
use crate::timed_points::TimedPoints;

/// Whether points without times get them from their azimuth, and what the stamp of a cloud means then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum AzimuthTimes {
    /// They do where the lidar spins and motion was not taken out of its clouds already, as far as the first
    /// clouds show; the stamp is the beginning of the turn if it was recorded a turn later, otherwise the end.
    #[default]
    Auto,
    /// They do not: all points count as measured at the stamp.
    Off,
    /// They do; the stamp is when the turn began.
    FromStamp,
    /// They do; the stamp is when the turn ended.
    UntilStamp,
}

impl AzimuthTimes {
    /// What the stamps of clouds mean that are recorded `lag` after them, turn after turn of so many seconds:
    /// nothing can be recorded before it was measured.
    pub(super) fn of_stamps(lag: Option<Duration>, turn: f64) -> Self {
        // Beyond a second clocks differ, and nothing is known.
        let is_late = lag.is_some_and(|lag| (0.9 * turn..1.0 + turn).contains(&lag.seconds()));
        if is_late { Self::FromStamp } else { Self::UntilStamp }
    }
}

/// Points of the first turn this near to its beginning may lie before it, because beams of one firing have
/// different azimuths (share of the turn and of the points).
const EDGE: f32 = 0.03;

/// Gives points times within a turn of `duration` seconds. They must stand as they came, all with the same
/// time.
pub(crate) fn assign(points: &mut TimedPoints, stamp: Time, duration: f64, meaning: AzimuthTimes) {
    let Some(first) = points.points.first() else { return };
    let azimuth = |p: &portolan_sensor::TimedPoint| p.position.y.atan2(p.position.x);
    let begin = azimuth(first);
    let sign = sense_of_turn(points.points.iter().map(|p| &p.position));
    let early = (points.points.len() as f32 * EDGE) as usize;
    let offset = if meaning == AzimuthTimes::UntilStamp { -1.0 } else { 0.0 };
    for (index, point) in points.points.iter_mut().enumerate() {
        let mut share = (sign * (azimuth(point) - begin)).rem_euclid(TAU) / TAU;
        if index < early && share > 1.0 - EDGE {
            share -= 1.0;
        }
        point.time = (share + offset) * duration as f32;
    }
    points.rebase(stamp);
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;
    use portolan_sensor::TimedPoint;

    fn turn(clockwise: bool, by_ring: bool) -> TimedPoints {
        let point = |column: usize, ring: usize| {
            let share = column as f32 / 500.0 + ring as f32 * 1e-4;
            let angle = 2.0 + if clockwise { -TAU } else { TAU } * share;
            let position = Point3f::new(5.0 * angle.cos(), 5.0 * angle.sin(), share);
            TimedPoint { position, time: 0.0 }
        };
        let points = if by_ring {
            (0..4).flat_map(|ring| (0..490).map(move |column| point(column, ring))).collect()
        } else {
            (0..490).flat_map(|column| (0..4).map(move |ring| point(column, ring))).collect()
        };
        TimedPoints { time: Time::UNIX_EPOCH, points, intensities: Vec::new() }
    }

    #[test]
    fn times_follow_the_turn_whatever_the_order_of_points() {
        for (clockwise, by_ring) in [(true, true), (true, false), (false, true), (false, false)] {
            for (meaning, shift) in [(AzimuthTimes::FromStamp, 0.0), (AzimuthTimes::UntilStamp, -0.1)] {
                let mut points = turn(clockwise, by_ring);
                let stamp = Time::from_ros(100, 0);
                assign(&mut points, stamp, 0.1, meaning);
                let end = points.time.seconds_since(stamp);
                for p in &points.points {
                    // The test keeps the true share in z.
                    let expected = f64::from(p.position.z) * 0.1 + shift;
                    assert!((end + f64::from(p.time) - expected).abs() < 1e-5, "{clockwise} {by_ring} {p:?}");
                }
            }
        }
    }

    #[test]
    fn stamps_that_are_recorded_a_turn_later_are_of_the_beginning() {
        let of = |lag: f64| AzimuthTimes::of_stamps(Some(Duration::from_seconds(lag)), 0.1);
        assert_eq!(
            [0.12, 0.1, 0.03, 0.0, 4e8].map(of),
            [
                AzimuthTimes::FromStamp,
                AzimuthTimes::FromStamp,
                AzimuthTimes::UntilStamp,
                AzimuthTimes::UntilStamp,
                AzimuthTimes::UntilStamp
            ]
        );
    }

    #[test]
    fn clouds_of_few_points_do_no_harm() {
        for count in 0..4 {
            let mut points = turn(false, false);
            points.points.truncate(count);
            assign(&mut points, Time::UNIX_EPOCH, 0.1, AzimuthTimes::FromStamp);
            assert_eq!(points.points.len(), count);
        }
    }
}
