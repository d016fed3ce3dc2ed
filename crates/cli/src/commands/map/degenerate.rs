//! Summary of degenerate intervals for the user.

use std::collections::BTreeMap;

use portolan_mapping::{DegenerateInterval, DegenerateMotion, Substitute};

/// Minimum total duration of the intervals of a motion, seconds; shorter ones are only in `report.json`.
const SHORT: f64 = 2.0;

/// One line for each degenerate motion, with the substitute that was used for most of the time and its accumulated
/// standard deviation.
pub(super) fn degenerate_intervals(all: &[DegenerateInterval], recording_seconds: f64) -> String {
    let line = |motion: DegenerateMotion| {
        let mut by_taken: BTreeMap<Substitute, f64> = BTreeMap::new();
        for interval in all.iter().filter(|i| i.motion == motion) {
            *by_taken.entry(interval.taken).or_default() += interval.seconds;
        }
        let seconds: f64 = by_taken.values().sum();
        if seconds < SHORT {
            return String::new();
        }
        let of_motion = all.iter().filter(|i| i.motion == motion);
        let gathered = of_motion.map(|i| i.sigma).try_fold(0.0, |sum: f64, sigma| Some(sum.hypot(sigma?)));
        let off = gathered.map_or_else(String::new, |sigma| match motion.is_rotation() {
            true => format!(", which may be {:.1} deg off in all", sigma.to_degrees()),
            false => format!(", which may be {sigma:.1} m off in all"),
        });
        let most = by_taken.iter().max_by(|a, b| a.1.total_cmp(b.1)).map_or("", |(taken, _)| taken.name());
        let mostly = if by_taken.len() > 1 { " mostly" } else { "" };
        format!(
            "degenerate: for {seconds:.0} s of {recording_seconds:.0} s scans do not constrain {};{mostly} {most} was used{off} (see report.json)\n",
            motion.name(),
        )
    };
    DegenerateMotion::ALL.map(line).concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::{Time, Vector3};

    #[test]
    fn times_are_summed_up_and_short_ones_are_left_out() {
        let time = Time::from_ticks(0);
        let interval = |motion, taken, seconds, sigma| DegenerateInterval {
            start: time,
            end: time,
            scans: 1,
            seconds,
            motion,
            taken,
            sigma,
            direction_in_tracking: Vector3::x(),
        };
        let text = degenerate_intervals(
            &[
                interval(DegenerateMotion::Along, Substitute::Odometry, 30.2, Some(0.3)),
                interval(DegenerateMotion::Along, Substitute::Velocity, 11.0, Some(0.4)),
                interval(DegenerateMotion::Across, Substitute::Velocity, 11.0, None),
                interval(DegenerateMotion::Heading, Substitute::Gyroscope, 0.4, Some(0.1)),
            ],
            60.0,
        );
        assert_eq!(
            text,
            "degenerate: for 41 s of 60 s scans do not constrain motion along the direction of travel; mostly odometry was used, which may be 0.5 m off in all (see report.json)\n\
             degenerate: for 11 s of 60 s scans do not constrain motion across the direction of travel; constant velocity was used (see report.json)\n"
        );
    }
}
