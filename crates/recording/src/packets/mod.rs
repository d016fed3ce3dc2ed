//! Packets as sensors send them, from captures of the network and from bags of raw packets.

mod cloud_builder;
mod ouster;
mod ouster_metadata;
mod sensor_time;
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
pub(crate) use sensor_time::{PacketStream, SensorTime, clocks_of};
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

    /// When a packet was measured by the sensor's clock, where that needs no packets before it.
    pub fn sensor_time(&self, packet: &[u8]) -> Option<Time> {
        match self {
            Self::Velodyne(_) => None,
            Self::OusterLidar(_, layout) => layout.sensor_time(packet),
            Self::OusterImu => ouster::imu_sensor_time(packet),
        }
    }

    /// Starts to decode; messages are in a frame.
    pub fn decoder(&self, frame: &str) -> PacketDecoder {
        let decoder = match self {
            Self::Velodyne(calibration) => {
                Decoder::Velodyne(Box::new(VelodyneDecoder::new(frame, calibration.clone())))
            }
            Self::OusterLidar(metadata, layout) => {
                Decoder::Ouster(Box::new(OusterDecoder::new((**metadata).clone(), *layout, frame)))
            }
            Self::OusterImu => Decoder::OusterImu(OusterImuDecoder::new(frame)),
        };
        PacketDecoder { decoder, last: Vec::new() }
    }
}

/// Turns the packets of one sensor into messages.
pub(crate) struct PacketDecoder {
    decoder: Decoder,
    /// The packet before.
    last: Vec<u8>,
}

enum Decoder {
    Velodyne(Box<VelodyneDecoder>),
    Ouster(Box<OusterDecoder>),
    OusterImu(OusterImuDecoder),
}

impl PacketDecoder {
    /// Adds a packet that arrived at a time, of a sensor with a clock; what is complete goes to `give`.
    pub fn push(
        &mut self,
        packet: (&[u8], Time),
        clock: &mut SensorTime,
        repairs: &mut RepairLog,
        give: &mut dyn FnMut(Message),
    ) {
        // Sensors count and time their packets, so that no two are equal.
        if self.last == packet.0 {
            repairs.repaired("exact repetitions of the packet before were left out");
            return;
        }
        self.last.clear();
        self.last.extend_from_slice(packet.0);
        match &mut self.decoder {
            Decoder::Velodyne(decoder) => {
                decoder.push(packet, clock, repairs, &mut |cloud| give(Message::PointCloud2(cloud)));
            }
            Decoder::Ouster(decoder) => {
                decoder.push(packet, clock, repairs, &mut |cloud| give(Message::PointCloud2(cloud)));
            }
            Decoder::OusterImu(decoder) => {
                decoder.decode(packet, clock, repairs).map(Message::Imu).map(give);
            }
        }
    }

    /// What is left at the end.
    pub fn finish(&mut self) -> Option<Message> {
        match &mut self.decoder {
            Decoder::Velodyne(decoder) => decoder.finish().map(Message::PointCloud2),
            Decoder::Ouster(decoder) => decoder.finish().map(Message::PointCloud2),
            Decoder::OusterImu(_) => None,
        }
    }
}
