#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod degeneracy;
mod degenerate_intervals;
mod gravity_initialisation;
mod imu_buffer;
mod imu_integration;
mod imu_tracker;
mod inertial_estimate;
mod interpolation;
mod motion_filter;
mod pose_extrapolator;
mod saturation;
mod standstill;

pub use degeneracy::{DegenerateDirections, Observability};
pub use degenerate_intervals::{
    DegenerateInterval, DegenerateIntervals, DegenerateMotion, DegenerateScan, Substitute,
};
pub use gravity_initialisation::{Beginning, GravityInitialisation, WaitingSweeps};
pub use imu_buffer::ImuBuffer;
pub use imu_integration::{ImuMotion, integrate_imu, velocity_change};
pub use imu_tracker::ImuTracker;
pub use inertial_estimate::{InertialEntry, InertialEstimate, InertialNoise, Preintegrated, USUAL_GRAVITY};
pub use interpolation::{fixed_frame_at, odometry_at};
pub use motion_filter::MotionFilter;
pub use pose_extrapolator::{ExtrapolatorCounts, ExtrapolatorError, ImuBasedSettings, PoseExtrapolator};
pub use saturation::SaturationDetector;
pub use standstill::{StandstillTolerances, ZeroVelocityDetector};
