//! Where scans did not tell everything, for people.

use std::collections::BTreeMap;

use portolan_mapping::{DegenerateInterval, DegenerateMotion, Substitute};

/// Stretches that are shorter together, seconds, are left to the report.
const SHORT: f64 = 2.0;

/// A line for each kind of motion, with what was taken instead.
pub(super) fn weak_stretches(spans: &[DegenerateInterval], recording_seconds: f64) -> String {
    let line = |motion: DegenerateMotion| {
        let mut by_taken: BTreeMap<Substitute, f64> = BTreeMap::new();
        for span in spans.iter().filter(|s| s.motion == motion) {
            *by_taken.entry(span.taken).or_default() += span.seconds;
        }
        let seconds: f64 = by_taken.values().sum();
        if seconds < SHORT {
            return String::new();
        }
        let most = by_taken.iter().max_by(|a, b| a.1.total_cmp(b.1)).map_or("", |(taken, _)| taken.name());
        let mostly = if by_taken.len() > 1 { " mostly" } else { "" };
        format!(
            "for {seconds:.0} s of {recording_seconds:.0} s the scans did not tell {};{mostly} {most} was taken (see report.json)\n",
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
    fn times_are_summed_up_and_moments_are_not_told() {
        let time = Time::from_ticks(0);
        let span = |motion, taken, seconds| DegenerateInterval {
            start: time,
            end: time,
            scans: 1,
            seconds,
            motion,
            taken,
            direction_in_tracking: Vector3::x(),
        };
        let text = weak_stretches(
            &[
                span(DegenerateMotion::Along, Substitute::Odometry, 30.2),
                span(DegenerateMotion::Along, Substitute::Velocity, 11.0),
                span(DegenerateMotion::Heading, Substitute::Gyroscope, 0.4),
            ],
            60.0,
        );
        assert_eq!(
            text,
            "for 41 s of 60 s the scans did not tell movement along the way; mostly odometry was taken (see report.json)\n"
        );
    }
}
