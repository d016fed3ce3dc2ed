#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod bytes;
mod datagram;
mod decoder;
mod ouster;
mod ouster_header;
mod ouster_imu;
mod ouster_metadata;
mod ouster_profiles;
mod sensor_time;
mod source;
mod sweep;
mod velodyne;
mod velodyne_models;

#[cfg(test)]
mod tests;

pub use datagram::{Datagrams, Endpoint};
pub use decoder::{ImuSample, Measured, PacketDecoder};
pub use ouster::PacketLayout;
pub use ouster_header::{PacketHeader, is_other_ouster_data};
pub use ouster_imu::{is_ouster_imu, ouster_imu_serial};
pub use ouster_metadata::OusterMetadata;
pub use ouster_profiles::PacketProfile;
pub use sensor_time::{PacketStream, SensorTime, clocks_of};
pub use source::PacketSource;
pub use sweep::{PacketPoint, Sweep, SweepBuilder, SweepPoint};
pub use velodyne::is_velodyne;
pub use velodyne_models::{Laser, VelodyneModel, parse_calibration};
