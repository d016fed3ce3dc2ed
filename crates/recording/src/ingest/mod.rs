//! From messages to measurements in the tracking frame.
//!
//! 1. [`Inventory::of`] looks at the beginning of a recording: topics, frames, rates, clocks.
//! 2. [`plan`] chooses which topic is which sensor and whose motion is wanted.
//! 3. [`Ingestion`] reads the recording as planned; what is wrong with a message is repaired or left
//!    out, and counted.

mod azimuth_time;
mod clock;
pub(crate) mod convert;
pub(crate) mod even_stamps;
mod gnss;
mod ingestion;
pub(crate) mod laser;
mod options;
mod plan;
pub(crate) mod point_cloud2;
pub(crate) mod point_time;
mod read_ahead;
mod seam;
pub(crate) mod statistics;
pub(crate) mod survey;
#[cfg(test)]
pub(crate) mod test_messages;
pub(crate) mod timed_points;

pub use azimuth_time::AzimuthTimes;
pub use even_stamps::StampPolicy;
pub use gnss::GeodeticPosition;
pub use ingestion::{IngestError, Ingestion};
pub use options::{ConfiguredSensors, Dimension, IngestOptions, SamplingRatios};
pub use plan::{
    Notice, PlanError, PlannedImu, PlannedOdometry, PlannedRange, PlannedSensor, SensorPlan,
    SensorStatistics, plan,
};
pub use point_time::{PointTime, PointTimeOrigin};
pub use statistics::{ImuStatistics, RangeStatistics};
pub use survey::{Inventory, TopicSurvey};
