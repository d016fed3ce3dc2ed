//! What sends packets.

use portolan_geometry::Time;

use crate::ouster::{self, USUAL_COLUMNS};
use crate::{Laser, OusterMetadata, PacketDecoder, PacketLayout, PacketProfile};
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
    /// The lidar of an Ouster, from what it tells or from the length of its packets; none if no layout is as long.
    ///
    /// `largest_column` is that of some packets ([`PacketLayout::largest_column`]): without metadata it tells how many
    /// columns a revolution has.
    pub fn ouster_lidar(
        metadata: Option<&OusterMetadata>,
        packet_bytes: usize,
        largest_column: u16,
        issues: &mut IssueLog,
    ) -> Option<Self> {
        if let Some(metadata) = metadata {
            let layout = |profile| PacketLayout {
                profile,
                channels: metadata.altitudes.len(),
                columns: metadata.columns_per_packet,
            };
            let told = metadata.profile.into_iter().chain(PacketProfile::ALL);
            let fitting = told.map(layout).find(|layout| layout.packet_bytes() == packet_bytes);
            if let Some(layout) = fitting {
                return Some(Self::OusterLidar(Box::new(metadata.clone()), layout));
            }
            issues.count(IssueKind::WrongOusterMetadata, 1);
        }
        let layout = PacketLayout::guess(packet_bytes)?;
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
            Self::OusterImu => ouster::imu_sensor_time(packet),
        }
    }

    /// Starts to decode.
    pub fn decoder(&self) -> PacketDecoder {
        PacketDecoder::new(self)
    }
}
