//! Checks that scans, odometry and IMU rotate alike: finds sensors with opposite sign, other units, or
//! another clock.
//!
//! Each sensor gives the angle turned about the vertical between two times: odometry and IMU directly, a
//! lidar by the shift with which its range profile fits the profile before best ([`super::scan_turns`]). The
//! rotations of two sensors over windows of a second are compared at every lag up to half a second: the
//! slope of the regression line gives direction and scale. Shorter windows give the offset of their clocks
//! ([`super::offset`]).

use portolan_geometry::Time;
use portolan_issue::Severity;

use crate::clock_offset::{ImuMisalignment, ImuMounting};
use crate::finding::{Finding, Findings};
use crate::offset::{Offset, clock_offset};

/// The angle turned between two times, counter-clockwise seen from above.
pub(crate) type Turn = (Time, Time, f64);

/// Comparison of the rotations of two sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Agreement {
    /// Correlation, −1 to 1.
    pub correlation: f64,
    /// Rotation of the second sensor for each radian of the first.
    pub slope: f64,
    /// Time by which the second sensor is stamped too late, seconds.
    pub lag: f64,
    /// Standard deviation of the lag, seconds.
    pub lag_sigma: f64,
    /// Relative decrease of the differences between rotations with the lag.
    pub lag_gain: f64,
    /// Sum of the rotation of the first sensor, radians.
    pub turned: f64,
}

/// Length of the windows in which rotations are compared, and step from one to the next, seconds.
const COARSE: Windows = Windows { length: 1.0, step: 0.5 };
/// Step of the lags that are compared, seconds.
const LAG_STEP: f64 = 0.02;
/// Number of lags to each side of zero.
const LAG_STEPS: i32 = 25;
/// Minimum number of common windows.
const ENOUGH_WINDOWS: usize = 20;
/// Duration without data from which windows that contain it are not used, seconds.
const MAX_HOLE: f64 = 0.6;
/// Maximum time between the end of a rotation and the start of the next for them to be consecutive, seconds:
/// the part of a sweep that constrains a rotation differs from sweep to sweep.
pub(super) const JOINT: f64 = 0.06;

#[derive(Clone, Copy)]
struct Windows {
    length: f64,
    step: f64,
}

/// Rotations of two sensors in windows of one length.
struct Comparison<'a> {
    second: &'a Angle,
    origin: Time,
    length: f64,
    /// Start after the origin, seconds, and rotation of the first sensor, radians.
    windows: Vec<(f64, f64)>,
}

impl<'a> Comparison<'a> {
    fn new(first: &Angle, second: &'a Angle, windows: Windows) -> Option<Self> {
        let origin = first.start()?;
        let (start, end) = (origin.max(second.start()?), first.end()?.min(second.end()?));
        let Windows { length, step } = windows;
        let (begin, end) = (start.seconds_since(origin) + 0.5, end.seconds_since(origin));
        let (mut known, mut index) = (Vec::new(), 0.0);
        loop {
            let t = begin + step * index;
            if t + length + 0.5 > end {
                break;
            }
            match first.turned(origin, t, length) {
                Some(turn) => known.push((t, turn)),
                // Skips to the end of the gap: it may be decades long, if a clock was set.
                None => {
                    let hole_end = first.hole_end(origin, t, length).unwrap_or(end);
                    index = f64::max(index, ((hole_end - begin) / step).floor() - 1.0);
                }
            }
            index += 1.0;
        }
        Some(Self { second, origin, length, windows: known })
    }

    /// Correlation and slope if the second sensor is stamped too late by `lag`.
    fn at_lag(&self, lag: f64) -> Option<(f64, f64)> {
        let (mut ab, mut aa, mut bb, mut count) = (0.0, 0.0, 0.0, 0);
        for (t, turn_a) in &self.windows {
            if let Some(turn_b) = self.second.turned(self.origin, t + lag, self.length) {
                (ab, aa, bb, count) =
                    (ab + turn_a * turn_b, aa + turn_a * turn_a, bb + turn_b * turn_b, count + 1);
            }
        }
        (count >= ENOUGH_WINDOWS && aa > 0.0 && bb > 0.0).then(|| (ab / (aa * bb).sqrt(), ab / aa))
    }
}

/// Compares two sensors; `None` without enough common data.
pub(crate) fn compare(first: &[Turn], second: &[Turn]) -> Option<Agreement> {
    let (a, b) = (Angle::new(first), Angle::new(second));
    let coarse = Comparison::new(&a, &b, COARSE)?;
    let turned: f64 = coarse.windows.iter().map(|(_, d)| d.abs()).sum::<f64>() * COARSE.step / COARSE.length;
    coarse.at_lag(0.0)?;
    let (mut correlation, mut slope, mut lag) = (0.0, 0.0, 0.0);
    // Small lags first, so that ties stay near zero.
    for step in (0..=LAG_STEPS).flat_map(|s| [s, -s]) {
        let this_lag = LAG_STEP * f64::from(step);
        if let Some((c, s)) = coarse.at_lag(this_lag).filter(|(c, _)| c.abs() > f64::abs(correlation) + 1e-6)
        {
            (correlation, slope, lag) = (c, s, this_lag);
        }
    }
    let Offset { lag, sigma: lag_sigma, gain: lag_gain } = clock_offset(&a, second, slope, lag)?;
    Some(Agreement { correlation, slope, lag, lag_sigma, lag_gain, turned })
}

/// Angle as a function of time, with its gaps.
pub(super) struct Angle {
    /// Time, angle, and whether the rotation from the point before is known.
    points: Vec<(Time, f64, bool)>,
}

impl Angle {
    pub(super) fn new(turns: &[Turn]) -> Self {
        let mut points: Vec<(Time, f64, bool)> = Vec::with_capacity(turns.len() + 1);
        let mut angle = 0.0;
        for (from, to, turn) in turns {
            match points.last() {
                Some((last, ..)) if to <= last || from.seconds_since(*last) < -JOINT => continue,
                Some((last, ..)) if from.seconds_since(*last) < JOINT => {}
                Some((last, ..)) => points.push((*from, angle, from.seconds_since(*last) < MAX_HOLE)),
                None => points.push((*from, angle, false)),
            }
            angle += turn;
            points.push((*to, angle, to.seconds_since(*from) < MAX_HOLE));
        }
        Self { points }
    }

    fn start(&self) -> Option<Time> {
        self.points.first().map(|p| p.0)
    }

    fn end(&self) -> Option<Time> {
        self.points.last().map(|p| p.0)
    }

    /// The rotation in the window that begins `seconds` after `origin`, if it is known throughout.
    fn turned(&self, origin: Time, seconds: f64, length: f64) -> Option<f64> {
        let at = |seconds: f64| origin + portolan_geometry::Duration::from_seconds(seconds);
        self.between(at(seconds), at(seconds + length))
    }

    /// End of the first gap that a window reaches into, in seconds after `origin`.
    fn hole_end(&self, origin: Time, seconds: f64, length: f64) -> Option<f64> {
        let at = |seconds: f64| self.index(origin + portolan_geometry::Duration::from_seconds(seconds));
        let in_window = self.points.get(at(seconds)..=at(seconds + length))?;
        in_window.iter().find(|p| !p.2).map(|p| p.0.seconds_since(origin))
    }

    /// The rotation from one time to another, if it is known throughout.
    pub(super) fn between(&self, begin: Time, end: Time) -> Option<f64> {
        let (i, j) = (self.index(begin), self.index(end));
        let known = self.points.get(i..=j)?.iter().all(|p| p.2);
        known.then(|| self.angle(j, end) - self.angle(i, begin))
    }

    /// Index of the first point at or after `time`.
    fn index(&self, time: Time) -> usize {
        self.points.partition_point(|p| p.0 < time)
    }

    fn angle(&self, index: usize, time: Time) -> f64 {
        let (Some(after), Some(before)) = (self.points.get(index), self.points.get(index.wrapping_sub(1)))
        else {
            return 0.0;
        };
        let span = after.0.seconds_since(before.0);
        let share = if span > 0.0 { time.seconds_since(before.0) / span } else { 1.0 };
        before.1 + (after.1 - before.1) * share
    }
}

/// Minimum rotation for a comparison, radians: half a turn.
pub(crate) const ENOUGH_TURNS: f64 = std::f64::consts::PI;
/// Offsets of clocks above which they are reported, and above which the report is a warning, seconds: first
/// for sensors with a time for each point or sample, then for others.
const OFFSETS: [[f64; 2]; 2] = [[0.02, 0.035], [0.05, 0.1]];

/// Number of standard deviations by which offsets have to exceed them: for a clock exactly at the limit, one
/// in a thousand is reported (Student's t with the 11 degrees of freedom of the jackknife, one side).
const SURE: f64 = 4.0;
/// Minimum correlation of the rotations for an offset that is not by chance.
const ALIKE: f64 = 0.7;
/// Minimum gain from the offset, as a fraction of the differences, for an offset that is not by chance.
const LEAST_GAIN: f64 = 0.04;

/// Reports scale and direction of the rotation of `second` against `first`.
pub(crate) fn report_turns(first: (&str, &[Turn]), second: (&str, &[Turn]), findings: &mut Findings) {
    let Some(agreement) = compare(first.1, second.1) else { return };
    let Agreement { correlation, slope, turned, .. } = agreement;
    if turned < ENOUGH_TURNS {
        return;
    }
    let (a, b) = (first.0, second.0);
    let mut add = |severity, text: String, effect: &str, to_do: &str| {
        findings.push(finding(b, severity, text, effect, to_do));
    };
    if correlation < -0.6 {
        add(
            Severity::Error,
            format!("the sensor rotates opposite to {a} (correlation {correlation:.2})"),
            "prediction and scans contradict each other; the map breaks whenever the robot turns",
            "a scanner or IMU is mounted upside down without saying so in the transforms, or odometry has a wrong sign",
        );
    } else if correlation < 0.3 {
        add(
            Severity::Warning,
            format!("the rotation of the sensor does not agree with {a} (correlation {correlation:.2})"),
            "prediction is of little use; the map may break when the robot turns",
            "see whether both are of the same robot and have sensible stamps; leave one out with --no-odometry or --no-imu",
        );
    } else if correlation > 0.7 && !(0.75..=1.33).contains(&slope) {
        let degrees = if (45.0..70.0).contains(&slope) || (0.014..0.022).contains(&slope) {
            "; one of the two seems to be in degrees"
        } else {
            ""
        };
        add(
            Severity::Warning,
            format!("the sensor rotates {slope:.2} times as much as {a}{degrees}"),
            "predicted rotation is off; matching must make up for it",
            "calibrate the wheel base or the gyroscope, or leave it out with --no-odometry or --no-imu",
        );
    }
}

/// Reports the offset of the clock of `second` against that of `first`. `is_exact` means that the times of
/// the rotations of both are accurate.
pub(crate) fn report_clocks(
    first: (&str, &[Turn]),
    second: (&str, &[Turn]),
    is_exact: bool,
    findings: &mut Findings,
) {
    let [_, warned] = OFFSETS[usize::from(!is_exact)];
    if let Some((lag, _)) = sure_offset(first.1, second.1, is_exact) {
        findings.push(offset_finding(first.0, second.0, lag, warned));
    }
}

/// Time by which the second sensor is stamped too late, and its standard deviation, seconds, if it certainly
/// exceeds measurement errors.
pub(super) fn sure_offset(first: &[Turn], second: &[Turn], is_exact: bool) -> Option<(f64, f64)> {
    let agreement = compare(first, second)?;
    let Agreement { correlation, lag, lag_sigma, lag_gain, turned, .. } = agreement;
    let [reported, _] = OFFSETS[usize::from(!is_exact)];
    let is_sure = lag.abs() - SURE * lag_sigma > reported && lag_gain > LEAST_GAIN;
    (turned >= ENOUGH_TURNS && correlation >= ALIKE && is_sure).then_some((lag, lag_sigma))
}

/// Finding that `second` is stamped too late by `lag` against `first`.
pub(super) fn offset_finding(first: &str, second: &str, lag: f64, warned: f64) -> Finding {
    let size = if lag.abs() < 0.1 { format!("{:.3}", lag.abs()) } else { format!("{:.2}", lag.abs()) };
    let direction = if lag > 0.0 { "later" } else { "earlier" };
    finding(
        second,
        if lag.abs() > warned { Severity::Warning } else { Severity::Info },
        format!("stamps are about {size} s {direction} than those of {first}, as the rotation of both shows"),
        "rotation is taken from the wrong time, so that scans are de-skewed and predicted wrongly; the map blurs",
        &format!(
            "synchronise the two clocks (PTP), or let both drivers stamp the time of measurement, not that of arrival; \
             this recording: map --time-offset {second}={:.3}",
            -lag
        ),
    )
}

/// Finding for an IMU that does not rotate like a lidar.
pub(super) fn mounting_finding(imu: &str, mounting: &ImuMounting) -> Finding {
    finding(
        imu,
        Severity::Error,
        format!("it {mounting}"),
        match mounting.is_in_degrees() {
            true => "its angular velocities are taken as degrees per second: map multiplies them by π/180",
            false => {
                "rotations are predicted and sweeps de-skewed wrongly, and level may be wrong: map leaves the IMU out"
            }
        },
        "check the transform from the lidar to the IMU, the signs of its axes and its units (rad/s)",
    )
}

/// Finding for an IMU whose mounting differs by a few degrees from the transforms.
pub(super) fn misalignment_finding(imu: &str, misalignment: &ImuMisalignment) -> Finding {
    finding(
        imu,
        Severity::Warning,
        format!("it {misalignment}"),
        "level would be wrong by as much: map rotates its measurements, unless --imu names the IMU",
        "correct the transform from the lidar to the IMU",
    )
}

fn finding(topic: &str, severity: Severity, text: String, effect: &str, to_do: &str) -> Finding {
    Finding {
        severity,
        topic: topic.to_owned(),
        count: 1,
        text,
        effect_on_slam: effect.to_owned(),
        advice: to_do.to_owned(),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn at(seconds: f64) -> Time {
        Time::from_ros(1_700_000_000, 0) + portolan_geometry::Duration::from_seconds(seconds)
    }

    /// Heading of a robot that oscillates.
    pub fn heading(t: f64) -> f64 {
        0.8 * (0.7 * t).sin() + 0.5 * (0.23 * t).sin()
    }

    pub fn turns(delay: f64, scale: f64, interval: f64) -> Vec<Turn> {
        (0..(100.0 / interval) as usize)
            .map(|i| {
                let (t0, t1) = (interval * i as f64, interval * (i + 1) as f64);
                (at(t0 + delay), at(t1 + delay), scale * (heading(t1) - heading(t0)))
            })
            .collect()
    }

    #[test]
    fn sign_scale_and_lag_are_found() {
        for (delay, scale) in [(0.0, 1.0), (0.2, 1.0), (-0.3, 1.4), (0.0, -1.0), (0.1, 57.3)] {
            let agreement = compare(&turns(0.0, 1.0, 0.05), &turns(delay, scale, 0.2)).unwrap();
            assert!((agreement.lag - delay).abs() < 0.03, "{agreement:?}");
            assert!((agreement.slope / scale - 1.0).abs() < 0.05, "{agreement:?}");
            assert!(agreement.correlation.abs() > 0.99);
        }
        assert!(compare(&turns(0.0, 1.0, 0.1), &[]).is_none());
    }

    #[test]
    fn a_gap_of_decades_takes_no_longer_than_none() {
        let jump = portolan_geometry::Duration::from_seconds(1_780_000_000.0);
        let with_hole = |delay: f64| -> Vec<Turn> {
            let early = turns(delay, 1.0, 0.05);
            let late: Vec<Turn> =
                early.iter().map(|(from, to, turn)| (*from + jump, *to + jump, *turn)).collect();
            [early, late].concat()
        };
        let (alone, all) = (compare(&turns(0.0, 1.0, 0.05), &turns(0.1, 1.0, 0.05)), with_hole(0.0));
        let agreement = compare(&all, &with_hole(0.1)).unwrap();
        assert!((agreement.lag - alone.unwrap().lag).abs() < 0.02, "{agreement:?}");
    }

    #[test]
    fn findings_name_the_fault() {
        let text = |delay, scale| {
            let mut findings = Findings::default();
            let (odom, scan) = (turns(0.0, 1.0, 0.05), turns(delay, scale, 0.2));
            report_turns(("/odom", &odom), ("/scan", &scan), &mut findings);
            report_clocks(("/odom", &odom), ("/scan", &scan), true, &mut findings);
            super::super::findings_to_text(&findings.finish())
        };
        assert_eq!(text(0.0, 1.0), "");
        assert!(text(0.0, -1.0).contains("rotates opposite to"));
        assert!(text(0.0, 57.3).contains("degrees"));
        assert!(text(0.3, 1.0).contains("0.30 s later than those of /odom"));
        let early = text(-0.05, 1.0);
        assert!(early.contains("0.05") || early.contains("0.04"), "{early}");
        assert!(early.contains("s earlier than those of /odom"), "{early}");
    }
}
