//! Where measurements come from.
//!
//! One interface ([`Recording`]) over every format; one file or folder of modules per format.

mod carmen;
mod codec;
mod container;
mod coreslam;
mod ingest;
mod inspect;
mod kitti;
mod memory;
mod merge;
mod message;
mod open;
mod output_file;
mod packets;
mod pcap;
mod repairs;
mod ros1;
mod ros2;
mod source;
mod text;
mod tf;
mod urdf;
mod writer;

pub use carmen::{CarmenLog, CarmenOptions, TimeColumn, looks_like_carmen};
pub use coreslam::{CoreSlamLog, looks_like_coreslam};
pub use ingest::{
    AzimuthTimes, ConfiguredSensors, Dimension, GeodeticPosition, ImuStatistics, IngestError, IngestOptions,
    Ingestion, Inventory, Notice, PlanError, PlannedImu, PlannedOdometry, PlannedRange, PlannedSensor,
    PointTime, PointTimeOrigin, RangeStatistics, SamplingRatios, SensorPlan, SensorStatistics, StampPolicy,
    TopicSurvey, plan,
};
pub use inspect::{
    CheckReport, ClockOffset, Finding, Histogram, PlanDescription, RecordingInfo, RepairDescription,
    SensorDelay, Severity, TopicDescription, check, check_with_clocks, findings_to_text, info,
    odometry_delay,
};
pub use memory::MemoryRecording;
pub use message::*;
pub use open::{open, open_all, open_bytes};
pub use source::*;
pub use text::{open_text_log, open_text_log_bytes};
pub use tf::{TfError, TfInput, TfTree, frame_name};
pub use urdf::{FixedJoint, RobotDescription, parse_urdf, read_urdf};
pub use writer::{BagCompression, McapCompression, RecordingFormat, RecordingWriter, create};
