//! Sensors of the platform: lidars, wheels, IMU, satellite receiver and a camera for landmarks; and their
//! faults.

mod beam_table;
mod faults;
mod gnss;
mod imu;
mod landmarks;
mod lidar;
mod odometry;
mod spinning_lidar;
mod stream;

pub use beam_table::BeamTable;
pub use faults::{Fault, FaultTarget};
pub(crate) use faults::{FaultFilter, check_faults};
pub use gnss::GnssOptions;
pub(crate) use gnss::GnssStream;
pub use imu::ImuOptions;
pub(crate) use imu::ImuStream;
pub use landmarks::LandmarkOptions;
pub(crate) use landmarks::{LandmarkStream, landmark_poses};
pub(crate) use lidar::Lidar;
pub use lidar::{LidarMount, LidarOptions, NoReturn};
pub use odometry::OdometryOptions;
pub(crate) use odometry::OdometryStream;
pub(crate) use spinning_lidar::SpinningLidar;
pub use spinning_lidar::SpinningLidarOptions;
pub(crate) use stream::{Clock, MessageStream, Schedule};
