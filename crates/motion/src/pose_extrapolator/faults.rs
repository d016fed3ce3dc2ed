//! What was wrong with measurements, and how often.

use thiserror::Error;

/// Why a measurement was not used. It is also counted.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum ExtrapolatorError {
    /// Time has moved on.
    #[error("older than the last pose")]
    OlderThanLastPose,
    /// Stamps run backward or stand still.
    #[error("not newer than the measurement before it")]
    OutOfOrder,
    /// NaN, infinite, or not a rotation.
    #[error("not a finite measurement")]
    NotFinite,
}

/// What was not used, and repaired.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ExtrapolatorCounts {
    /// Poses that were not newer than the last, or not finite.
    pub rejected_poses: u64,
    /// IMU samples that were too old, out of order or not finite.
    pub rejected_imu: u64,
    /// Odometry poses that were too old, out of order or not finite.
    pub rejected_odometry: u64,
    /// Times that odometry started anew elsewhere (only with `use_all_odometry`).
    pub odometry_jumps: u64,
    /// Poses that were asked for from before the last one, or before there was one.
    pub queries_too_early: u64,
}

impl ExtrapolatorCounts {
    /// Both together.
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
