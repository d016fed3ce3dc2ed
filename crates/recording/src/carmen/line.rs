//! Parses the lines of a CARMEN log.
//!
//! One message per line: `name contents… ipc_time host logger_time`.
//!
//! ```text
//! PARAM name value
//! ODOM x y theta tv rv accel
//! FLASER n ranges… laser_x laser_y laser_theta odom_x odom_y odom_theta      (RLASER alike)
//! RAWLASERi type start_angle field_of_view resolution max_range accuracy remission_mode
//!           n ranges… m remissions…
//! ROBOTLASERi as RAWLASERi, then laser pose, robot pose, laser_tv laser_rv
//!           forward_safety side_safety turn_axis
//! ```
//! Older `ROBOTLASER` lines have no remissions.

use std::str::SplitAsciiWhitespace;

/// The scanner that a line comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum LaserKind {
    /// `FLASER`: the front scanner, geometry not given.
    Front,
    /// `RLASER`: the rear scanner, geometry not given.
    Rear,
    /// `ROBOTLASER1` (front), `ROBOTLASER2` (rear), …
    Robot(u8),
    /// `RAWLASER1` …: without poses.
    Raw(u8),
}

/// The configuration of a scanner as its lines give it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LaserConfig {
    /// Radians.
    pub start_angle: f64,
    /// Radians.
    pub field_of_view: f64,
    /// Radians between beams.
    pub resolution: f64,
    /// Metres; readings at or above it are not returns.
    pub maximum_range: f64,
}

/// x, y (metres) and heading (radians).
pub(crate) type Pose2d = [f64; 3];

/// A scan.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LaserLine {
    pub kind: LaserKind,
    pub config: Option<LaserConfig>,
    /// Number of readings; `ranges` is empty if they were not requested.
    pub count: usize,
    pub ranges: Vec<f32>,
    pub remissions: Vec<f32>,
    /// Poses of the laser and of the robot, both in the frame of the odometry.
    pub poses: Option<(Pose2d, Pose2d)>,
}

/// The times of a line, as text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LineTimes<'a> {
    /// When the message was sent.
    pub ipc: &'a str,
    /// Seconds since the start of the log.
    pub logger: Option<&'a str>,
}

/// The content of a line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Line<'a> {
    /// Empty or a comment.
    Empty,
    /// A parameter of the robot.
    Param { name: &'a str, value: &'a str },
    /// Pose of the robot from its wheel odometry.
    Odometry { pose: Pose2d, times: LineTimes<'a> },
    /// A scan.
    Laser { laser: LaserLine, times: LineTimes<'a> },
    /// A kind of message that mapping does not need.
    Unused(&'a str),
    /// Not parsable.
    Bad,
}

/// Parses one line. Ranges are only converted if `with_ranges`.
pub(crate) fn parse_line(line: &[u8], with_ranges: bool) -> Line<'_> {
    let Ok(text) = std::str::from_utf8(line) else { return Line::Bad };
    let mut tokens = text.split_ascii_whitespace();
    let Some(name) = tokens.next() else { return Line::Empty };
    if name.starts_with('#') {
        return Line::Empty;
    }
    let parsed = match name {
        "PARAM" => parse_param(tokens),
        "ODOM" => parse_odometry(tokens),
        "FLASER" => parse_old_laser(LaserKind::Front, tokens, with_ranges),
        "RLASER" => parse_old_laser(LaserKind::Rear, tokens, with_ranges),
        _ => match numbered(name) {
            Some(kind) => parse_laser(kind, tokens, with_ranges),
            None if is_message_name(name) => Some(Line::Unused(name)),
            None => None,
        },
    };
    parsed.unwrap_or(Line::Bad)
}

fn is_message_name(name: &str) -> bool {
    name.len() <= 40
        && name.starts_with(|c: char| c.is_ascii_uppercase())
        && name.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || b"_-$".contains(&b))
}

fn numbered(name: &str) -> Option<LaserKind> {
    let number = |prefix: &str| name.strip_prefix(prefix)?.parse::<u8>().ok();
    number("ROBOTLASER").map(LaserKind::Robot).or_else(|| number("RAWLASER").map(LaserKind::Raw))
}

fn parse_param<'a>(mut tokens: SplitAsciiWhitespace<'a>) -> Option<Line<'a>> {
    Some(Line::Param { name: tokens.next()?, value: tokens.next().unwrap_or("") })
}

fn parse_odometry<'a>(mut tokens: SplitAsciiWhitespace<'a>) -> Option<Line<'a>> {
    let pose = numbers(&mut tokens)?;
    let _velocities: [f64; 3] = numbers(&mut tokens)?;
    Some(Line::Odometry { pose, times: parse_times(tokens)? })
}

fn parse_old_laser<'a>(
    kind: LaserKind,
    mut tokens: SplitAsciiWhitespace<'a>,
    with_ranges: bool,
) -> Option<Line<'a>> {
    let (count, ranges) = readings(&mut tokens, with_ranges)?;
    let poses = Some((numbers(&mut tokens)?, numbers(&mut tokens)?));
    let laser = LaserLine { kind, config: None, count, ranges, remissions: Vec::new(), poses };
    Some(Line::Laser { laser, times: parse_times(tokens)? })
}

fn parse_laser<'a>(
    kind: LaserKind,
    mut tokens: SplitAsciiWhitespace<'a>,
    with_ranges: bool,
) -> Option<Line<'a>> {
    let [_type, start_angle, field_of_view, resolution, maximum_range, _accuracy, _remission_mode] =
        numbers(&mut tokens)?;
    let config = LaserConfig { start_angle, field_of_view, resolution, maximum_range };
    let (count, ranges) = readings(&mut tokens, with_ranges)?;
    // Poses (6), velocities and safety distances (5), times (3).
    let tail = if matches!(kind, LaserKind::Robot(_)) { 14 } else { 3 };
    let mut remissions = Vec::new();
    if tokens.clone().count() > tail {
        remissions = readings(&mut tokens, with_ranges)?.1;
    }
    let mut poses = None;
    if matches!(kind, LaserKind::Robot(_)) {
        poses = Some((numbers(&mut tokens)?, numbers(&mut tokens)?));
        let _safety: [f64; 5] = numbers(&mut tokens)?;
    }
    let laser = LaserLine { kind, config: Some(config), count, ranges, remissions, poses };
    Some(Line::Laser { laser, times: parse_times(tokens)? })
}

/// Parses a count and that number of readings.
fn readings(tokens: &mut SplitAsciiWhitespace, with_values: bool) -> Option<(usize, Vec<f32>)> {
    let count: usize = tokens.next()?.parse().ok()?;
    let mut values = Vec::new();
    for _ in 0..count {
        let token = tokens.next()?;
        if with_values {
            values.push(token.parse().ok()?);
        }
    }
    Some((count, values))
}

fn numbers<const N: usize>(tokens: &mut SplitAsciiWhitespace) -> Option<[f64; N]> {
    let mut values = [0.0f64; N];
    for value in &mut values {
        *value = tokens.next()?.parse().ok()?;
        if !value.is_finite() {
            return None;
        }
    }
    Some(values)
}

fn parse_times<'a>(mut tokens: SplitAsciiWhitespace<'a>) -> Option<LineTimes<'a>> {
    let ipc = tokens.next()?;
    let _host = tokens.next();
    Some(LineTimes { ipc, logger: tokens.next() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_front_scan_and_its_odometry() {
        let line = b"FLASER 3 1.5 2 81.91 0.1 0.2 0.3 0.4 0.5 0.6 1211.520329 magnum 0.015885";
        let Line::Laser { laser, times } = parse_line(line, true) else { panic!() };
        assert_eq!((laser.kind, laser.count), (LaserKind::Front, 3));
        assert_eq!(laser.ranges, [1.5, 2.0, 81.91]);
        assert_eq!(laser.poses, Some(([0.1, 0.2, 0.3], [0.4, 0.5, 0.6])));
        assert_eq!(times, LineTimes { ipc: "1211.520329", logger: Some("0.015885") });
        let Line::Laser { laser, .. } = parse_line(line, false) else { panic!() };
        assert_eq!((laser.count, laser.ranges.len()), (3, 0));
    }

    #[test]
    fn the_newer_format_with_and_without_remissions() {
        let head = "ROBOTLASER1 4 -1.57 3.14 0.0175 81.9 0.01 0 2 1.0 2.0";
        let tail = "1 2 0.5 1.1 2 0.5 0.3 0 0.1 0.2 10000000000 5.25 host 0.5";
        for (remissions, expected) in [("", vec![]), (" 0", vec![]), (" 2 17 18", vec![17.0, 18.0])] {
            let line = format!("{head}{remissions} {tail}");
            let Line::Laser { laser, times } = parse_line(line.as_bytes(), true) else { panic!("{line}") };
            assert_eq!(laser.kind, LaserKind::Robot(1));
            assert_eq!(laser.ranges, [1.0, 2.0]);
            assert_eq!(laser.remissions, expected);
            assert_eq!(laser.poses, Some(([1.0, 2.0, 0.5], [1.1, 2.0, 0.5])));
            assert_eq!(laser.config.unwrap().maximum_range, 81.9);
            assert_eq!(times.ipc, "5.25");
        }
        let raw = b"RAWLASER2 4 -1.57 3.14 0.0175 81.9 0.01 0 2 1.0 2.0 0 5.25 host 0.5";
        assert!(matches!(parse_line(raw, true), Line::Laser { laser, .. } if laser.poses.is_none()));
    }

    #[test]
    fn invalid_lines_are_bad_and_other_messages_are_not_used() {
        for line in [
            &b"FLASER 180 1.0 2.0"[..],
            b"FLASER -3 1.0",
            b"FLASER 99999999999999999999 1.0",
            b"FLASER 18446744073709551615 1.0",
            b"ODOM 1 2 nan 0 0 0 5.0 host 1.0",
            b"ODOM 1 2",
            b"hello world",
            b"\xff\xfe",
        ] {
            assert_eq!(parse_line(line, true), Line::Bad, "{line:?}");
        }
        assert_eq!(parse_line(b"TRUEPOS 1 2 3 4 5 6 7 h 8", true), Line::Unused("TRUEPOS"));
        assert_eq!(parse_line(b"# comment", true), Line::Empty);
        assert_eq!(parse_line(b"  ", true), Line::Empty);
        assert_eq!(parse_line(b"PARAM a b", true), Line::Param { name: "a", value: "b" });
    }
}
