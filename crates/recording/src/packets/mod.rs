//! Packets as sensors send them, from captures of the network and from bags of raw packets.

mod cloud_builder;
mod ouster;
mod ouster_metadata;
mod unpack;
mod velodyne;
mod velodyne_models;

#[cfg(test)]
mod tests;

use portolan_geometry::Time;

use crate::Message;
use crate::repairs::RepairLog;

pub(crate) use cloud_builder::{CloudBuilder, PacketPoint, f32_at};
pub(crate) use ouster::{FRAME as OUSTER_FRAME, IMU_PACKET_BYTES, PacketLayout};
pub(crate) use ouster_metadata::OusterMetadata;
pub(crate) use unpack::{ouster_source, unpacked};
pub(crate) use velodyne::is_velodyne;
pub(crate) use velodyne_models::{Laser, VelodyneModel, parse_calibration};

use ouster::{OusterDecoder, OusterImuDecoder};
use velodyne::VelodyneDecoder;

/// What sends packets of one kind.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum PacketSource {
    /// A Velodyne, with its calibration if there is one.
    Velodyne(Option<Vec<Laser>>),
    /// The lidar of an Ouster.
    OusterLidar(Box<OusterMetadata>, PacketLayout),
    /// The IMU of an Ouster.
    OusterImu,
}

impl PacketSource {
    /// Type of the messages that its packets become.
    pub fn type_name(&self) -> &'static str {
        match self {
            Self::Velodyne(_) | Self::OusterLidar(..) => "sensor_msgs/PointCloud2",
            Self::OusterImu => "sensor_msgs/Imu",
        }
    }

    /// Starts to decode; messages are in a frame.
    pub fn decoder(&self, frame: &str) -> PacketDecoder {
        match self {
            Self::Velodyne(calibration) => {
                PacketDecoder::Velodyne(Box::new(VelodyneDecoder::new(frame, calibration.clone())))
            }
            Self::OusterLidar(metadata, layout) => {
                PacketDecoder::Ouster(Box::new(OusterDecoder::new((**metadata).clone(), *layout, frame)))
            }
            Self::OusterImu => PacketDecoder::OusterImu(OusterImuDecoder::new(frame)),
        }
    }
}

/// Turns the packets of one sensor into messages.
pub(crate) enum PacketDecoder {
    Velodyne(Box<VelodyneDecoder>),
    Ouster(Box<OusterDecoder>),
    OusterImu(OusterImuDecoder),
}

impl PacketDecoder {
    /// Adds a packet that arrived at a time; what is complete goes to `give`.
    pub fn push(
        &mut self,
        packet: &[u8],
        arrival: Time,
        repairs: &mut RepairLog,
        give: &mut dyn FnMut(Message),
    ) {
        match self {
            Self::Velodyne(decoder) => {
                decoder.push(packet, arrival, repairs, &mut |cloud| give(Message::PointCloud2(cloud)));
            }
            Self::Ouster(decoder) => {
                decoder.push(packet, arrival, repairs, &mut |cloud| give(Message::PointCloud2(cloud)));
            }
            Self::OusterImu(decoder) => {
                decoder.decode(packet, arrival, repairs).map(Message::Imu).map(give);
            }
        }
    }

    /// What is left at the end.
    pub fn finish(&mut self) -> Option<Message> {
        match self {
            Self::Velodyne(decoder) => decoder.finish().map(Message::PointCloud2),
            Self::Ouster(decoder) => decoder.finish().map(Message::PointCloud2),
            Self::OusterImu(_) => None,
        }
    }
}
