//! Errors of a pipeline.

use portolan_atomic_file::WriteError;
use portolan_config::ConfigError;
use portolan_grids::{GridError, InserterOptionError};

/// Why a pipeline cannot be built or fails.
#[derive(Debug, thiserror::Error)]
pub enum PointsError {
    /// An option is missing, not used or of the wrong type.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// An unknown stage.
    #[error("there is no stage \"{action}\"; there are: {known}")]
    UnknownAction {
        /// Name asked for.
        action: String,
        /// Names of all stages.
        known: String,
    },
    /// An invalid value of an option.
    #[error("stage {action}: {reason}")]
    Setting {
        /// The stage.
        action: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// A stage that writes files comes before one that needs all points several times.
    #[error("{0} must be configured to occur after any stages that require multiple passes.")]
    Order(&'static str),
    /// A batch lacks values that the file has.
    #[error(
        "{path}: its first points have {what}, these have not; filter by frame_id_filter, or colour all points"
    )]
    Missing {
        /// The file.
        path: String,
        /// `colours` or `intensities`.
        what: &'static str,
    },
    /// A picture or voxel map would take too much memory.
    #[error("stage {action}: {reason}; choose a larger voxel or filter by range")]
    TooLarge {
        /// The stage.
        action: &'static str,
        /// What is too large.
        reason: String,
    },
    /// The floors of a building cannot be distinguished.
    #[error("separate_floors: {0}")]
    Floors(&'static str),
    /// Points cannot be inserted into a grid.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// A grid cannot be built with its options.
    #[error("range_data_inserter: {0}")]
    Inserter(#[from] InserterOptionError),
    /// A file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}
