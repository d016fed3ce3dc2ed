//! Converts packets of sensors to messages.

mod cloud;
mod unpack;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use portolan_geometry::Time;
use portolan_issue::IssueLog;
use portolan_lidar_packets::{ImuSample, Measured, PacketDecoder, PacketSource, SensorTime};

use crate::{Header, Imu, Message};

pub(crate) use cloud::cloud_of;
pub(crate) use unpack::unpacked;

/// Frame of the clouds and IMU samples of an Ouster, as its driver names it.
pub(crate) const OUSTER_FRAME: &str = "os_sensor";

/// Type of the messages that packets are converted to.
pub(crate) fn type_name(source: &PacketSource) -> &'static str {
    match source {
        PacketSource::Velodyne(_) | PacketSource::OusterLidar(..) => "sensor_msgs/PointCloud2",
        PacketSource::OusterImu => "sensor_msgs/Imu",
    }
}

/// Turns the packets of one sensor into messages.
pub(crate) struct PacketMessages {
    decoder: PacketDecoder,
    frame: Arc<str>,
}

impl PacketMessages {
    /// Decodes packets of `source`; its messages are in `frame`.
    pub fn new(source: &PacketSource, frame: &str) -> Self {
        Self { decoder: source.decoder(), frame: frame.into() }
    }

    /// Adds a packet with its time of arrival and the clock of its sensor; complete messages go to `give`.
    pub fn push(
        &mut self,
        packet: (&[u8], Time),
        clock: &mut SensorTime,
        issues: &mut IssueLog,
        give: &mut dyn FnMut(Message),
    ) {
        let frame = &self.frame;
        self.decoder.push(packet, clock, issues, &mut |measured| give(message(measured, frame)));
    }

    /// The last, incomplete message.
    pub fn finish(&mut self) -> Option<Message> {
        self.decoder.finish().map(|measured| message(measured, &self.frame))
    }
}

fn message(measured: Measured, frame: &Arc<str>) -> Message {
    match measured {
        Measured::Sweep(sweep) => Message::PointCloud2(cloud_of(&sweep, frame)),
        Measured::Imu(sample) => Message::Imu(imu(&sample, frame)),
    }
}

/// Converts an IMU sample: no orientation, unknown uncertainty.
fn imu(sample: &ImuSample, frame: &Arc<str>) -> Imu {
    Imu {
        header: Header { stamp: sample.time, frame_id: Arc::clone(frame) },
        orientation_xyzw: [0.0, 0.0, 0.0, 1.0],
        orientation_covariance: [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        angular_velocity: sample.angular_velocity,
        angular_velocity_covariance: [0.0; 9],
        linear_acceleration: sample.linear_acceleration,
        linear_acceleration_covariance: [0.0; 9],
    }
}
