//! Checks the satellite fixes of one topic: impossible positions, jumps, and receivers that repeat old
//! fixes.

use portolan_geometry::{GeodeticPosition, Time, Vector3};
use portolan_issue::Severity;
use portolan_recording::NavSatFix;

use crate::finding::{Findings, Kind};

const NOT_ON_EARTH: Kind = Kind {
    name: "not on Earth",
    severity: Severity::Warning,
    effect: "such fixes are left out",
    to_do: "fixes are in degrees and metres (WGS 84): mend the driver, or do without --gnss",
};
const NOWHERE: Kind = Kind {
    name: "nowhere",
    severity: Severity::Info,
    effect: "these count as no fix",
    to_do: "let the driver mark them as no fix in their status",
};
const JUMP: Kind = Kind {
    name: "fix jump",
    severity: Severity::Warning,
    effect: "with --gnss a single jump pulls the map no more than other fixes do; many jumps lower the weight of all fixes",
    to_do: "causes are reflected signals (multipath), or a receiver that has just started: compare under open sky",
};
const HANGS: Kind = Kind {
    name: "fix repeats",
    severity: Severity::Warning,
    effect: "with --gnss fixes that stand while the robot moves contradict the map, and may be left out altogether",
    to_do: "see whether the receiver or its driver hangs; real fixes change in their last digits at rest, too",
};

/// Speed above which a fix jumps, m/s: no ground platform with a lidar is faster.
const MAX_SPEED: f64 = 60.0;
/// Error of fixes that is allowed before a jump, metres.
const USUAL_ERROR: f64 = 10.0;
/// Time from which a fix that repeats to the last digit is an old one, seconds.
const LONG: f64 = 5.0;
/// Number of repeats from which it is an old one.
const OFTEN: u32 = 10;

/// Satellite fixes of one topic.
#[derive(Debug, Default)]
pub(crate) struct FixChecks {
    last: Option<(Time, Vector3)>,
    /// Time of the first fix of the last position, and number of its repeats.
    repeats: Option<(Time, u32)>,
}

impl FixChecks {
    pub fn add(&mut self, topic: &str, message: &NavSatFix, findings: &mut Findings) {
        let stamp = message.header.stamp;
        if message.status < 0 {
            return;
        }
        let &NavSatFix { latitude_degrees, longitude_degrees, altitude, .. } = message;
        if latitude_degrees == 0.0 && longitude_degrees == 0.0 {
            return findings
                .add(&NOWHERE, topic, || "fixes at latitude 0, longitude 0, said to be fixes".to_owned());
        }
        let place = GeodeticPosition { latitude_degrees, longitude_degrees, altitude };
        if !place.is_valid() {
            return findings.add(&NOT_ON_EARTH, topic, || {
                format!("latitude {latitude_degrees}, longitude {longitude_degrees}, altitude {altitude} is not a place on Earth")
            });
        }
        let place = place.to_ecef();
        let Some((before, last)) = self.last.replace((stamp, place)) else { return };
        if place == last {
            self.repeat(topic, before, stamp, findings);
            return;
        }
        self.repeats = None;
        let (seconds, distance) = (stamp.seconds_since(before).max(0.0), (place - last).norm());
        if distance > MAX_SPEED * seconds + USUAL_ERROR {
            findings.add(&JUMP, topic, || {
                format!("the position jumps by {distance:.0} m within {seconds:.1} s at {stamp}")
            });
        }
    }

    fn repeat(&mut self, topic: &str, before: Time, stamp: Time, findings: &mut Findings) {
        let (since, count) = self.repeats.get_or_insert((before, 0));
        *count += 1;
        let seconds = stamp.seconds_since(*since);
        if seconds > LONG && *count >= OFTEN {
            findings
                .add(&HANGS, topic, || format!("the same fix for more than {seconds:.0} s, from {since}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::findings_to_text;
    use portolan_recording::Header;

    /// Five fixes a second with latitude, longitude and status from `of`.
    fn findings_of(of: impl Fn(i32) -> (f64, f64, i8)) -> String {
        let (mut checks, mut findings) = (FixChecks::default(), Findings::default());
        for i in 0..100 {
            let (latitude_degrees, longitude_degrees, status) = of(i);
            let stamp = Time::from_unix_seconds(1e9 + 0.2 * f64::from(i));
            let fix = NavSatFix {
                header: Header { stamp, frame_id: "gps".into() },
                status,
                service: 1,
                latitude_degrees,
                longitude_degrees,
                altitude: 500.0,
                position_covariance: [0.0; 9],
                position_covariance_type: 0,
            };
            checks.add("/fix", &fix, &mut findings);
        }
        findings_to_text(&findings.finish())
    }

    fn latitude(i: i32) -> f64 {
        48.0 + 1e-5 * f64::from(i)
    }

    #[test]
    fn valid_fixes_have_no_findings() {
        assert_eq!(findings_of(|i| (latitude(i), 11.0, 0)), "");
        // Without a fix, and off by a few metres.
        assert_eq!(findings_of(|i| (latitude(i) + 4e-5 * f64::from(i % 2), 11.0, 0)), "");
        assert_eq!(findings_of(|i| if i % 2 == 0 { (0.0, 0.0, -1) } else { (latitude(i), 11.0, 0) }), "");
    }

    #[test]
    fn invalid_fixes_jumps_and_hanging_receivers_are_reported() {
        assert!(
            findings_of(|i| if i < 3 { (0.0, 0.0, 0) } else { (latitude(i), 11.0, 0) }).contains("(3 times)")
        );
        assert!(findings_of(|_| (512_000.0, 11.0, 0)).contains("is not a place"));
        let jump = findings_of(|i| (latitude(i) + if i == 50 { 0.01 } else { 0.0 }, 11.0, 0));
        assert!(jump.contains("jumps by 111") && jump.contains("(2 times)"), "{jump}");
        assert!(findings_of(|i| (latitude(i.min(20)), 11.0, 0)).contains("the same fix for more than 5 s"));
    }
}
