//! Trajectories as comma-separated tables with a line of names.

use std::io::{BufRead, Write};

use portolan_geometry::{rotation_from_roll_pitch_yaw, yaw};

use super::{Lines, bad_line, both, parse_number, parse_time, pose_of};
use crate::EvaluationError;
use crate::trajectory::{TimedPose, Trajectory, TrajectoryRepairs};

/// Names by which each column is known, in the order of [`Columns`].
const NAMES: [&[&str]; 11] = [
    &["time", "timestamp", "stamp", "t", "ipc_timestamp"],
    &["x"],
    &["y"],
    &["z"],
    &["qx"],
    &["qy"],
    &["qz"],
    &["qw"],
    &["roll"],
    &["pitch"],
    &["yaw", "theta"],
];

/// The position of each column.
struct Columns([Option<usize>; 11]);

impl Columns {
    /// Parses a line of names; `None` if it is not one. Text in brackets after a name is ignored.
    fn parse(line: &str) -> Option<Self> {
        let mut columns = [None; 11];
        for (index, field) in line.trim_start_matches(['#', ' ']).split(',').enumerate() {
            let name = field.split(['(', '[']).next().unwrap_or_default().trim().to_ascii_lowercase();
            let known = NAMES.iter().position(|names| names.contains(&name.as_str()));
            // If a name occurs twice, the first column is used.
            if let Some(column) = known.and_then(|k| columns.get_mut(k)).filter(|c| c.is_none()) {
                *column = Some(index);
            }
        }
        let [time, x, y, ..] = columns;
        (time.is_some() && x.is_some() && y.is_some()).then_some(Self(columns))
    }

    fn number(&self, column: usize, fields: &[&str], line: usize) -> Result<f64, EvaluationError> {
        let Some(index) = self.0.get(column).copied().flatten() else { return Ok(0.0) };
        let missing = || bad_line(line, format!("there is no column {}", index + 1));
        parse_number(fields.get(index).ok_or_else(missing)?, line)
    }

    fn has_quaternion(&self) -> bool {
        self.0.iter().skip(4).take(4).all(Option::is_some)
    }
}

/// Reads a table whose first line names its columns: `time` (Unix seconds), `x`, `y`, optionally `z`
/// (metres), and `qx`, `qy`, `qz`, `qw` or `roll`, `pitch`, `yaw` (or `theta`; radians). Columns may be in
/// any order; others are ignored; the first line may begin with `#`.
///
/// # Errors
/// If reading fails, or a line is not what the format asks for.
pub fn read_csv(reader: impl BufRead) -> Result<(Trajectory, TrajectoryRepairs), EvaluationError> {
    let mut lines = Lines::new(reader);
    let columns = loop {
        let Some((number, line)) = lines.next_line()? else {
            return Err(bad_line(1, "no line of names: expected time,x,y,z,qx,qy,qz,qw"));
        };
        match Columns::parse(line) {
            Some(columns) => break columns,
            None if line.is_empty() || line.starts_with('#') => {}
            None => {
                return Err(bad_line(number, "not a line of names: expected time,x,y,z,qx,qy,qz,qw"));
            }
        }
    };
    let mut repairs = TrajectoryRepairs::default();
    let mut poses = Vec::new();
    while let Some((number, line)) = lines.next_data()? {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let time = columns.0.first().copied().flatten().and_then(|i| fields.get(i)).copied();
        let time = parse_time(time.unwrap_or_default(), number)?;
        let value = |column| columns.number(column, &fields, number);
        let translation = [value(1)?, value(2)?, value(3)?];
        let xyzw = if columns.has_quaternion() {
            [value(4)?, value(5)?, value(6)?, value(7)?]
        } else {
            let q = rotation_from_roll_pitch_yaw(value(8)?, value(9)?, value(10)?);
            [q.i, q.j, q.k, q.w]
        };
        if let Some(map_from_tracking) = pose_of(translation, xyzw, &mut repairs) {
            poses.push(TimedPose { time, map_from_tracking });
        }
    }
    let (trajectory, disorder) = Trajectory::new(poses);
    Ok((trajectory, both(repairs, disorder)))
}

/// Writes a table `time,x,y,z,qx,qy,qz,qw,yaw`.
///
/// # Errors
/// If writing fails.
pub fn write_csv(trajectory: &Trajectory, mut writer: impl Write) -> std::io::Result<()> {
    writeln!(writer, "time,x,y,z,qx,qy,qz,qw,yaw")?;
    trajectory.poses().iter().try_for_each(|pose| writeln!(writer, "{}", row(pose)))
}

/// Writes several trajectories with their numbers: a table `time,x,y,z,qx,qy,qz,qw,yaw,trajectory_id`.
///
/// # Errors
/// If writing fails.
pub fn write_csv_all(trajectories: &[(i32, Trajectory)], mut writer: impl Write) -> std::io::Result<()> {
    writeln!(writer, "time,x,y,z,qx,qy,qz,qw,yaw,trajectory_id")?;
    for (id, trajectory) in trajectories {
        trajectory.poses().iter().try_for_each(|pose| writeln!(writer, "{},{id}", row(pose)))?;
    }
    Ok(())
}

fn row(pose: &TimedPose) -> String {
    let t = pose.map_from_tracking.translation;
    let [x, y, z, w] = crate::quaternion_xyzw(&pose.map_from_tracking);
    format!(
        "{},{:.6},{:.6},{:.6},{x:.9},{y:.9},{z:.9},{w:.9},{:.9}",
        pose.time.unix_decimal(),
        t.x,
        t.y,
        t.z,
        yaw(&pose.map_from_tracking.rotation)
    )
}
