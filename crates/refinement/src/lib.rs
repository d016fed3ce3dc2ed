#![doc = include_str!("../README.md")]

pub mod continuous;
mod error;
mod motion_sensors;
mod point_store;
pub mod semi_rigid;

pub use error::RefineError;
pub use motion_sensors::MotionSensors;
pub use point_store::{LeftOutPoints, MAX_SENSORS, PointStore, StoredPoint, StoredSensor};
