//! Data and results of `register`: scans in memory, whether their registration can be trusted, and a folder
//! with poses, the joined cloud, pictures and a report.

mod results;
mod scans;
mod trust;

pub use results::{
    History, RegisterReport, Registered, Registration, describe, registered_files, report, write_registration,
};
pub use scans::{PointLimits, ScanSource, Scans};
pub use trust::reason_for_distrust;
