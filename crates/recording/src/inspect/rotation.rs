//! Do scans, odometry and IMU turn alike? Finds sensors that turn the other way, in other units, or at
//! other times.
//!
//! Each sensor gives the angle turned about the vertical between two times: odometry and IMU directly,
//! a scanner in the plane by the shift of its range profile that fits the profile before best. The
//! turns of two sensors over windows of a second are compared at every lag up to half a second: the
//! lag of the best correlation is the offset of their clocks, the slope of the best line tells
//! direction and scale.

use portolan_geometry::Time;

use super::finding::{Finding, Findings, Severity};
use crate::LaserScan;

/// Most beams of a profile; scanners with more are thinned.
const MAX_BEAMS: usize = 360;
/// Largest turn between two scans, radians.
const MAX_TURN: f32 = 0.6;
/// Differences of ranges beyond this count alike, metres.
const MAX_DIFFERENCE: f32 = 0.3;
/// Share of the beams that must be seen by both scans.
const MIN_OVERLAP: f32 = 0.3;
/// So many scans are compared.
const MAX_SCANS: usize = 20_000;
/// Scans farther apart than this are not compared, seconds.
const MAX_INTERVAL: f64 = 1.0;

/// The angle turned between two times, counter-clockwise seen from above.
pub(crate) type Turn = (Time, Time, f64);

/// Turns of a scanner.
#[derive(Debug, Default)]
pub(crate) struct ScanTurns {
    last: Option<(Time, Vec<f32>)>,
    costs: Vec<f32>,
    pub turns: Vec<Turn>,
}

impl ScanTurns {
    /// Takes the next scan. Only scans of the same shape are compared.
    pub fn add(&mut self, time: Time, scan: &LaserScan) {
        let stride = scan.ranges.len().div_ceil(MAX_BEAMS).max(1);
        let increment = scan.angle_increment.abs() * stride as f32;
        if self.turns.len() >= MAX_SCANS || increment.is_nan() || increment <= 0.0 {
            return;
        }
        let limits = scan.range_min.max(0.05)..=scan.range_max;
        let value = |r: &f32| if limits.contains(r) { *r } else { f32::NAN };
        let profile: Vec<f32> = scan.ranges.iter().step_by(stride).map(value).collect();
        if let Some((last_time, last)) = self.last.replace((time, profile))
            && (0.0..MAX_INTERVAL).contains(&time.seconds_since(last_time))
            && let Some((_, profile)) = &self.last
            && last.len() == profile.len()
        {
            let window = ((MAX_TURN / increment) as usize).min(profile.len() / 3);
            if let Some(shift) = best_shift(&last, profile, window, &mut self.costs) {
                // Walls move against the turn; an increment below zero counts beams clockwise.
                let turn = -f64::from(shift * increment) * f64::from(scan.angle_increment.signum());
                self.turns.push((last_time, time, turn));
            }
        }
    }
}

/// By how many beams `now` is shifted against `before`, to a fraction of a beam.
fn best_shift(before: &[f32], now: &[f32], window: usize, costs: &mut Vec<f32>) -> Option<f32> {
    costs.clear();
    let enough = MIN_OVERLAP * before.len() as f32;
    for shift in 0..=2 * window {
        let (a, b) =
            if shift <= window { (&before[window - shift..], now) } else { (before, &now[shift - window..]) };
        let (mut sum, mut count) = (0.0f32, 0.0f32);
        for (a, b) in a.iter().zip(b) {
            let difference = (a - b).abs();
            if !difference.is_nan() {
                sum += difference.min(MAX_DIFFERENCE);
                count += 1.0;
            }
        }
        costs.push(if count >= enough { sum / count } else { f32::INFINITY });
    }
    let best = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
    if best == 0 || best + 1 >= costs.len() || !costs[best].is_finite() || costs[best] > 0.5 * MAX_DIFFERENCE
    {
        return None;
    }
    let (left, middle, right) = (costs[best - 1], costs[best], costs[best + 1]);
    let curvature = left - 2.0 * middle + right;
    let fraction =
        if curvature.is_finite() && curvature > 0.0 { 0.5 * (left - right) / curvature } else { 0.0 };
    Some(best as f32 - window as f32 + fraction)
}

/// How the turns of two sensors compare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Agreement {
    /// −1 to 1.
    pub correlation: f64,
    /// Turn of the second sensor for each radian of the first.
    pub slope: f64,
    /// By how many seconds the second sensor is stamped too late.
    pub lag: f64,
    /// Correlation without any lag.
    pub correlation_without_lag: f64,
    /// How much the first sensor turned in all, radians.
    pub turned: f64,
}

const WINDOW: f64 = 1.0;
const STEP: f64 = 0.5;
const LAG_STEP: f64 = 0.02;
const LAG_STEPS: i32 = 25;
/// Windows in which a sensor has no data for so long are not used, seconds.
const MAX_HOLE: f64 = 0.6;

/// Compares two sensors; `None` without enough common data.
pub(crate) fn compare(first: &[Turn], second: &[Turn]) -> Option<Agreement> {
    let (a, b) = (Angle::new(first), Angle::new(second));
    let origin = first.first()?.0;
    let (start, end) = (a.start()?.max(b.start()?), a.end()?.min(b.end()?));
    let windows: Vec<(f64, f64)> = (0..)
        .map(|i| start.seconds_since(origin) + 0.5 + STEP * f64::from(i))
        .take_while(|t| t + WINDOW + 0.5 <= end.seconds_since(origin))
        .filter_map(|t| Some((t, a.turned(origin, t)?)))
        .collect();
    let turned: f64 = windows.iter().map(|(_, d)| d.abs()).sum::<f64>() * STEP / WINDOW;
    let at_lag = |lag: f64| {
        let (mut ab, mut aa, mut bb, mut count) = (0.0, 0.0, 0.0, 0);
        for (t, turn_a) in &windows {
            if let Some(turn_b) = b.turned(origin, t + lag) {
                (ab, aa, bb, count) =
                    (ab + turn_a * turn_b, aa + turn_a * turn_a, bb + turn_b * turn_b, count + 1);
            }
        }
        (count >= 20 && aa > 0.0 && bb > 0.0).then(|| (ab / (aa * bb).sqrt(), ab / aa))
    };
    let (correlation_without_lag, _) = at_lag(0.0)?;
    let (mut correlation, mut slope, mut lag) = (0.0, 0.0, 0.0);
    // Small lags first, so that ties stay near zero.
    for step in (0..=LAG_STEPS).flat_map(|s| [s, -s]) {
        let this_lag = LAG_STEP * f64::from(step);
        if let Some((c, s)) = at_lag(this_lag).filter(|(c, _)| c.abs() > f64::abs(correlation) + 1e-6) {
            (correlation, slope, lag) = (c, s, this_lag);
        }
    }
    Some(Agreement { correlation, slope, lag, correlation_without_lag, turned })
}

/// Angle as a function of time, and where it has holes.
struct Angle {
    /// Time, angle, and whether the way from the point before is known.
    points: Vec<(Time, f64, bool)>,
}

impl Angle {
    fn new(turns: &[Turn]) -> Self {
        let mut points: Vec<(Time, f64, bool)> = Vec::with_capacity(turns.len() + 1);
        let mut angle = 0.0;
        for (from, to, turn) in turns {
            match points.last() {
                Some((last, ..)) if from < last => continue,
                Some((last, ..)) if from == last => {}
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

    /// The turn in the window that begins `seconds` after `origin`, if it is known all along.
    fn turned(&self, origin: Time, seconds: f64) -> Option<f64> {
        let at = |seconds: f64| origin + portolan_geometry::Duration::from_seconds(seconds);
        let (begin, end) = (at(seconds), at(seconds + WINDOW));
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

/// Tells how `second` turns against `first`.
pub(crate) fn tell(first: (&str, &[Turn]), second: (&str, &[Turn]), findings: &mut Findings) {
    let Some(agreement) = compare(first.1, second.1) else { return };
    let Agreement { correlation, slope, lag, turned, .. } = agreement;
    // Below half a turn in all there is nothing to judge.
    if turned < std::f64::consts::PI {
        return;
    }
    let (a, b) = (first.0, second.0);
    let mut add = |severity, what: String, effect: &str, to_do: &str| {
        findings.push(Finding {
            severity,
            topic: b.to_owned(),
            count: 1,
            what,
            effect_on_slam: effect.to_owned(),
            what_to_do: to_do.to_owned(),
        });
    };
    if correlation < -0.6 {
        add(
            Severity::Error,
            format!("the sensor turns the other way than {a} (correlation {correlation:.2})"),
            "prediction and scans contradict each other; the map breaks in every turn",
            "a scanner or IMU is mounted upside down without saying so in the transforms, or odometry has a wrong sign",
        );
    } else if correlation < 0.3 {
        add(
            Severity::Warning,
            format!("the sensor does not turn like {a} (correlation {correlation:.2})"),
            "prediction is of little use; the map may break in turns",
            "see whether both are of the same robot and have sensible stamps; leave one out with --no-odom or --no-imu",
        );
    } else if correlation > 0.7 && !(0.75..=1.33).contains(&slope) {
        let degrees = if (45.0..70.0).contains(&slope) || (0.014..0.022).contains(&slope) {
            "; one of the two seems to be in degrees"
        } else {
            ""
        };
        add(
            Severity::Warning,
            format!("the sensor turns {slope:.2} times as far as {a}{degrees}"),
            "prediction in turns is off; matching must make up for it",
            "calibrate the wheel base or the gyroscope, or leave it out with --no-odom or --no-imu",
        );
    }
    // What is left unexplained must shrink by the lag, or it is chance.
    let unexplained = |c: f64| 1.0 - c * c;
    let is_better = unexplained(correlation) < 0.8 * unexplained(agreement.correlation_without_lag);
    if correlation > 0.8 && lag.abs() > 0.05 && is_better {
        add(
            if lag.abs() > 0.1 { Severity::Warning } else { Severity::Info },
            format!(
                "stamps are about {:.2} s {} than those of {a}",
                lag.abs(),
                if lag > 0.0 { "later" } else { "earlier" }
            ),
            "motion in turns is predicted for the wrong time; the map blurs",
            "synchronise the clocks, or stamp with the time of measurement instead of arrival",
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Header;

    fn at(seconds: f64) -> Time {
        Time::from_ros(1_700_000_000, 0) + portolan_geometry::Duration::from_seconds(seconds)
    }

    /// Heading of a robot that wags to and fro.
    fn heading(t: f64) -> f64 {
        0.8 * (0.7 * t).sin() + 0.5 * (0.23 * t).sin()
    }

    fn turns(delay: f64, scale: f64, interval: f64) -> Vec<Turn> {
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
    fn findings_name_the_fault() {
        let text = |delay, scale| {
            let mut findings = Findings::default();
            tell(("/odom", &turns(0.0, 1.0, 0.05)), ("/scan", &turns(delay, scale, 0.2)), &mut findings);
            super::super::findings_to_text(&findings.finish())
        };
        assert_eq!(text(0.0, 1.0), "");
        assert!(text(0.0, -1.0).contains("turns the other way"));
        assert!(text(0.0, 57.3).contains("degrees"));
        assert!(text(0.3, 1.0).contains("0.30 s later than those of /odom"));
    }

    #[test]
    fn scans_of_a_turning_robot_in_a_room_tell_its_turns() {
        // A room of 8 m by 5 m, seen from (1, 0.5).
        let range = |angle: f64| {
            let (s, c) = angle.sin_cos();
            let x = if c > 0.0 { 3.0 / c } else { -5.0 / c };
            let y = if s > 0.0 { 2.0 / s } else { -3.0 / s };
            x.min(y)
        };
        let mut scans = ScanTurns::default();
        for i in 0..100 {
            let t = 0.2 * f64::from(i);
            let ranges = (0..360)
                .map(|k| {
                    range(heading(t) + (-90.0 + 0.5 * f64::from(k)) * std::f64::consts::PI / 180.0) as f32
                })
                .collect();
            let scan = LaserScan {
                header: Header { stamp: at(t), frame_id: "laser".into() },
                angle_min: -std::f32::consts::FRAC_PI_2,
                angle_max: std::f32::consts::FRAC_PI_2,
                angle_increment: 0.5f32.to_radians(),
                time_increment: 0.0,
                scan_time: 0.0,
                range_min: 0.0,
                range_max: 30.0,
                ranges,
                intensities: Vec::new(),
            };
            scans.add(at(t), &scan);
        }
        let agreement = compare(&turns(0.0, 1.0, 0.05), &scans.turns).unwrap();
        assert!((agreement.slope - 1.0).abs() < 0.02 && agreement.lag.abs() < 0.03, "{agreement:?}");
    }
}
