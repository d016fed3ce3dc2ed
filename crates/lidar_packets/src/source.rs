//! Describes the sources of packets.

use portolan_geometry::Time;

use crate::ouster::USUAL_COLUMNS;
use crate::ouster_imu::{imu_sensor_time, ouster_imu_serial};
use crate::{Laser, OusterMetadata, PacketDecoder, PacketLayout};
use portolan_issue::{IssueKind, IssueLog};

/// A source of packets of one kind.
#[derive(Clone, Debug, PartialEq)]
pub enum PacketSource {
    /// A Velodyne, with its calibration if there is one.
    Velodyne(Option<Vec<Laser>>),
    /// The lidar of an Ouster.
    OusterLidar(Box<OusterMetadata>, PacketLayout),
    /// The IMU of an Ouster.
    OusterImu,
}

impl PacketSource {
    /// The lidar of an Ouster, from its metadata or from the length of a packet; none if no layout has this
    /// length.
    ///
    /// `largest_column` is the largest column number of some packets ([`PacketLayout::largest_column`]).
    /// Without metadata the number of columns per revolution is derived from it.
    pub fn ouster_lidar(
        metadata: Option<&OusterMetadata>,
        packet: &[u8],
        largest_column: u16,
        issues: &mut IssueLog,
    ) -> Option<Self> {
        if let Some(metadata) = metadata {
            if let Some(layout) = metadata.layout_of(packet) {
                return Some(Self::OusterLidar(Box::new(metadata.clone()), layout));
            }
            issues.count(IssueKind::WrongOusterMetadata, 1);
        }
        let layout = PacketLayout::guess(packet)?;
        issues.count(IssueKind::NoOusterMetadata, 1);
        let columns = usize::from(largest_column).max(USUAL_COLUMNS).next_power_of_two().clamp(512, 4096);
        let metadata = OusterMetadata::assumed(layout.channels, columns);
        Some(Self::OusterLidar(Box::new(metadata), layout))
    }

    /// Time of measurement of a packet by the sensor's clock, if it does not depend on earlier packets.
    pub fn sensor_time(&self, packet: &[u8]) -> Option<Time> {
        match self {
            Self::Velodyne(_) => None,
            Self::OusterLidar(_, layout) => layout.sensor_time(packet),
            Self::OusterImu => imu_sensor_time(packet),
        }
    }

    /// The serial number of the sensor that sent a packet, if packets contain it.
    pub fn serial(&self, packet: &[u8]) -> Option<u64> {
        match self {
            Self::Velodyne(_) => None,
            Self::OusterLidar(_, layout) => layout.serial(packet),
            Self::OusterImu => ouster_imu_serial(packet),
        }
    }

    /// A decoder for its packets.
    pub fn decoder(&self) -> PacketDecoder {
        PacketDecoder::new(self)
    }
}
