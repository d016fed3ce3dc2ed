//! Errors of measurements, and how often they occurred.

use thiserror::Error;

/// Reason why a measurement was rejected. It is also counted.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum ExtrapolatorError {
    /// Older than the last pose.
    #[error("older than the last pose")]
    OlderThanLastPose,
    /// Stamps run backward or repeat.
    #[error("not newer than the measurement before it")]
    OutOfOrder,
    /// NaN, infinite, or not a rotation.
    #[error("not a finite measurement")]
    NotFinite,
}

/// Numbers of measurements that were rejected or repaired.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExtrapolatorCounts {
    /// Poses that were not newer than the last, or not finite.
    pub rejected_poses: u64,
    /// IMU samples that were too old, out of order or not finite.
    pub rejected_imu: u64,
    /// Odometry poses that were too old, out of order or not finite.
    pub rejected_odometry: u64,
    /// Number of times that odometry restarted at another pose (only with `use_all_odometry`).
    pub odometry_jumps: u64,
    /// Number of requested poses before the last one, or before there was one.
    pub queries_too_early: u64,
}

impl ExtrapolatorCounts {
    /// Sum of both counts.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            rejected_poses: self.rejected_poses + other.rejected_poses,
            rejected_imu: self.rejected_imu + other.rejected_imu,
            rejected_odometry: self.rejected_odometry + other.rejected_odometry,
            odometry_jumps: self.odometry_jumps + other.odometry_jumps,
            queries_too_early: self.queries_too_early + other.queries_too_early,
        }
    }
}
