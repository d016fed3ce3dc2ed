#![doc = include_str!("../README.md")]

mod beam_times;
mod check;
mod clock_offset;
mod clouds;
mod coverage;
mod finding;
mod fixes;
mod histogram;
mod imu;
mod imu_values;
mod info;
mod odometry;
mod odometry_fault;
mod odometry_held;
mod offset;
mod rotation;
mod scan_comparison;
mod scan_gyroscope;
mod scan_motion;
mod scan_turns;
mod scans;
mod stamp_jitter;
mod stamps;
mod turns;

pub use beam_times::ScanDuration;
pub use check::{CheckReport, check, check_with_clocks};
pub use clock_offset::{ClockOffset, ImuComparison, ImuMisalignment, ImuMounting};
pub use finding::{Finding, findings_to_text};
pub use histogram::Histogram;
pub use info::{PlanDescription, RecordingInfo, TopicDescription, info};
pub use odometry_fault::OdometryFault;
pub use odometry_held::OdometryHold;
pub use portolan_issue::Severity;
pub use scan_comparison::{ScanComparison, SensorDelay, compare_scans};

#[cfg(test)]
#[path = "../../ingest/src/test_messages.rs"]
mod test_messages;
#[cfg(test)]
mod tests;
