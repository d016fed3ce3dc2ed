//! What sends packets.

use portolan_geometry::Time;

use crate::ouster::USUAL_COLUMNS;
use crate::ouster_imu::{imu_sensor_time, ouster_imu_serial};
use crate::{Laser, OusterMetadata, PacketDecoder, PacketLayout};
use portolan_issue::{IssueKind, IssueLog};

/// What sends packets of one kind.
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
    /// The lidar of an Ouster, from what it tells or from the length of a packet; none if no layout is as long.
    ///
    /// `largest_column` is that of some packets ([`PacketLayout::largest_column`]): without metadata it tells how many
    /// columns a revolution has.
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

    /// When a packet was measured by the sensor's clock, where that needs no packets before it.
    pub fn sensor_time(&self, packet: &[u8]) -> Option<Time> {
        match self {
            Self::Velodyne(_) => None,
            Self::OusterLidar(_, layout) => layout.sensor_time(packet),
            Self::OusterImu => imu_sensor_time(packet),
        }
    }

    /// The serial number of the sensor that sent a packet, where packets tell it.
    pub fn serial(&self, packet: &[u8]) -> Option<u64> {
        match self {
            Self::Velodyne(_) => None,
            Self::OusterLidar(_, layout) => layout.serial(packet),
            Self::OusterImu => ouster_imu_serial(packet),
        }
    }

    /// Starts to decode.
    pub fn decoder(&self) -> PacketDecoder {
        PacketDecoder::new(self)
    }
}
