#![doc = include_str!("../README.md")]

mod assets;
mod bags;
mod configuration;
mod error;
mod flags;
mod metrics;
mod pbstream;
mod ros_map;
mod trajectories;

use std::io::Write;
use std::path::Path;

use portolan_atomic_file::AtomicFile;

pub use assets::assets_writer;
pub use bags::{rosbag_validate, trajectory_comparison};
pub use configuration::print_configuration;
pub use error::CompatError;
pub use flags::{FlagError, Flags, KnownFlags};
pub use metrics::compute_relations_metrics;
pub use pbstream::pbstream;
pub use ros_map::pbstream_to_ros_map;
pub use trajectories::pbstream_trajectories_to_rosbag;

/// Output of a program: results, and messages about its progress.
pub trait Console {
    /// Prints a result; a line feed is appended unless it ends with one.
    ///
    /// # Errors
    /// If nothing can be printed.
    fn print(&mut self, text: &str) -> std::io::Result<()>;

    /// Prints a message about progress.
    fn info(&mut self, text: &str);

    /// Prints a warning.
    fn warning(&mut self, text: &str);
}

/// Outcome of a program that ran to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Completeness {
    /// All input was used.
    Complete,
    /// Some of the input could not be used.
    WithLoss,
}

/// Main function of a program.
pub type Run = fn(&[String], &mut dyn Console) -> Result<Completeness, CompatError>;

/// Writes a file that appears under its name only when it is complete.
fn write_file(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<(), CompatError> {
    let mut file = AtomicFile::create(path)?;
    match write(&mut file) {
        Ok(()) => Ok(file.commit()?),
        Err(source) => Err(file.error(source).into()),
    }
}
