#![doc = include_str!("../README.md")]
#![cfg_attr(not(test), deny(clippy::indexing_slicing))]

mod azimuth_time;
mod beam_elevation;
mod beam_smoothing;
mod clock;
mod convert;
mod even_stamps;
mod held_pose;
mod ingestion;
mod laser;
mod options;
mod plan;
mod point_cloud2;
mod point_time;
mod polar_line;
mod range_noise;
mod read_ahead;
mod recording_clock;
mod repeats;
mod skew;
mod statistics;
mod steady_clock;
mod stuck_sample;
mod survey;
mod sweep_stamps;
#[cfg(test)]
mod test_messages;
mod tf;
mod timed_points;
mod turn_clock;
mod urdf;

pub use azimuth_time::{AzimuthTimes, Turn};
pub use beam_elevation::{BeamElevation, ElevationOffset};
pub use beam_smoothing::BeamSmoothing;
pub use convert::SatelliteFix;
pub use even_stamps::StampPolicy;
pub use held_pose::HeldPose;
pub use ingestion::{IngestError, Ingestion};
pub use options::{ConfiguredSensors, IngestOptions, SamplingRatios};
pub use plan::{
    Notice, PlanError, PlannedImu, PlannedOdometry, PlannedRange, PlannedSensor, SensorPlan,
    SensorStatistics, plan, upright_frame,
};
pub use point_time::{PointTime, PointTimeOrigin};
pub use range_noise::{RangeNoise, RangeNoiseEstimator};
pub use recording_clock::{LONGEST_PAUSE, RecordingClock};
pub use repeats::read_without_repeats;
pub use skew::{Skew, SkewFactor, SkewState};
pub use statistics::{ImuStatistics, RangeStatistics};
pub use steady_clock::StampJitter;
pub use survey::{Inventory, TopicSurvey, is_tf};
pub use tf::{TfError, TfInput, TfTree, frame_name};
pub use urdf::{FixedJoint, RobotDescription, parse_urdf, read_urdf};

// Reading of single messages, for callers that evaluate recordings by what mapping would use of them.
pub use convert::{MAX_ACCELERATION, MAX_ANGULAR_VELOCITY, pose_of};
pub use laser::{BeamDirections, ScanCorrections, ScanFaults, points_of_echoes, points_of_laser_scan};
pub use point_cloud2::{CloudError, CloudFaults, CloudLayout};
pub use statistics::{FAST_TURN, is_partial};
pub use timed_points::TimedPoints;
