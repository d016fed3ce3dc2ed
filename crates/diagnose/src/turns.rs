//! Compares the rotations of all sensors of a recording with each other.

use portolan_geometry::{Time, Vector3};
use portolan_issue::Severity;
use portolan_recording::Imu;

use crate::clock_offset::ClockOffset;
use crate::finding::{Findings, Kind};
use crate::imu::axis_of;
use crate::rotation::{self, ENOUGH_TURNS, Turn, compare};

const AXES: Kind = Kind {
    name: "rotates about another axis",
    severity: Severity::Error,
    effect: "prediction and scans contradict each other; the map breaks when the robot turns",
    to_do: "the axes of the gyroscope are swapped or of the wrong sign against its accelerometer: mend the driver, or leave the IMU out with --no-imu",
};

/// Correlation below which rotations do not agree.
const DISAGREES: f64 = 0.6;
/// Correlation above which rotations agree.
pub(super) const AGREES: f64 = 0.85;

/// Maximum number of rotations of an IMU that are kept.
const MAX_TURNS: usize = 500_000;
/// Time over which rotations of an IMU are summed, seconds.
const TURN_INTERVAL: f64 = 0.02;

/// Rotations of an IMU about its own axes.
#[derive(Debug, Default)]
pub(super) struct ImuTurns {
    last: Option<Time>,
    begin: Option<Time>,
    turn: Vector3,
    pub turns: Vec<(Time, Time, Vector3)>,
}

impl ImuTurns {
    /// Takes a sample.
    pub fn add(&mut self, imu: &Imu) {
        let (time, rate) = (imu.header.stamp, Vector3::from(imu.angular_velocity));
        let Some(last) = self.last.replace(time) else { return };
        let seconds = time.seconds_since(last);
        if !(0.0..0.5).contains(&seconds) || !rate.iter().all(|v| v.is_finite()) {
            (self.begin, self.turn) = (None, Vector3::zeros());
            return;
        }
        let begin = *self.begin.get_or_insert(last);
        self.turn += rate * seconds;
        if time.seconds_since(begin) >= TURN_INTERVAL && self.turns.len() < MAX_TURNS {
            self.turns.push((begin, time, self.turn));
            (self.begin, self.turn) = (None, Vector3::zeros());
        }
    }
}

impl ImuTurns {
    /// Rotations about one direction in the frame of the IMU.
    pub fn about(&self, axis: &Vector3) -> Vec<Turn> {
        self.turns.iter().map(|(from, to, turn)| (*from, *to, turn.dot(axis))).collect()
    }
}

/// Source of rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Source {
    Odometry,
    Imu,
    Scan,
    /// `has_times`: whether points have times.
    Cloud {
        has_times: bool,
    },
}

impl Source {
    /// Whether the times of rotations are accurate to a few milliseconds.
    fn is_exact(self) -> bool {
        matches!(self, Self::Imu | Self::Odometry | Self::Cloud { has_times: true })
    }
}

/// Rotations of one sensor about the vertical.
pub(super) struct Turning<'a> {
    pub source: Source,
    pub topic: &'a str,
    pub turns: Vec<Turn>,
}

/// Compares all sensors with odometry, or with the IMU if there is no odometry; `imus` also have their axes.
/// Clocks are compared with that of the first IMU, if there is one: wheels slip, and their counts are
/// coarse. Sensors whose `offsets` are already known are not compared.
pub(super) fn compare_all(
    mut all: Vec<Turning>,
    imus: &[(&str, &ImuTurns)],
    offsets: &[ClockOffset],
    findings: &mut Findings,
) {
    all.sort_by_key(|turning| turning.source);
    let Some((first, others)) = all.split_first() else { return };
    let imu = all.iter().position(|turning| turning.source == Source::Imu);
    let clock = &all[imu.unwrap_or(0)];
    for other in others {
        let other_axis = [first, other].into_iter().find_map(|turning| {
            let (topic, imu) = imus.iter().find(|(topic, _)| *topic == turning.topic)?;
            let reference = if std::ptr::eq(turning, first) { other } else { first };
            report_axis(topic, imu, &turning.turns, reference, findings)
        });
        if other_axis.is_none() {
            rotation::report_turns((first.topic, &first.turns), (other.topic, &other.turns), findings);
            // The IMU itself is compared with the first sensor.
            let reference = if std::ptr::eq(clock, other) { first } else { clock };
            let is_exact = reference.source.is_exact() && other.source.is_exact();
            let (a, b) = ((reference.topic, &*reference.turns), (other.topic, &*other.turns));
            if !offsets.iter().any(|known| (&*known.imu, &*known.lidar) == (a.0, b.0)) {
                rotation::report_clocks(a, b, is_exact, findings);
            }
        }
    }
}

/// Reports the axis about which an IMU measures the rotations of another sensor, if it is not the vertical
/// from gravity.
fn report_axis(
    topic: &str,
    imu: &ImuTurns,
    about_up: &[Turn],
    reference: &Turning,
    findings: &mut Findings,
) -> Option<()> {
    let agreement = compare(&reference.turns, about_up)?;
    if agreement.turned < ENOUGH_TURNS || agreement.correlation > DISAGREES {
        return None;
    }
    let directions = [Vector3::x(), Vector3::y(), Vector3::z()];
    let correlation =
        |axis: &Vector3| compare(&reference.turns, &imu.about(axis)).map_or(0.0, |a| a.correlation);
    let found = directions.into_iter().map(|axis| (correlation(&axis), axis));
    let (best, axis) = found.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
    if best.abs() < AGREES {
        return None;
    }
    let (name, sign) = axis_of(&(axis * best));
    findings.add(&AXES, topic, || {
        format!(
            "rotation of {} about the vertical is seen by the gyroscope about {sign}{name} (correlation {:.2}), not about the vertical that gravity shows ({:.2})",
            reference.topic,
            best.abs(),
            agreement.correlation
        )
    });
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::findings_to_text;
    use crate::rotation::tests::{at, heading, turns};

    #[test]
    fn gyroscopes_whose_axes_are_swapped_are_found() {
        let mut imu = ImuTurns::default();
        for i in 0..5000 {
            let t = 0.02 * f64::from(i);
            // Left turns are measured as right turns about y.
            imu.turns.push((at(t), at(t + 0.02), Vector3::new(0.0, heading(t) - heading(t + 0.02), 1e-4)));
        }
        let cloud = Turning {
            source: Source::Cloud { has_times: true },
            topic: "/points",
            turns: turns(0.0, 1.0, 0.1),
        };
        let about_up = Turning { source: Source::Imu, topic: "/imu", turns: imu.about(&Vector3::z()) };
        let mut findings = Findings::default();
        compare_all(vec![cloud, about_up], &[("/imu", &imu)], &[], &mut findings);
        let text = findings_to_text(&findings.finish());
        assert!(
            text.contains("/imu: rotation of /points about the vertical") && text.contains("about -y"),
            "{text}"
        );
    }
}
