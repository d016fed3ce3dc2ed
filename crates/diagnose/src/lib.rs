#![doc = include_str!("../README.md")]

mod check;
mod clock_offset;
mod clouds;
mod coverage;
mod finding;
mod histogram;
mod imu;
mod imu_values;
mod info;
mod odometry;
mod odometry_comparison;
mod odometry_fault;
mod offset;
mod rotation;
mod scan_motion;
mod scan_turns;
mod scans;
mod stamps;
mod turns;

pub use check::{CheckReport, check, check_with_clocks};
pub use clock_offset::{ClockOffset, ImuComparison, ImuMounting};
pub use finding::{Finding, findings_to_text};
pub use histogram::Histogram;
pub use info::{PlanDescription, RecordingInfo, TopicDescription, info};
pub use odometry_comparison::{OdometryComparison, SensorDelay, compare_odometry};
pub use odometry_fault::OdometryFault;
pub use portolan_issue::Severity;

#[cfg(test)]
#[path = "../../ingest/src/test_messages.rs"]
mod test_messages;
#[cfg(test)]
mod tests;
