//! Reads measurements of the INS (OXTS RT 3003) and its pose relative to the lidar.

use std::path::Path;

use nalgebra as na;
use portolan_geometry::{Rigid3, Time, Vector3, rotation_from_roll_pitch_yaw};

use crate::{Header, Imu, NavSatFix};
use portolan_issue::{IssueKind, IssueLog};

/// Minimum number of values in a reading.
const VALUES: usize = 25;

/// Parses the fix and the inertial values of a line: latitude, longitude, altitude; roll, pitch, yaw; five
/// velocities; accelerations and angular rates, first in the vehicle's axes (x ahead, y left, z up), then
/// levelled; accuracy.
pub(super) fn parse(text: &str, time: Time, frame: &str) -> Option<(NavSatFix, Imu)> {
    let values: Vec<f64> = text.split_ascii_whitespace().take(40).map_while(|v| v.parse().ok()).collect();
    let &[latitude_degrees, longitude_degrees, altitude, roll, pitch, yaw, ..] = values.as_slice() else {
        return None;
    };
    if values.len() < VALUES || values.iter().take(VALUES).any(|v| !v.is_finite()) {
        return None;
    }
    let header = || Header { stamp: time, frame_id: frame.into() };
    let three = |at: usize| [0, 1, 2].map(|i| values.get(at + i).copied().unwrap_or(0.0));
    let accuracy = values.get(23).copied().filter(|a| *a > 0.0).unwrap_or(1.0);
    let variance = accuracy * accuracy;
    let fix = NavSatFix {
        header: header(),
        status: 0,
        service: 1,
        latitude_degrees,
        longitude_degrees,
        altitude,
        position_covariance: [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 4.0 * variance],
        position_covariance_type: 2,
    };
    let orientation = rotation_from_roll_pitch_yaw(roll, pitch, yaw);
    let q = orientation.quaternion();
    let imu = Imu {
        header: header(),
        orientation_xyzw: [q.i, q.j, q.k, q.w],
        orientation_covariance: [0.0; 9],
        angular_velocity: three(17),
        angular_velocity_covariance: [0.0; 9],
        linear_acceleration: three(11),
        linear_acceleration_covariance: [0.0; 9],
    };
    Some((fix, imu))
}

/// Reads the extrinsics from `calib_imu_to_velo.txt`, in the folder of the date or of the drive. Without that
/// file it uses the nominal mounting of the KITTI cars.
pub(super) fn ins_from_lidar(drive: &Path, issues: &mut IssueLog) -> Rigid3 {
    let beside = drive.parent().map(|date| date.join("calib_imu_to_velo.txt"));
    let inside = drive.join("calib_imu_to_velo.txt");
    let text = [beside, Some(inside)].into_iter().flatten().find_map(|path| {
        let is_short = std::fs::metadata(&path).is_ok_and(|m| m.is_file() && m.len() < 1 << 16);
        is_short.then(|| std::fs::read_to_string(path).ok()).flatten()
    });
    match text {
        None => Rigid3::translation(0.81, -0.32, 0.80),
        Some(text) => parse_calibration(&text).map_or_else(
            || {
                issues.add(IssueKind::UnreadableCalibration);
                Rigid3::translation(0.81, -0.32, 0.80)
            },
            |lidar_from_ins| lidar_from_ins.inverse(),
        ),
    }
}

/// Parses `R: nine numbers` (row by row) and `T: three numbers`, metres.
fn parse_calibration(text: &str) -> Option<Rigid3> {
    let numbers = |key: &str| -> Option<Vec<f64>> {
        let line = text.lines().find_map(|line| line.trim().strip_prefix(key)?.strip_prefix(':'))?;
        line.split_ascii_whitespace().map(|v| v.parse().ok()).collect()
    };
    let (r, t) = (numbers("R")?, numbers("T")?);
    let t: [f64; 3] = t.try_into().ok()?;
    if r.len() != 9 || r.iter().chain(&t).any(|v| !v.is_finite()) {
        return None;
    }
    let matrix = na::Matrix3::from_row_slice(&r);
    let is_rotation =
        (matrix * matrix.transpose() - na::Matrix3::identity()).norm() < 1e-2 && matrix.determinant() > 0.0;
    let rotation = na::UnitQuaternion::from_matrix(&matrix);
    is_rotation.then(|| Rigid3::from_parts(Vector3::from(t).into(), rotation))
}
