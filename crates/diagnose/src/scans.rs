//! Checks the range data of one topic (checks 4 to 8 and 12 of `spec/tools.md` §2.6, and units).

use portolan_geometry::Time;
use portolan_ingest::{ScanFaults, TimedPoints};
use portolan_issue::Severity;
use portolan_recording::LaserScan;

use crate::finding::{Findings, Kind};

const NOT_SEQUENTIAL: Kind = Kind {
    name: "not sequential",
    severity: Severity::Error,
    effect: "scans that do not end later than the one before are left out",
    to_do: "record in the order of measurement; look for wrong stamps or point times",
};
const OVERLAP: Kind = Kind {
    name: "overlap",
    severity: Severity::Warning,
    effect: "points are placed by the pose of the robot at their time; wrong times blur the map",
    to_do: "see whether stamps are those of the first point (or the last), and whether point times are right",
};
const LONGEST_OVERLAP: Kind = Kind {
    name: "longest overlap",
    severity: Severity::Warning,
    effect: OVERLAP.effect,
    to_do: OVERLAP.to_do,
};
/// Difference of times from which it is a jump, which another check reports, seconds.
const JUMP: f64 = 10.0;
const REPEATED: Kind = Kind {
    name: "repeated data",
    severity: Severity::Error,
    effect: "repeated scans look as if the robot stood still; map leaves them out, so that scans are missing",
    to_do: "look for a driver that sends old data again",
};
const REPEATED_SELDOM: Kind = Kind {
    name: "repeated data, seldom",
    severity: Severity::Warning,
    effect: REPEATED.effect,
    to_do: REPEATED.to_do,
};
/// Fraction of repeated messages above which they are an error.
const MANY_REPEATED: f64 = 0.05;
const NO_RETURNS: Kind = Kind {
    name: "no returns",
    severity: Severity::Warning,
    effect: "these messages give nothing",
    to_do: "look at range_min and range_max, and whether something covers the sensor",
};
const LIMITS: Kind = Kind {
    name: "limits",
    severity: Severity::Error,
    effect: "scans are read without limits; readings that mean \"no return\" may become walls",
    to_do: "let the driver fill in range_min and range_max",
};
const INCREMENT: Kind = Kind {
    name: "increment",
    severity: Severity::Error,
    effect: "beams may point the wrong way",
    to_do: "let the driver fill in angle_min, angle_max and angle_increment so that they fit",
};
const TIME_INCREMENT: Kind = Kind {
    name: "time increment",
    severity: Severity::Warning,
    effect: "all points count as measured at once; rotation while scanning blurs the map",
    to_do: "let the driver fill in time_increment (seconds between beams)",
};
const DEGREES: Kind = Kind {
    name: "degrees",
    severity: Severity::Error,
    effect: "beams point in wrong directions; there is no sensible map",
    to_do: "angles must be in radians; convert the recording or mend the driver",
};
const MILLIMETRES: Kind = Kind {
    name: "millimetres",
    severity: Severity::Error,
    effect: "everything is a thousand times too large; nothing within the usual limits is left",
    to_do: "ranges must be in metres; convert the recording or mend the driver",
};
const BEYOND: Kind = Kind {
    name: "beyond range_max",
    severity: Severity::Info,
    effect: "these readings count as no return",
    to_do: "",
};
const FAULTY: Kind = Kind {
    name: "faulty readings",
    severity: Severity::Info,
    effect: "these readings count as no return",
    to_do: "",
};

/// Range messages of one topic.
#[derive(Debug, Default)]
pub(crate) struct RangeChecks {
    last_end: Option<Time>,
    last_sum: Option<(Time, Sum)>,
    longest_overlap: f64,
    messages: u64,
    repeated: u64,
    first_repeated: String,
    beyond: u64,
    faulty: u64,
    ranges: Vec<f32>,
}

/// The number of points, and the sums of their coordinates and times.
type Sum = (usize, [f64; 4]);

fn sum_of(points: &TimedPoints) -> Sum {
    let mut sum = [0.0; 4];
    for point in &points.points {
        let values = [point.position.x, point.position.y, point.position.z, point.time];
        for (sum, value) in sum.iter_mut().zip(values) {
            *sum += f64::from(value);
        }
    }
    (points.points.len(), sum)
}

/// Maximum number of ranges that are kept to judge units.
const MAX_RANGES: usize = 20_000;

impl RangeChecks {
    /// Checks shape and values of a laser scan.
    pub fn add_scan(&mut self, topic: &str, scan: &LaserScan, faults: ScanFaults, findings: &mut Findings) {
        let beams = scan.ranges.len();
        if beams == 0 {
            // It is reported as a scan without a single distance; its angles have no meaning.
            return;
        }
        let view = scan.angle_increment.abs() * beams.saturating_sub(1) as f32;
        if view > 1.2 * std::f32::consts::TAU {
            findings.add(&DEGREES, topic, || {
                format!(
                    "{beams} beams of angle_increment {} make {:.1} revolutions",
                    scan.angle_increment,
                    view / std::f32::consts::TAU
                )
            });
        }
        if faults.bad_limits {
            findings.add(&LIMITS, topic, || {
                format!("range_min {} and range_max {} make no sense", scan.range_min, scan.range_max)
            });
        }
        let fits =
            (scan.angle_max - scan.angle_min - scan.angle_increment * beams.saturating_sub(1) as f32).abs();
        let is_off = fits > 2.0 * scan.angle_increment.abs() && view <= 1.2 * std::f32::consts::TAU;
        if faults.bad_increment || is_off {
            findings.add(&INCREMENT, topic, || {
                format!(
                    "{beams} beams from {} to {} rad do not fit angle_increment {}",
                    scan.angle_min, scan.angle_max, scan.angle_increment
                )
            });
        }
        if faults.bad_time_increment {
            findings.add(&TIME_INCREMENT, topic, || format!("time_increment is {}", scan.time_increment));
        }
        self.faulty += faults.nan_readings + faults.negative_readings + faults.huge_readings;
        self.beyond += scan.ranges.iter().filter(|r| r.is_finite() && **r > scan.range_max).count() as u64;
        if self.ranges.len() < MAX_RANGES {
            self.ranges.extend(scan.ranges.iter().filter(|r| r.is_finite() && **r > 0.0).step_by(10));
        }
    }

    /// Checks times and points of any range message.
    pub fn add_points(&mut self, topic: &str, frame: &str, points: &TimedPoints, findings: &mut Findings) {
        let (Some(first), end) = (points.points.first(), points.time) else {
            return findings.add(&NO_RETURNS, topic, || "messages without a single distance".to_owned());
        };
        let sum = sum_of(points);
        let before = self.last_sum.replace((end, sum));
        if before == Some((end, sum)) {
            // The message before is sent once more: its repeated stamp is a finding. No data is missing.
            return;
        }
        let start = end + portolan_geometry::Duration::from_seconds(f64::from(first.time));
        let last_end =
            self.last_end.filter(|last| end.seconds_since(*last).abs() < JUMP).unwrap_or(Time::MIN);
        if last_end >= end {
            self.longest_overlap = self.longest_overlap.max(last_end.seconds_since(start));
            findings.add(&NOT_SEQUENTIAL, topic, || {
                format!("sensor with frame_id \"{frame}\" is not sequential in time. Previous range message ends at time {last_end}, current one at time {end}")
            });
        } else if last_end > start || (last_end == start && start != end) {
            self.longest_overlap = self.longest_overlap.max(last_end.seconds_since(start));
            findings.add(&OVERLAP, topic, || {
                format!("sensor with frame_id \"{frame}\" measurements overlap in time. Previous range message, ending at time stamp {last_end}, must finish before current range message, which ranges from {start} to {end}")
            });
        }
        self.last_end = Some(last_end.max(end));
        self.messages += 1;
        if before.is_some_and(|(_, before)| before == sum) {
            if self.repeated == 0 {
                self.first_repeated = format!(
                    "sensor with frame_id \"{frame}\" sends exactly the same range measurements multiple times. Range data at time {end} equals preceding data with {} points",
                    points.points.len()
                );
            }
            self.repeated += 1;
        }
    }

    /// Adds findings about the whole topic.
    pub fn finish(mut self, topic: &str, findings: &mut Findings) {
        if self.longest_overlap > 0.0 {
            let longest = self.longest_overlap;
            findings.add(&LONGEST_OVERLAP, topic, || {
                format!("range measurements have longest overlap of {longest:.6} s")
            });
        }
        let is_many = self.repeated as f64 > MANY_REPEATED * self.messages as f64;
        for _ in 0..self.repeated {
            let kind = if is_many { &REPEATED } else { &REPEATED_SELDOM };
            findings.add(kind, topic, || self.first_repeated.clone());
        }
        self.ranges.sort_by(f32::total_cmp);
        if let Some(median) = self.ranges.get(self.ranges.len() / 2).filter(|m| **m > 300.0) {
            findings.add(&MILLIMETRES, topic, || {
                format!("half of the readings are above {median} m; they seem to be millimetres")
            });
        }
        for (kind, count, what) in [
            (&BEYOND, self.beyond, "readings beyond range_max"),
            (&FAULTY, self.faulty, "readings that are not a number, negative or beyond 1,000 km"),
        ] {
            if count > 0 {
                findings.add(kind, topic, || format!("{count} {what}"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use portolan_geometry::Point3f;
    use portolan_sensor::TimedPoint;

    /// Findings for scans of these times and ranges, metres.
    fn severities(scans: &[(f64, f32)]) -> Vec<Severity> {
        let (mut checks, mut findings) = (RangeChecks::default(), Findings::default());
        for (seconds, range) in scans {
            let points = vec![TimedPoint { position: Point3f::new(*range, 0.0, 0.0), time: 0.0 }];
            let time = Time::from_ticks(0) + portolan_geometry::Duration::from_seconds(*seconds);
            let points = TimedPoints { time, points, intensities: Vec::new() };
            checks.add_points("/scan", "laser", &points, &mut findings);
        }
        checks.finish("/scan", &mut findings);
        findings.finish().into_iter().map(|finding| finding.severity).collect()
    }

    #[test]
    fn duplicate_messages_are_not_counted_as_missing() {
        assert_eq!(severities(&[(1.0, 2.0), (1.0, 2.0), (1.1, 2.1), (1.1, 2.1), (1.2, 2.2)]), []);
        // The readings before with a new stamp, and others with the stamp before.
        assert_eq!(severities(&[(1.0, 2.0), (1.1, 2.0), (1.2, 2.2)]), [Severity::Error]);
        assert_eq!(severities(&[(1.0, 2.0), (1.0, 2.1), (1.2, 2.2)]), [Severity::Error]);
    }
}
