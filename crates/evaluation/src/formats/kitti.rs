//! KITTI odometry poses: the first three rows of a 4×4 matrix per line, times in a file of their own.

use std::io::{BufRead, Write};

use portolan_geometry::{Quaternion, Rigid3, Time, nalgebra as na};

use super::{Lines, bad_line, parse_number, parse_time};
use crate::EvaluationError;
use crate::trajectory::{TimedPose, Trajectory, TrajectoryRepairs};

/// Reads one pose per line: twelve numbers, row by row. The rotation is orthogonalised; one that is far from
/// orthogonal is an error.
///
/// # Errors
/// If reading fails, or a line is not what the format asks for.
pub fn read_kitti_poses(reader: impl BufRead) -> Result<Vec<Rigid3>, EvaluationError> {
    let mut lines = Lines::new(reader);
    let mut poses = Vec::new();
    while let Some((number, line)) = lines.next_data()? {
        let mut values = [0.0; 12];
        let mut fields = line.split_ascii_whitespace();
        for value in &mut values {
            let expected = || bad_line(number, "too few numbers: expected the twelve of a 3 by 4 matrix");
            *value = parse_number(fields.next().ok_or_else(expected)?, number)?;
        }
        if !values.iter().all(|v| v.is_finite()) {
            return Err(bad_line(number, "not all numbers are finite"));
        }
        if fields.next().is_some() {
            return Err(bad_line(number, "too many numbers: expected the twelve of a 3 by 4 matrix"));
        }
        let matrix = na::Matrix3x4::from_row_slice(&values);
        let rotation = rotation_of(&matrix.fixed_columns::<3>(0).into_owned())
            .ok_or_else(|| bad_line(number, "the first three columns are not a rotation"))?;
        let translation = na::Translation3::from(matrix.column(3).into_owned());
        poses.push(Rigid3::from_parts(translation, rotation));
    }
    Ok(poses)
}

/// The rotation nearest to a matrix. `None` if an entry of `RᵀR − I` exceeds 0.1 or the determinant is
/// negative.
fn rotation_of(matrix: &na::Matrix3<f64>) -> Option<Quaternion> {
    let off = matrix.transpose() * matrix - na::Matrix3::identity();
    if off.amax() > 0.1 || matrix.determinant() < 0.0 {
        return None;
    }
    // The matrix may have been written with few digits: orthogonalise its columns symmetrically.
    let svd = matrix.try_svd(true, true, f64::EPSILON, 100)?;
    let rotation = na::Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?);
    Some(Quaternion::from_rotation_matrix(&rotation))
}

/// Reads one time per line, seconds.
///
/// # Errors
/// If reading fails, or a line is no time.
pub fn read_kitti_times(reader: impl BufRead) -> Result<Vec<Time>, EvaluationError> {
    let mut lines = Lines::new(reader);
    let mut times = Vec::new();
    while let Some((number, line)) = lines.next_data()? {
        times.push(parse_time(&line, number)?);
    }
    Ok(times)
}

/// Poses and times of the same sequence together.
///
/// # Errors
/// If there are not as many times as poses.
pub fn kitti_trajectory(
    poses: &[Rigid3],
    times: &[Time],
) -> Result<(Trajectory, TrajectoryRepairs), EvaluationError> {
    if poses.len() != times.len() {
        return Err(EvaluationError::UnequalLengths { poses: poses.len(), times: times.len() });
    }
    let timed = |(time, pose): (&Time, &Rigid3)| TimedPose { time: *time, map_from_tracking: *pose };
    Ok(Trajectory::new(times.iter().zip(poses).map(timed)))
}

/// Writes the poses of a trajectory without their times.
///
/// # Errors
/// If writing fails.
pub fn write_kitti(trajectory: &Trajectory, mut writer: impl Write) -> std::io::Result<()> {
    for pose in trajectory.poses() {
        let matrix = pose.map_from_tracking.to_homogeneous();
        let rows = matrix.fixed_rows::<3>(0).transpose();
        let text: Vec<String> = rows.iter().map(|v| format!("{v:.9e}")).collect();
        writeln!(writer, "{}", text.join(" "))?;
    }
    Ok(())
}
