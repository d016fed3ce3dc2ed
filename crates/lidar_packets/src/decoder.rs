//! Decodes the packets of one sensor to its measurements.

use portolan_geometry::Time;

use crate::ouster::OusterDecoder;
use crate::ouster_imu::imu_samples;
use crate::velodyne::VelodyneDecoder;
use crate::{PacketSource, SensorTime, Sweep};
use portolan_issue::{IssueKind, IssueLog};

/// One sample of an IMU, in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time of measurement.
    pub time: Time,
    /// Radians per second.
    pub angular_velocity: [f64; 3],
    /// Metres per second squared; about +9.8 upwards at rest.
    pub linear_acceleration: [f64; 3],
}

/// A measurement decoded from packets.
#[derive(Clone, Debug, PartialEq)]
pub enum Measured {
    /// A sweep of a lidar.
    Sweep(Sweep),
    /// A sample of an IMU.
    Imu(ImuSample),
}

/// Decodes the packets of one sensor to its measurements.
pub struct PacketDecoder {
    decoder: Decoder,
    /// The previous packet.
    last: Vec<u8>,
}

enum Decoder {
    Velodyne(Box<VelodyneDecoder>),
    Ouster(Box<OusterDecoder>),
    OusterImu,
}

impl PacketDecoder {
    pub(crate) fn new(source: &PacketSource) -> Self {
        let decoder = match source {
            PacketSource::Velodyne(calibration) => {
                Decoder::Velodyne(Box::new(VelodyneDecoder::new(calibration.clone())))
            }
            PacketSource::OusterLidar(metadata, layout) => {
                Decoder::Ouster(Box::new(OusterDecoder::new((**metadata).clone(), *layout)))
            }
            PacketSource::OusterImu => Decoder::OusterImu,
        };
        Self { decoder, last: Vec::new() }
    }

    /// Adds a packet with its time of arrival and the clock of its sensor; complete measurements go to
    /// `give`.
    pub fn push(
        &mut self,
        packet: (&[u8], Time),
        clock: &mut SensorTime,
        issues: &mut IssueLog,
        give: &mut dyn FnMut(Measured),
    ) {
        // Sensors number and time their packets, so two equal packets are a repetition.
        if self.last == packet.0 {
            issues.count(IssueKind::RepeatedPacket, 1);
            return;
        }
        self.last.clear();
        self.last.extend_from_slice(packet.0);
        match &mut self.decoder {
            Decoder::Velodyne(decoder) => {
                decoder.push(packet, clock, issues, &mut |sweep| give(Measured::Sweep(sweep)));
            }
            Decoder::Ouster(decoder) => {
                decoder.push(packet, clock, issues, &mut |sweep| give(Measured::Sweep(sweep)));
            }
            Decoder::OusterImu => {
                imu_samples(packet, clock, issues, &mut |sample| give(Measured::Imu(sample)));
            }
        }
    }

    /// The last, incomplete measurement.
    pub fn finish(&mut self) -> Option<Measured> {
        match &mut self.decoder {
            Decoder::Velodyne(decoder) => decoder.finish().map(Measured::Sweep),
            Decoder::Ouster(decoder) => decoder.finish().map(Measured::Sweep),
            Decoder::OusterImu => None,
        }
    }
}
