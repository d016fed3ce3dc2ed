//! Checks the values of one IMU: estimates the gyroscope bias at rest, and finds readings that were
//! saturated at the end of the measuring range.

use portolan_geometry::{Time, Vector3};
use portolan_issue::Severity;

use crate::finding::{Findings, Kind};
use crate::offset::median;

const BIAS: Kind = Kind {
    name: "gyroscope bias",
    severity: Severity::Info,
    effect: "in 3D the bias is estimated while mapping; in 2D heading drifts by it between scans",
    to_do: "",
};
const LARGE_BIAS: Kind = Kind {
    name: "large gyroscope bias",
    severity: Severity::Warning,
    effect: BIAS.effect,
    to_do: "let the IMU warm up and stand still for some seconds at the start, or let its driver remove the bias",
};
const SATURATED: Kind = Kind {
    name: "saturated",
    severity: Severity::Warning,
    effect: "fast motion is underestimated there; scans must make up for it",
    to_do: "set a larger range of the sensor (degrees per second, g), or mount it on dampers",
};

/// Length of the time windows in which rest is detected, seconds.
const WINDOW: f64 = 1.0;
/// Standard deviation of angular velocities at rest, at most, rad/s.
const REST_RATE_SPREAD: f64 = 0.02;
/// Standard deviation of accelerations at rest, at most, m/s².
const REST_ACCELERATION_SPREAD: f64 = 0.25;
/// Mean angular velocity at rest, at most, rad/s.
const REST_RATE: f64 = 0.2;
/// Minimum number of windows at rest to estimate the bias.
const ENOUGH_WINDOWS: usize = 2;
/// Median deviation between the windows above which they are slow rotation, not rest, rad/s.
const SAME_BIAS: f64 = 0.01;
/// Bias above which it is reported, rad/s.
const REPORTED_BIAS: f64 = 1e-3;
/// Bias above which the report is a warning, rad/s.
const WARNED_BIAS: f64 = 0.02;
/// Maximum number of windows that are kept.
const MAX_WINDOWS: usize = 10_000;

/// Mean readings of windows of rest.
#[derive(Debug, Default)]
pub(super) struct Rest {
    begin: Option<Time>,
    count: f64,
    rate: Vector3,
    rate_squared: f64,
    acceleration: Vector3,
    acceleration_squared: f64,
    biases: Vec<Vector3>,
}

impl Rest {
    /// Takes a sample.
    pub fn add(&mut self, time: Time, rate: Vector3, acceleration: Vector3) {
        let begin = *self.begin.get_or_insert(time);
        let seconds = time.seconds_since(begin);
        if !(0.0..WINDOW).contains(&seconds) {
            self.end_window();
            self.begin = Some(time);
        }
        self.count += 1.0;
        self.rate += rate;
        self.rate_squared += rate.norm_squared();
        self.acceleration += acceleration;
        self.acceleration_squared += acceleration.norm_squared();
    }

    fn end_window(&mut self) {
        let n = self.count.max(1.0);
        let (rate, acceleration) = (self.rate / n, self.acceleration / n);
        let spread = |squared: f64, mean: &Vector3| (squared / n - mean.norm_squared()).max(0.0).sqrt();
        let rests = self.count >= 5.0
            && spread(self.rate_squared, &rate) < REST_RATE_SPREAD
            && spread(self.acceleration_squared, &acceleration) < REST_ACCELERATION_SPREAD
            && rate.norm() < REST_RATE;
        if rests && self.biases.len() < MAX_WINDOWS {
            self.biases.push(rate);
        }
        *self = Self { biases: std::mem::take(&mut self.biases), ..Self::default() };
    }

    /// Bias of the gyroscope, rad/s; none if the IMU never was at rest.
    fn bias(&self) -> Option<Vector3> {
        let axis = |i: usize| median(self.biases.iter().map(|b| b[i]).collect());
        let bias = Vector3::new(axis(0), axis(1), axis(2));
        let spread = median(self.biases.iter().map(|b| (b - bias).norm()).collect());
        (self.biases.len() >= ENOUGH_WINDOWS && spread < SAME_BIAS).then_some(bias)
    }

    pub fn finish(&self, topic: &str, findings: &mut Findings) {
        let Some(bias) = self.bias().filter(|b| b.norm() > REPORTED_BIAS) else { return };
        let kind = if bias.norm() > WARNED_BIAS { &LARGE_BIAS } else { &BIAS };
        let per_minute = 60.0 * bias.norm().to_degrees();
        findings.add(kind, topic, || {
            format!(
                "the gyroscope shows {:.4} {:.4} {:.4} rad/s while it rests ({per_minute:.1}° a minute)",
                bias.x, bias.y, bias.z
            )
        });
    }
}

/// Readings of one axis at the end of its range. A saturated reading repeats exactly the same largest value
/// in consecutive samples.
#[derive(Clone, Copy, Debug)]
struct Extreme {
    value: f64,
    hits: u64,
    runs: u64,
    in_run: bool,
}

impl Default for Extreme {
    fn default() -> Self {
        Self { value: f64::NEG_INFINITY, hits: 0, runs: 0, in_run: false }
    }
}

impl Extreme {
    fn add(&mut self, value: f64) {
        if value > self.value {
            *self = Self { value, hits: 1, runs: 0, in_run: true };
        } else if value == self.value {
            self.hits += 1;
            self.runs += u64::from(self.in_run);
            self.in_run = true;
        } else {
            self.in_run = false;
        }
    }
}

/// Minimum number of samples that follow another one of the same largest value.
const ENOUGH_RUNS: u64 = 5;
/// Smallest value that can be saturated (gyroscope, rad/s; accelerometer, m/s²).
const LEAST: [f64; 2] = [0.2, 2.0];
/// Minimum distance of a saturated value from the mean, as a fraction of the range of all values; nearer
/// values are those of an axis at rest.
const AWAY: f64 = 0.25;

/// Ends of the ranges of gyroscope and accelerometer.
#[derive(Debug, Default)]
pub(super) struct Saturation {
    /// For gyroscope x, y, z, accelerometer x, y, z: the largest values in positive and in negative
    /// direction.
    ends: [[Extreme; 2]; 6],
    sums: [f64; 6],
    count: u64,
}

impl Saturation {
    /// Takes a sample.
    pub fn add(&mut self, rate: Vector3, acceleration: Vector3) {
        self.count += 1;
        let values = rate.iter().chain(&acceleration);
        for ((ends, sum), value) in self.ends.iter_mut().zip(&mut self.sums).zip(values) {
            ends[0].add(*value);
            ends[1].add(-value);
            *sum += value;
        }
    }

    pub fn finish(&self, topic: &str, findings: &mut Findings) {
        for (index, [up, down]) in self.ends.iter().enumerate() {
            let mean = self.sums[index] / self.count.max(1) as f64;
            let (is_up, worst) = if up.runs >= down.runs { (true, up) } else { (false, down) };
            let from_mean = worst.value - if is_up { mean } else { -mean };
            let is_end = worst.value > LEAST[index / 3] && from_mean > AWAY * (up.value + down.value);
            if !is_end || worst.runs < ENOUGH_RUNS {
                continue;
            }
            let (sensor, unit) = if index < 3 { ("gyroscope", "rad/s") } else { ("accelerometer", "m/s²") };
            let axis = ["x", "y", "z"][index % 3];
            let sign = if is_up { "" } else { "-" };
            findings.add(&SATURATED, topic, || {
                format!(
                    "{} samples of the {sensor} end at exactly {sign}{:.4} {unit} about {axis}: the end of its range",
                    worst.hits, worst.value
                )
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::findings_to_text;

    fn text(sample: impl Fn(f64) -> (Vector3, Vector3)) -> String {
        let (mut rest, mut saturation) = (Rest::default(), Saturation::default());
        for i in 0..4000 {
            let t = 0.005 * f64::from(i);
            let (rate, acceleration) = sample(t);
            let time = Time::from_ros(1_700_000_000, 0) + portolan_geometry::Duration::from_seconds(t);
            rest.add(time, rate, acceleration);
            saturation.add(rate, acceleration);
        }
        let mut findings = Findings::default();
        rest.finish("/imu", &mut findings);
        saturation.finish("/imu", &mut findings);
        findings_to_text(&findings.finish())
    }

    const UP: Vector3 = Vector3::new(0.0, 0.0, 9.81);

    #[test]
    fn bias_shows_at_rest_and_not_in_turns() {
        let resting = |t: f64| f64::from(t < 4.0);
        let bias = Vector3::new(0.0, 0.003, -0.03);
        let shaken = text(|t| (bias + Vector3::new(0.0, 0.0, (1.0 - resting(t)) * (7.0 * t).sin()), UP));
        assert!(shaken.contains("0.0000 0.0030 -0.0300 rad/s"), "{shaken}");
        assert!(shaken.starts_with("warning"), "{shaken}");
        assert_eq!(text(|t| (Vector3::new(0.0, 0.0, (7.0 * t).sin()), UP)), "");
        // Slow turns of different speed.
        assert_eq!(text(|t| (Vector3::new(0.0, 0.0, 0.02 * (t / 3.0).floor()), UP)), "");
    }

    #[test]
    fn ends_of_the_range_are_found() {
        let swing = |t: f64| Vector3::new(0.0, 3.0 * (2.0 * t).sin(), 0.0);
        assert_eq!(text(|t| (swing(t), UP)), "");
        let cut = text(|t| (swing(t).map(|v| v.clamp(-2.0, 2.0)), UP));
        assert!(cut.contains("gyroscope end at exactly") && cut.contains("about y"), "{cut}");
        let knocked =
            text(|t| (Vector3::zeros(), UP + Vector3::new(0.0, 0.0, (20.0 * (9.0 * t).sin()).min(9.8))));
        assert!(knocked.contains("accelerometer end at exactly 19.6100 m/s²"), "{knocked}");
        assert_eq!(text(|_| (Vector3::zeros(), UP)), "");
    }
}
