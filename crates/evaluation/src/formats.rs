//! Trajectories as text files.

mod csv;
mod geojson;
mod kitti;
mod lines;
mod tum;

pub use csv::{read_csv, write_csv, write_csv_all};
pub use geojson::{read_geojson, write_geojson};
pub use kitti::{kitti_trajectory, read_kitti_poses, read_kitti_times, write_kitti};
pub use tum::{read_tum, write_tum};

pub(crate) use lines::{Lines, bad_line};

use portolan_geometry::{Quaternion, Rigid3, Time, nalgebra as na};

use portolan_input::quoted;

use crate::EvaluationError;
use crate::trajectory::TrajectoryRepairs;

/// Limit beyond which a number cannot be a time in seconds.
const MAX_SECONDS: f64 = 1e11;

/// A time in seconds, exact to 100 ns.
pub(crate) fn parse_time(text: &str, line: usize) -> Result<Time, EvaluationError> {
    let time = Time::from_unix_decimal(text)
        .ok_or_else(|| bad_line(line, format!("{} is not a time in seconds", quoted(text))))?;
    if time.unix_seconds().abs() > MAX_SECONDS {
        let reason =
            format!("{} s is too far away: are these nanoseconds? Times are in seconds", quoted(text));
        return Err(bad_line(line, reason));
    }
    Ok(time)
}

pub(crate) fn parse_number(text: &str, line: usize) -> Result<f64, EvaluationError> {
    text.parse().map_err(|_| bad_line(line, format!("{} is not a number", quoted(text))))
}

/// A pose from translation and quaternion, which is normalised whatever its length. If it cannot be
/// normalised or a value is not finite, the pose is counted as invalid and `None` is returned.
fn pose_of(translation: [f64; 3], xyzw: [f64; 4], repairs: &mut TrajectoryRepairs) -> Option<Rigid3> {
    let [x, y, z, w] = xyzw;
    let q = na::Quaternion::new(w, x, y, z);
    let norm = q.norm();
    if !translation.iter().all(|t| t.is_finite()) || !norm.is_finite() || norm < 1e-6 {
        repairs.invalid_poses += 1;
        return None;
    }
    repairs.renormalized_quaternions += usize::from((norm - 1.0).abs() > 1e-3);
    Some(Rigid3::from_parts(na::Translation3::from(translation), Quaternion::new_normalize(q)))
}

/// Sum of the counts of two steps.
fn both(a: TrajectoryRepairs, b: TrajectoryRepairs) -> TrajectoryRepairs {
    TrajectoryRepairs {
        unsorted: a.unsorted + b.unsorted,
        duplicate_stamps: a.duplicate_stamps + b.duplicate_stamps,
        invalid_poses: a.invalid_poses + b.invalid_poses,
        renormalized_quaternions: a.renormalized_quaternions + b.renormalized_quaternions,
    }
}

#[cfg(test)]
mod tests;
