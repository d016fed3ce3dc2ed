//! What can be wrong with packets, and what is done about it.

use std::collections::BTreeMap;

/// A fault that decoding went on after.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum PacketFault {
    /// Network cards and recorders hand some packets on twice.
    #[error("exact repetitions of the packet before were left out")]
    Repetition,
    /// Something else sends to the port of a Velodyne.
    #[error("packets that are no data packets of a Velodyne were left out")]
    NotVelodyne,
    /// The product byte of a packet is none that is known.
    #[error("packets of an unknown Velodyne product were read as those of a VLP-16")]
    UnknownVelodyne,
    /// Each HDL-64E has beams of its own, of which its packets say nothing.
    #[error(
        "an HDL-64E without its calibration was read with nominal angles; put the calibration of \
         velodyne_pointcloud (.yaml) beside the capture under the same name"
    )]
    NoCalibration,
    /// A block of a Velodyne's packet begins with neither of its marks, or points nowhere.
    #[error("blocks of packets with a wrong mark or azimuth were left out")]
    DamagedBlock,
    /// A packet of an Ouster's lidar is not as long as its layout says.
    #[error("Ouster packets of an unexpected length were left out")]
    OusterLength,
    /// The sensor measured nothing there, or says that it was disturbed.
    #[error("columns of Ouster packets that the sensor marked as invalid were left out")]
    InvalidColumn,
    /// A packet of an Ouster's IMU is not as long as it should be.
    #[error("Ouster IMU packets of an unexpected length were left out")]
    OusterImuLength,
    /// The metadata are of another sensor or another setting.
    #[error("the metadata of an Ouster do not fit its packets and were not used")]
    WrongMetadata,
    /// Angles of beams are calibrated, and stand in the metadata alone.
    #[error(
        "an Ouster without its metadata was read with nominal angles of beams; put its metadata (.json) beside \
         the capture under the same name"
    )]
    NoMetadata,
    /// The sensor counts from when it was switched on, or its clock is wrong.
    #[error("the clock of a sensor was not set; its times were shifted to those of the recording")]
    ClockNotSet,
    /// The clock of a sensor was set while it measured.
    #[error(
        "the clock of a sensor jumped by more than a second against the times of arrival; its times go on as before"
    )]
    ClockJumped,
    /// A piece of a datagram that would be too long, put together.
    #[error("pieces of datagrams beyond their greatest length were left out")]
    LongDatagram,
    /// Pieces were lost on the way, or the capture begins or ends between them.
    #[error("datagrams of which pieces are missing were left out")]
    IncompleteDatagram,
}

impl PacketFault {
    /// Whether something that was measured is missing afterwards.
    pub fn loses_data(self) -> bool {
        match self {
            Self::NotVelodyne
            | Self::DamagedBlock
            | Self::OusterLength
            | Self::OusterImuLength
            | Self::LongDatagram
            | Self::IncompleteDatagram => true,
            Self::Repetition
            | Self::UnknownVelodyne
            | Self::NoCalibration
            | Self::InvalidColumn
            | Self::WrongMetadata
            | Self::NoMetadata
            | Self::ClockNotSet
            | Self::ClockJumped => false,
        }
    }
}

/// Where faults are counted.
pub trait FaultLog {
    /// Counts a fault that occurred so many times.
    fn count(&mut self, fault: PacketFault, times: u64);
}

impl FaultLog for BTreeMap<PacketFault, u64> {
    fn count(&mut self, fault: PacketFault, times: u64) {
        let counted = self.entry(fault).or_default();
        *counted = counted.saturating_add(times);
    }
}
