//! What the robot carries: lidars, wheels, an IMU; and what can be wrong with them.

mod faults;
mod imu;
mod lidar;
mod odometry;
mod stream;

pub(crate) use faults::FaultFilter;
pub use faults::{Fault, FaultTarget};
pub use imu::ImuOptions;
pub(crate) use imu::ImuStream;
pub(crate) use lidar::Lidar;
pub use lidar::{LidarMount, LidarOptions, NoReturn};
pub use odometry::OdometryOptions;
pub(crate) use odometry::OdometryStream;
pub(crate) use stream::{Clock, MessageStream, Schedule};
