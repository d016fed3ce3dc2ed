//! First pass over a CARMEN log: its content, its times, and the mounting of its scanners.

use std::collections::BTreeMap;
use std::ops::Range;

use portolan_geometry::{Time, normalize_angle};

use super::line::{LaserKind, Line, LineTimes, Pose2d, parse_line};
use super::{CarmenOptions, TimeColumn};
use crate::text::{Lines, TextFile};
use crate::{RecordingError, StampPattern};

/// Times below this (March 1973), seconds, do not count from 1970 but from the start of some computer or
/// program.
const SHORTEST_UNIX_SECONDS: f64 = 1e8;
/// Offset that is added to those times, seconds.
const SHIFT_SECONDS: f64 = 1e9;
/// Range of valid stamps, seconds since 1970 or since some start. ROS cannot represent others.
const POSSIBLE_SECONDS: Range<f64> = 0.0..4_294_967_296.0;
/// Maximum number of stamps of each scanner that are examined.
const MAX_STAMPS: usize = 1_000_000;
/// Number of stamps that are examined together.
const PIECE: usize = 200;
/// Maximum number of parameters that are kept.
const MAX_PARAMS: usize = 20_000;
/// Variation of a mounting that counts as rounding (metres, radians).
const MOUNTING_TOLERANCE: (f64, f64) = (0.01, 0.01);

/// Which column of the log the stamps come from, and how they are converted to times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Clock {
    column: TimeColumn,
    shifted: bool,
}

impl Clock {
    /// The stamp of a line.
    ///
    /// Unix times are read exactly. Times that count from a start are shifted by 1,000,000,000 s, with the
    /// sum in double precision converted to nanoseconds. ROS recordings made from such logs have the same
    /// stamps, so both forms give the same map, byte for byte. None if the time is not valid.
    pub fn stamp(self, times: LineTimes) -> Option<Time> {
        let text = match self.column {
            TimeColumn::Ipc => times.ipc,
            TimeColumn::Logger => times.logger?,
        };
        let seconds = possible_seconds(text)?;
        if !self.shifted {
            return Time::from_unix_decimal(text);
        }
        Some(Time::from_unix_nanoseconds(((SHIFT_SECONDS + seconds) * 1e9) as i64))
    }
}

/// The time in a line, if it is valid.
fn possible_seconds(text: &str) -> Option<f64> {
    text.parse().ok().filter(|seconds| POSSIBLE_SECONDS.contains(seconds))
}

/// Pose of the laser on the robot, from the poses of both in the log.
#[derive(Clone, Debug, Default)]
struct Mounting {
    first: Pose2d,
    sum: Pose2d,
    count: u64,
    constant: bool,
}

impl Mounting {
    fn add(&mut self, laser: Pose2d, robot: Pose2d) {
        let (sin, cos) = robot[2].sin_cos();
        let (dx, dy) = (laser[0] - robot[0], laser[1] - robot[1]);
        let relative = [cos * dx + sin * dy, cos * dy - sin * dx, normalize_angle(laser[2] - robot[2])];
        if self.count == 0 {
            (self.first, self.constant) = (relative, true);
        }
        let difference = [
            relative[0] - self.first[0],
            relative[1] - self.first[1],
            normalize_angle(relative[2] - self.first[2]),
        ];
        self.constant &= difference[0].hypot(difference[1]) < MOUNTING_TOLERANCE.0
            && difference[2].abs() < MOUNTING_TOLERANCE.1;
        for (sum, d) in self.sum.iter_mut().zip(difference) {
            *sum += d;
        }
        self.count += 1;
    }

    /// The mounting, rounded to 0.1 mm, if it is constant. In corrected logs it is not, because the laser
    /// pose there is the result of a mapping program.
    fn constant(&self) -> Option<Pose2d> {
        let mean = |first: f64, sum: f64| first + sum / self.count as f64;
        let round = |v: f64, step: f64| (v / step).round() * step;
        let ([x, y, heading], [dx, dy, turn]) = (self.first, self.sum);
        (self.constant && self.count > 0).then(|| {
            let heading = normalize_angle(round(mean(heading, turn), 1e-5));
            [round(mean(x, dx), 1e-4), round(mean(y, dy), 1e-4), heading]
        })
    }
}

#[derive(Clone, Debug, Default)]
struct LaserSurvey {
    count: u64,
    mounting: Mounting,
    /// Seconds as in the log: column ipc, column logger.
    stamps: [Vec<f64>; 2],
}

impl LaserSurvey {
    fn add_times(&mut self, times: LineTimes) {
        for (stamps, text) in self.stamps.iter_mut().zip([Some(times.ipc), times.logger]) {
            let seconds = text.and_then(possible_seconds);
            stamps.extend(seconds.filter(|_| self.count <= MAX_STAMPS as u64));
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct TimeSpan {
    range: Option<(f64, f64)>,
    small: u64,
    large: u64,
}

impl TimeSpan {
    fn add(&mut self, text: &str) {
        let Some(time) = possible_seconds(text) else { return };
        self.range = Some(self.range.map_or((time, time), |(a, b)| (a.min(time), b.max(time))));
        *(if time < SHORTEST_UNIX_SECONDS { &mut self.small } else { &mut self.large }) += 1;
    }

    fn length(&self) -> f64 {
        self.range.map_or(0.0, |(first, last)| last - first)
    }
}

/// Content of the whole log.
#[derive(Clone, Debug, Default)]
pub(crate) struct Survey {
    pub odometry_lines: u64,
    pub params: BTreeMap<String, String>,
    lasers: BTreeMap<LaserKind, LaserSurvey>,
    ipc: TimeSpan,
    logger: TimeSpan,
}

impl Survey {
    /// Reads the log once, without the ranges.
    pub fn of(file: &TextFile) -> Result<Self, RecordingError> {
        let mut survey = Self::default();
        let mut lines: Lines = file.lines()?;
        while let Some(line) = lines.next_line()? {
            match parse_line(line, false) {
                Line::Param { name, value } if survey.params.len() < MAX_PARAMS => {
                    survey.params.insert(name.to_owned(), value.to_owned());
                }
                Line::Odometry { times, .. } => {
                    survey.odometry_lines += 1;
                    survey.add_times(times);
                }
                Line::Laser { laser, times } => {
                    let entry = survey.lasers.entry(laser.kind).or_default();
                    entry.count += 1;
                    if let Some((laser_pose, robot_pose)) = laser.poses {
                        entry.mounting.add(laser_pose, robot_pose);
                    }
                    entry.add_times(times);
                    survey.add_times(times);
                }
                _ => {}
            }
        }
        Ok(survey)
    }

    fn add_times(&mut self, times: LineTimes) {
        self.ipc.add(times.ipc);
        if let Some(text) = times.logger {
            self.logger.add(text);
        }
    }

    /// Whether there is neither a scan nor odometry, with any time.
    pub fn is_empty(&self) -> bool {
        self.odometry_lines == 0 && self.lasers.is_empty()
    }

    /// Number of scans of one kind.
    pub fn scans(&self, kind: LaserKind) -> u64 {
        self.lasers.get(&kind).map_or(0, |l| l.count)
    }

    /// All kinds of scans in the log.
    pub fn kinds(&self) -> impl Iterator<Item = LaserKind> {
        self.lasers.keys().copied()
    }

    /// The clock to use: the requested column, unless its time never changes.
    pub fn clock(&self, options: &CarmenOptions) -> Clock {
        let (chosen, other, other_column) = match options.time_column {
            TimeColumn::Ipc => (&self.ipc, &self.logger, TimeColumn::Logger),
            TimeColumn::Logger => (&self.logger, &self.ipc, TimeColumn::Ipc),
        };
        if chosen.length() <= 0.0 && other.length() > 0.0 {
            return Clock { column: other_column, shifted: other.small > other.large };
        }
        Clock { column: options.time_column, shifted: chosen.small > chosen.large }
    }

    /// Whether the stamps of a scanner come in bursts or go back, so that the order of the lines is more
    /// reliable than the stamps.
    pub fn has_disturbed_stamps(&self, clock: Clock) -> bool {
        let is_disturbed = |stamps: &[f64]| {
            let stamps: Vec<Time> = stamps.iter().map(|s| Time::from_unix_seconds(*s)).collect();
            StampPattern::of(&stamps).is_some_and(|pattern| pattern.is_disturbed())
        };
        self.lasers.values().any(|laser| {
            let [ipc, logger] = &laser.stamps;
            let stamps = match clock.column {
                TimeColumn::Ipc => ipc,
                TimeColumn::Logger => logger,
            };
            stamps.chunks(PIECE).any(is_disturbed)
        })
    }

    /// First and last stamp.
    pub fn time_range(&self, clock: Clock) -> Option<(Time, Time)> {
        let span = match clock.column {
            TimeColumn::Ipc => &self.ipc,
            TimeColumn::Logger => &self.logger,
        };
        let stamp = |seconds: f64| {
            let text = format!("{seconds}");
            clock.stamp(LineTimes { ipc: &text, logger: Some(&text) })
        };
        let (first, last) = span.range?;
        Some((stamp(first)?, stamp(last)?))
    }

    /// Pose of the scanner on the robot: from the poses in the log if it is constant, else (in corrected
    /// logs) from the parameters, else the origin of the robot.
    pub fn mounting(&self, kind: LaserKind) -> Option<Pose2d> {
        let (parameter, heading) = match kind {
            LaserKind::Front | LaserKind::Robot(1) => ("robot_frontlaser_offset", 0.0),
            LaserKind::Rear | LaserKind::Robot(2) => ("robot_rearlaser_offset", std::f64::consts::PI),
            LaserKind::Robot(_) | LaserKind::Raw(_) => ("", 0.0),
        };
        let declared = self.number(parameter).map(|offset| [offset, 0.0, heading]);
        let seen = self.lasers.get(&kind).and_then(|l| l.mounting.constant());
        match (seen, declared) {
            (Some(seen), Some(declared)) if agree(seen, declared) => Some(declared),
            (Some(seen), _) => Some(seen),
            (None, Some(declared)) => Some(declared),
            (None, None) if matches!(kind, LaserKind::Raw(_)) => None,
            (None, None) => Some([0.0, 0.0, heading]),
        }
    }

    /// A parameter as a finite number.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.params.get(name)?.parse().ok().filter(|v: &f64| v.is_finite())
    }
}

fn agree(a: Pose2d, b: Pose2d) -> bool {
    (a[0] - b[0]).hypot(a[1] - b[1]) < MOUNTING_TOLERANCE.0
        && normalize_angle(a[2] - b[2]).abs() < MOUNTING_TOLERANCE.1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn survey(text: &str) -> Survey {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.log");
        std::fs::write(&path, text).unwrap();
        Survey::of(&TextFile::open(&path).unwrap()).unwrap()
    }

    #[test]
    fn the_mounting_comes_from_poses_or_parameters_if_any() {
        let scan = |laser: &str, robot: &str, t: u32| format!("FLASER 1 1.0 {laser} {robot} {t}.0 h {t}.0\n");
        let steady = scan("0.3 0 0", "0.1 0 0", 1) + &scan("1.0 1.2 1.570796", "1.0 1.0 1.570796", 2);
        let mounting = survey(&steady).mounting(LaserKind::Front).unwrap();
        assert!((mounting[0] - 0.2).abs() < 1e-9 && mounting[1].abs() < 1e-9 && mounting[2].abs() < 1e-9);
        let corrected = scan("0.3 0 0", "0.1 0 0", 1) + &scan("3.0 0 0", "1.0 1.0 0", 2);
        assert_eq!(survey(&corrected).mounting(LaserKind::Front), Some([0.0; 3]));
        let declared = "PARAM robot_frontlaser_offset 0.15 h 0\n".to_owned() + &corrected;
        assert_eq!(survey(&declared).mounting(LaserKind::Front), Some([0.15, 0.0, 0.0]));
        assert_eq!(survey("").mounting(LaserKind::Raw(1)), None);
    }

    #[test]
    fn unix_times_are_exact_and_others_are_shifted() {
        let odom = |t: &str| format!("ODOM 0 0 0 0 0 0 {t} h 0.5\nODOM 0 0 0 0 0 0 {t}9 h 0.6\n");
        let unix = survey(&odom("1071078718.4623101"));
        let clock = unix.clock(&CarmenOptions::default());
        assert_eq!(unix.time_range(clock).unwrap().0.unix_decimal(), "1071078718.4623101");
        let boot = survey(&odom("70.179699"));
        let clock = boot.clock(&CarmenOptions::default());
        let stamp = clock.stamp(LineTimes { ipc: "70.179699", logger: None }).unwrap();
        assert_eq!(stamp, Time::from_ros(1_000_000_070, 179_698_944));
    }

    #[test]
    fn a_column_that_stands_still_is_not_used() {
        let text = "ODOM 0 0 0 0 0 0 0 h 0.5\nODOM 0 0 0 0 0 0 0 h 0.6\n";
        let log = survey(text);
        let clock = log.clock(&CarmenOptions::default());
        assert_eq!(clock.column, TimeColumn::Logger);
        assert!(log.time_range(clock).unwrap().0 < log.time_range(clock).unwrap().1);
    }
}
