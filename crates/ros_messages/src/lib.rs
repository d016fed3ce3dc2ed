#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod decode;
mod definitions;
mod encode;
mod message;
mod wire_reader;
mod wire_writer;

pub use decode::Decoder;
pub use definitions::{Dialect, definition, md5sum};
pub use encode::encode;
pub use message::*;
pub use wire_reader::DecodeError;
pub use wire_writer::EncodeError;

/// How messages of a connection are serialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// ROS 1: little endian, packed.
    Ros1,
    /// OMG CDR (XCDR1) with its four-byte encapsulation header.
    Cdr,
    /// Another encoding: its messages are listed, but not decoded.
    Unknown,
}

/// The message types that are decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum MessageKind {
    /// `sensor_msgs/LaserScan`.
    LaserScan,
    /// `sensor_msgs/MultiEchoLaserScan`.
    MultiEchoLaserScan,
    /// `sensor_msgs/PointCloud2`.
    PointCloud2,
    /// `sensor_msgs/PointCloud`, the format before 2012.
    PointCloud1,
    /// `sensor_msgs/Imu`.
    Imu,
    /// `nav_msgs/Odometry`.
    Odometry,
    /// `sensor_msgs/NavSatFix`.
    NavSatFix,
    /// `tf2_msgs/TFMessage`, `tf/tfMessage`.
    Tf,
    /// `geometry_msgs/PoseStamped`.
    PoseStamped,
    /// `cartographer_ros_msgs/LandmarkList`.
    LandmarkList,
    /// `CustomMsg` of Livox's drivers.
    LivoxPoints,
    /// `velodyne_msgs/VelodyneScan`.
    VelodyneScan,
    /// `PacketMsg` of Ouster's drivers.
    OusterPacket,
    /// Text; only sensor metadata are decoded from it.
    Text,
}

impl MessageKind {
    /// The kind of a type given as `package/Type`.
    pub fn from_type_name(type_name: &str) -> Option<Self> {
        Some(match type_name {
            "sensor_msgs/LaserScan" => Self::LaserScan,
            "sensor_msgs/MultiEchoLaserScan" => Self::MultiEchoLaserScan,
            "sensor_msgs/PointCloud2" => Self::PointCloud2,
            "sensor_msgs/PointCloud" => Self::PointCloud1,
            "sensor_msgs/Imu" => Self::Imu,
            "nav_msgs/Odometry" => Self::Odometry,
            "sensor_msgs/NavSatFix" => Self::NavSatFix,
            "tf2_msgs/TFMessage" | "tf/tfMessage" => Self::Tf,
            "geometry_msgs/PoseStamped" => Self::PoseStamped,
            "cartographer_ros_msgs/LandmarkList" => Self::LandmarkList,
            "velodyne_msgs/VelodyneScan" => Self::VelodyneScan,
            "ouster_ros/PacketMsg" | "ouster_msgs/PacketMsg" | "ouster_sensor_msgs/PacketMsg" => {
                Self::OusterPacket
            }
            "livox_ros_driver/CustomMsg" | "livox_ros_driver2/CustomMsg" | "livox_interfaces/CustomMsg" => {
                Self::LivoxPoints
            }
            "std_msgs/String" => Self::Text,
            _ => return None,
        })
    }
}

/// `package/Type` for any of the spellings `package/msg/Type`, `package::msg::dds_::Type_`.
pub fn normalized_type_name(name: &str) -> String {
    if name.contains("::") {
        let parts: Vec<&str> =
            name.split("::").filter(|part| !matches!(*part, "msg" | "dds_" | "")).collect();
        return parts.join("/").trim_end_matches('_').to_owned();
    }
    name.replacen("/msg/", "/", 1)
}

/// Whether a topic carries static transforms: `/tf_static`, also inside a namespace.
pub fn is_static_tf_topic(topic: &str) -> bool {
    topic.rsplit('/').next() == Some("tf_static")
}

#[cfg(test)]
mod tests;
