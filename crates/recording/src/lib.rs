#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod carmen;
mod container;
mod coreslam;
mod kitti;
mod memory;
mod merge;
mod open;
mod output_file;
mod packets;
mod pcap;
mod ros1;
mod ros2;
mod source;
mod stamp_pattern;
mod text;
mod writer;

pub use carmen::{CarmenLog, CarmenOptions, TimeColumn, looks_like_carmen};
pub use coreslam::{CoreSlamLog, looks_like_coreslam};
pub use memory::MemoryRecording;
pub use open::{open, open_all, open_bytes};
pub use portolan_issue::{Issue, IssueKind, IssueLog};
pub use portolan_ros_messages::{
    FieldType, Header, Imu, LandmarkEntry, LandmarkList, LaserScan, Message, MultiEchoLaserScan, NavSatFix,
    Odometry, PacketKind, PointCloud2, PointField, Pose, PoseStamped, RecordedMessage, SensorPackets,
    TfMessage, TransformStamped,
};
pub use source::*;
pub use stamp_pattern::{StampNoise, StampPattern};
pub use text::{open_text_log, open_text_log_bytes};
pub use writer::{BagCompression, McapCompression, RecordingFormat, RecordingWriter, create};
