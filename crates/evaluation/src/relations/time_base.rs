//! Corrects relations whose times have another origin than the times of the trajectory.

use std::fmt;

use portolan_geometry::{Duration, Time};

use super::Relation;
use crate::{EvaluationError, Trajectory};

/// CARMEN logs count seconds from the start of the logger or of the computer. Recordings that were converted
/// from them have 10⁹ seconds added, because elsewhere a time of zero means "now".
const CARMEN_OFFSET: Duration = Duration::from_ticks(10_000_000_000_000_000);

/// Notice that the times of relations were shifted, and how well they fit after that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeBaseNotice {
    /// Offset that was added to the times.
    pub offset: Duration,
    /// Number of relations within the trajectory after the shift.
    pub inside: usize,
    /// Number of all relations.
    pub count: usize,
}

impl fmt::Display for TimeBaseNotice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "The times of the relations were shifted by {:+.0} s to those of the trajectory; {} of {} relations lie within it.",
            self.offset.seconds(),
            self.inside,
            self.count
        )
    }
}

/// Converts the times of relations to the clock of a trajectory. If any relation is within the time span of
/// the trajectory, nothing changes. If none is, but at least half are when their times are shifted by plus
/// 10⁹ seconds (CARMEN times and a converted recording) or minus 10⁹ seconds, all are shifted and a notice is
/// returned. If neither shift helps, this is an error: clamped to the ends of the trajectory, the relations
/// would measure nothing.
///
/// # Errors
/// If the trajectory has no poses, or the relations are outside its time span on either clock.
pub fn in_time_base(
    trajectory: &Trajectory,
    relations: &[Relation],
) -> Result<(Vec<Relation>, Option<TimeBaseNotice>), EvaluationError> {
    let span = trajectory.span().ok_or(EvaluationError::EmptyTrajectory("estimated"))?;
    if relations.is_empty() || count_inside(span, relations, Duration::ZERO) > 0 {
        return Ok((relations.to_vec(), None));
    }
    for offset in [CARMEN_OFFSET, Duration::ZERO - CARMEN_OFFSET] {
        let inside = count_inside(span, relations, offset);
        if 2 * inside >= relations.len() {
            let shift = |r: &Relation| Relation { time1: r.time1 + offset, time2: r.time2 + offset, ..*r };
            let notice = TimeBaseNotice { offset, inside, count: relations.len() };
            return Ok((relations.iter().map(shift).collect(), Some(notice)));
        }
    }
    let times = || relations.iter().flat_map(|r| [r.time1, r.time2]);
    let text = |time: Option<Time>| time.map(Time::unix_decimal).unwrap_or_default();
    Err(EvaluationError::NoRelationInTime {
        relations: relations.len(),
        relations_start: text(times().min()),
        relations_end: text(times().max()),
        start: span.0.unix_decimal(),
        end: span.1.unix_decimal(),
    })
}

/// Number of relations that overlap the trajectory when shifted. One of the two times suffices, because logs
/// often begin a little before the first node and end a little after the last.
fn count_inside(span: (Time, Time), relations: &[Relation], offset: Duration) -> usize {
    let inside = |time: Time| (span.0..=span.1).contains(&(time + offset));
    relations.iter().filter(|r| inside(r.time1) || inside(r.time2)).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::TimedPose;
    use portolan_geometry::Rigid3;

    fn trajectory(start: f64) -> Trajectory {
        let pose = |i: i32| TimedPose {
            time: Time::from_unix_seconds(start + f64::from(i)),
            map_from_tracking: Rigid3::identity(),
        };
        Trajectory::new((0..100).map(pose)).0
    }

    fn relations(start: f64) -> Vec<Relation> {
        let relation = |i: i32| Relation {
            time1: Time::from_unix_seconds(start + f64::from(i)),
            time2: Time::from_unix_seconds(start + f64::from(i) + 0.5),
            expected_1_from_2: Rigid3::identity(),
            covered_distance: 0.0,
        };
        (0..90).map(relation).collect()
    }

    #[test]
    fn carmen_times_are_recognised_in_both_directions() {
        let (shifted, notice) = in_time_base(&trajectory(1_000_000_090.0), &relations(90.0)).unwrap();
        assert_eq!(shifted[0].time1, Time::from_unix_seconds(1_000_000_090.0));
        let notice = notice.unwrap().to_string();
        assert!(notice.contains("+1000000000 s") && notice.contains("90 of 90"), "{notice}");
        let (_, notice) = in_time_base(&trajectory(90.0), &relations(1_000_000_090.0)).unwrap();
        assert!(notice.unwrap().to_string().contains("-1000000000 s"));
    }

    #[test]
    fn a_common_clock_is_not_changed() {
        let given = relations(150.0);
        assert_eq!(in_time_base(&trajectory(90.0), &given).unwrap(), (given, None));
        assert_eq!(in_time_base(&trajectory(90.0), &[]).unwrap(), (vec![], None));
    }

    #[test]
    fn another_recording_is_an_error() {
        let error = in_time_base(&trajectory(500_000.0), &relations(90.0)).unwrap_err().to_string();
        assert!(error.contains("none of the 90 relations (90.0000000 to 179.5000000)"), "{error}");
    }
}
