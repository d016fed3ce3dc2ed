//! From the packets of one sensor to what it measured.

use portolan_geometry::Time;

use crate::ouster::OusterDecoder;
use crate::ouster_imu::imu_samples;
use crate::velodyne::VelodyneDecoder;
use crate::{PacketSource, SensorTime, Sweep};
use portolan_issue::{IssueKind, IssueLog};

/// One sample of an IMU, in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// When it was measured.
    pub time: Time,
    /// Radians per second.
    pub angular_velocity: [f64; 3],
    /// Metres per second squared; about +9.8 upwards at rest.
    pub linear_acceleration: [f64; 3],
}

/// What packets hold.
#[derive(Clone, Debug, PartialEq)]
pub enum Measured {
    /// A sweep of a lidar.
    Sweep(Sweep),
    /// A sample of an IMU.
    Imu(ImuSample),
}

/// Turns the packets of one sensor into what it measured.
pub struct PacketDecoder {
    decoder: Decoder,
    /// The packet before.
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

    /// Adds a packet that arrived at a time, of a sensor with a clock; what is complete goes to `give`.
    pub fn push(
        &mut self,
        packet: (&[u8], Time),
        clock: &mut SensorTime,
        issues: &mut IssueLog,
        give: &mut dyn FnMut(Measured),
    ) {
        // Sensors count and time their packets, so that no two are equal.
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

    /// What is left at the end.
    pub fn finish(&mut self) -> Option<Measured> {
        match &mut self.decoder {
            Decoder::Velodyne(decoder) => decoder.finish().map(Measured::Sweep),
            Decoder::Ouster(decoder) => decoder.finish().map(Measured::Sweep),
            Decoder::OusterImu => None,
        }
    }
}
