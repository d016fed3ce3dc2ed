//! TUM trajectories: `time x y z qx qy qz qw` per line, Unix seconds and metres.

use std::io::{BufRead, Write};

use super::{Lines, bad_line, both, parse_number, parse_time, pose_of};
use crate::EvaluationError;
use crate::trajectory::{TimedPose, Trajectory, TrajectoryRepairs};

/// Reads a TUM trajectory. Blank lines and comments are skipped. Poses out of order are sorted and counted. A
/// line of anything but eight numbers is an error.
///
/// # Errors
/// If reading fails, or a line is not what the format asks for.
pub fn read_tum(reader: impl BufRead) -> Result<(Trajectory, TrajectoryRepairs), EvaluationError> {
    let mut lines = Lines::new(reader);
    let mut repairs = TrajectoryRepairs::default();
    let mut poses = Vec::new();
    while let Some((number, line)) = lines.next_data()? {
        let mut fields = line.split_ascii_whitespace();
        let time = parse_time(fields.next().unwrap_or_default(), number)?;
        let mut values = [0.0; 7];
        for value in &mut values {
            let expected = || bad_line(number, "too few numbers: expected time x y z qx qy qz qw");
            *value = parse_number(fields.next().ok_or_else(expected)?, number)?;
        }
        if fields.next().is_some() {
            return Err(bad_line(number, "too many numbers: expected time x y z qx qy qz qw"));
        }
        let [x, y, z, qx, qy, qz, qw] = values;
        if let Some(map_from_tracking) = pose_of([x, y, z], [qx, qy, qz, qw], &mut repairs) {
            poses.push(TimedPose { time, map_from_tracking });
        }
    }
    if 2 * repairs.renormalized_quaternions > poses.len() {
        return Err(EvaluationError::NoQuaternions { count: repairs.renormalized_quaternions });
    }
    let (trajectory, disorder) = Trajectory::new(poses);
    Ok((trajectory, both(repairs, disorder)))
}

/// Writes a TUM trajectory: exact times, micrometres, nine digits of the quaternion with w ≥ 0.
///
/// # Errors
/// If writing fails.
pub fn write_tum(trajectory: &Trajectory, mut writer: impl Write) -> std::io::Result<()> {
    for pose in trajectory.poses() {
        let t = pose.map_from_tracking.translation;
        let [x, y, z, w] = crate::quaternion_xyzw(&pose.map_from_tracking);
        writeln!(
            writer,
            "{} {:.6} {:.6} {:.6} {x:.9} {y:.9} {z:.9} {w:.9}",
            pose.time.unix_decimal(),
            t.x,
            t.y,
            t.z
        )?;
    }
    Ok(())
}
