//! Refinement of trajectories and registration of scans.
//!
//! - [`continuous`]: a trajectory bent until everything seen from it fits together; the method to use.
//! - [`semi_rigid`]: the same as published, with sections of the trajectory.
//! - [`registration`]: ICP, and all scans at once.
//!
//! Nothing here knows of files. Points are `f32` metres, poses `f64`.

pub mod continuous;
mod error;
mod motion_sensors;
mod point_store;
pub mod registration;
pub mod semi_rigid;

pub use error::RefineError;
pub use motion_sensors::MotionSensors;
pub use point_store::{LeftOutPoints, MAX_SENSORS, PointStore, StoredPoint, StoredSensor};
