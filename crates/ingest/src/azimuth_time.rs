//! Assigns times to points that have none, from their azimuth.
//!
//! A spinning lidar measures its points in the order of their azimuth, so the fraction of the turn that has
//! passed gives the time. Where sweeps begin and in which sense the head spins follows from how sweeps fit
//! together while the lidar moves ([`Skew`](crate::Skew)). As long as that is unknown, a sweep is taken to
//! begin at its first point, and the head to turn in the direction in which most neighbouring points follow
//! each other. Sweeps begin or end at the stamp.

use std::f32::consts::{PI, TAU};

use portolan_geometry::{Duration, Point3f, Time};

use crate::timed_points::TimedPoints;

/// Whether points without times get them from their azimuth, and what the stamp of a cloud means then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum AzimuthTimes {
    /// They do if the lidar spins and the first clouds do not show them to be de-skewed already; where in the
    /// turn the stamp is follows from the time of recording. Times that points have are used unless the
    /// clouds are de-skewed.
    #[default]
    Auto,
    /// Points have the times that were recorded with them, whatever the clouds show.
    Recorded,
    /// They do not: all points count as measured at the stamp.
    Off,
    /// They do; the stamp is when the turn began.
    FromStamp,
    /// They do; the stamp is the middle of the turn.
    AroundStamp,
    /// They do; the stamp is when the sweep ended.
    UntilStamp,
}

impl AzimuthTimes {
    /// Meaning of the stamps of clouds that are recorded `lag` after them, for turns of `turn` seconds: no
    /// cloud is recorded before it was measured.
    pub(super) fn of_stamps(lag: Option<Duration>, turn: f64) -> Self {
        // Beyond a second the two clocks differ, and the lag says nothing.
        let lag = lag.map(|lag| lag.seconds()).filter(|lag| (0.0..1.0 + turn).contains(lag));
        match lag.map(|lag| lag / turn) {
            Some(turns) if turns >= 0.9 => Self::FromStamp,
            Some(turns) if turns >= 0.45 => Self::AroundStamp,
            _ => Self::UntilStamp,
        }
    }

    /// Meaning of the stamps if the first point of a turn is measured `after_stamp` seconds after them, for
    /// turns of `turn` seconds. None if neither the beginning, the middle nor the end of the turn is near the
    /// stamp.
    pub(super) fn of_begin(after_stamp: f64, turn: f64) -> Option<Self> {
        let kinds = [Self::FromStamp, Self::AroundStamp, Self::UntilStamp];
        let off = |kind: &Self| (after_stamp / turn + f64::from(kind.share_at_stamp())).abs();
        kinds.into_iter().filter(|kind| off(kind) < 0.25).min_by(|a, b| off(a).total_cmp(&off(b)))
    }

    /// Fraction of the turn that had passed at the stamp.
    fn share_at_stamp(self) -> f32 {
        match self {
            Self::UntilStamp => 1.0,
            Self::AroundStamp => 0.5,
            _ => 0.0,
        }
    }

    /// Where in the turn the stamp is, in words.
    pub(crate) fn describe_stamp(self) -> &'static str {
        match self {
            Self::FromStamp => "begin at their stamps",
            Self::AroundStamp => "have their stamps in the middle",
            _ => "end at their stamps",
        }
    }
}

/// How a lidar turns.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Turn {
    /// Azimuth at which sweeps begin, in the frame of the lidar, radians.
    pub begin_radians: f32,
    /// Whether the head turns clockwise, seen from above.
    pub is_clockwise: bool,
    /// Duration of a turn, in intervals between clouds: 1, or less where clouds are missing regularly.
    pub in_intervals: f64,
}

/// Azimuth difference above which neighbouring points belong to different beams, radians.
const SAME_TURN: f32 = 0.1;
/// Accuracy of an estimated beginning, radians; if the first point is within it, sweeps begin at the first
/// point.
const BEGIN_TOLERANCE: f32 = 0.09;

/// Points of the first turn this near to its beginning may be before it, because beams of one firing have
/// different azimuths (fraction of the turn and of the points).
const EDGE: f32 = 0.03;

/// A turn whose points get times.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TimedTurn {
    pub stamp: Time,
    pub seconds: f64,
    pub meaning: AzimuthTimes,
    /// Begin and direction of the turn, if known.
    pub turn: Option<Turn>,
}

/// Gives points times within a sweep. The points must be in their original order and have equal times.
pub(crate) fn assign(points: &mut TimedPoints, timed: &TimedTurn) {
    let TimedTurn { stamp, seconds, meaning, turn } = *timed;
    let Some(first) = points.points.first() else { return };
    let of_first = azimuth(&first.position);
    let begins_at_first = turn.is_none_or(|t| wrapped(t.begin_radians - of_first).abs() < BEGIN_TOLERANCE);
    let begin = turn.filter(|_| !begins_at_first).map_or(of_first, |t| t.begin_radians);
    let by_order = || sense_of_turn(points.points.iter().map(|p| &p.position));
    let sign = turn.map_or_else(by_order, |t| if t.is_clockwise { -1.0 } else { 1.0 });
    // In clouds that are ordered beam by beam, the first points are at all azimuths.
    let has_edge = begins_at_first && is_in_firing_order(points.points.iter().map(|p| &p.position));
    let early = if has_edge { (points.points.len() as f32 * EDGE) as usize } else { 0 };
    let at_stamp = meaning.share_at_stamp();
    for (index, point) in points.points.iter_mut().enumerate() {
        let mut share = (sign * (azimuth(&point.position) - begin)).rem_euclid(TAU) / TAU;
        if index < early && share > 1.0 - EDGE {
            share -= 1.0;
        }
        point.time = (share - at_stamp) * seconds as f32;
    }
    points.rebase(stamp);
}

fn azimuth(point: &Point3f) -> f32 {
    point.y.atan2(point.x)
}

fn wrapped(angle: f32) -> f32 {
    (angle + PI).rem_euclid(TAU) - PI
}

/// Direction in which the azimuths of neighbouring points change most often: 1 counter-clockwise, −1
/// clockwise.
fn sense_of_turn<'a>(points: impl Iterator<Item = &'a Point3f>) -> f32 {
    let (mut forward, mut last) = (0_i64, None);
    for azimuth in points.map(azimuth) {
        let step = last.replace(azimuth).map_or(0.0, |last| wrapped(azimuth - last));
        // Larger steps are between rings, or gaps.
        if step.abs() < SAME_TURN {
            forward += if step > 0.0 { 1 } else { -i64::from(step < 0.0) };
        }
    }
    if forward >= 0 { 1.0 } else { -1.0 }
}

/// Number of parts of a cloud in the test of its order.
const BLOCKS: usize = 8;
/// Concentration of the azimuths in each part (mean resultant length) above which the points are in the order
/// of measurement.
const ALIKE: f32 = 0.8;

/// Whether the points of a turn are in the order of their azimuth, all beams of one firing together: then the
/// turn begins at the first point. Many drivers write one beam after the other, from an azimuth of their own.
pub(crate) fn is_in_firing_order<'a>(points: impl ExactSizeIterator<Item = &'a Point3f>) -> bool {
    let of_block = points.len().div_ceil(BLOCKS).max(1);
    let mut blocks = [(0.0_f32, 0.0_f32, 0.0_f32); BLOCKS];
    for (index, azimuth) in points.map(azimuth).enumerate() {
        if let Some((count, c, s)) = blocks.get_mut(index / of_block) {
            (*count, *c, *s) = (*count + 1.0, *c + azimuth.cos(), *s + azimuth.sin());
        }
    }
    let alike = blocks.iter().map(|(count, c, s)| f32::hypot(*c, *s) / count.max(1.0));
    // NaN, where points have no azimuth, gives false.
    alike.sum::<f32>() / BLOCKS as f32 > ALIKE
}

#[cfg(test)]
mod tests {
    use super::*;
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
            for (meaning, shift) in [
                (AzimuthTimes::FromStamp, 0.0),
                (AzimuthTimes::AroundStamp, -0.05),
                (AzimuthTimes::UntilStamp, -0.1),
            ] {
                let mut points = turn(clockwise, by_ring);
                let stamp = Time::from_ros(100, 0);
                assign(&mut points, &TimedTurn { stamp, seconds: 0.1, meaning, turn: None });
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
    fn firing_order_is_distinguished_from_beam_order() {
        for clockwise in [true, false] {
            for by_ring in [true, false] {
                let points: Vec<Point3f> =
                    turn(clockwise, by_ring).points.iter().map(|p| p.position).collect();
                assert_eq!(is_in_firing_order(points.iter()), !by_ring, "{clockwise}");
            }
        }
        assert!(
            !is_in_firing_order([].iter())
                && !is_in_firing_order([Point3f::new(f32::NAN, 1.0, 1.0); 9].iter())
        );
    }

    #[test]
    fn the_start_of_sweeps_may_be_given() {
        // The points come from the left on, counter-clockwise; the head turns clockwise from behind.
        let mut points = turn(false, true);
        let known = Turn { begin_radians: PI, is_clockwise: true, in_intervals: 1.0 };
        let (stamp, meaning) = (Time::from_ros(100, 0), AzimuthTimes::FromStamp);
        assign(&mut points, &TimedTurn { stamp, seconds: 0.1, meaning, turn: Some(known) });
        let end = points.time.seconds_since(stamp);
        for p in &points.points {
            let share = (PI - azimuth(&p.position)).rem_euclid(TAU) / TAU;
            assert!((end + f64::from(p.time) - f64::from(share) * 0.1).abs() < 1e-5, "{p:?}");
        }
    }

    #[test]
    fn recording_times_show_where_in_the_sweep_stamps_are() {
        use AzimuthTimes::{AroundStamp, FromStamp, UntilStamp};
        for (lag, expected) in [
            (0.12, FromStamp),
            (0.1, FromStamp),
            (0.05, AroundStamp),
            (0.01, UntilStamp),
            (0.0, UntilStamp),
            (4e8, UntilStamp),
        ] {
            assert_eq!(AzimuthTimes::of_stamps(Some(Duration::from_seconds(lag)), 0.1), expected, "{lag}");
        }
    }

    #[test]
    fn wrong_point_times_still_show_where_in_the_sweep_stamps_are() {
        use AzimuthTimes::{AroundStamp, FromStamp, UntilStamp};
        for (begin, expected) in [
            (0.0, Some(FromStamp)),
            (0.004, Some(FromStamp)),
            (-0.05, Some(AroundStamp)),
            (-0.1, Some(UntilStamp)),
            (0.05, None),
            (f64::NAN, None),
        ] {
            assert_eq!(AzimuthTimes::of_begin(begin, 0.1), expected, "{begin}");
        }
    }

    #[test]
    fn beams_against_the_sense_of_rotation_belong_to_one_sweep() {
        // Clockwise from the first point on, beams counter-clockwise: the points after the first are the last of the turn.
        let mut points = turn(false, true);
        let known = Turn { begin_radians: 2.0, is_clockwise: true, in_intervals: 1.0 };
        let (stamp, meaning) = (Time::from_ros(100, 0), AzimuthTimes::FromStamp);
        assign(&mut points, &TimedTurn { stamp, seconds: 0.1, meaning, turn: Some(known) });
        let end = points.time.seconds_since(stamp);
        for p in &points.points {
            let seconds = end + f64::from(p.time);
            assert!(seconds > -1e-4 && seconds < 0.1 + 1e-4, "{seconds} {p:?}");
        }
    }

    #[test]
    fn clouds_of_few_points_are_handled() {
        for count in 0..4 {
            let mut points = turn(false, false);
            points.points.truncate(count);
            let meaning = AzimuthTimes::FromStamp;
            assign(&mut points, &TimedTurn { stamp: Time::UNIX_EPOCH, seconds: 0.1, meaning, turn: None });
            assert_eq!(points.points.len(), count);
        }
    }
}
