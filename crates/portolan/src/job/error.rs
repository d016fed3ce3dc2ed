//! Why a job could not be done.

use std::path::{Path, PathBuf};

use portolan_atomic_file::{AtomicFile, WriteError};
use portolan_config::ConfigError;
use portolan_export::PictureError;
use portolan_localization::{KnownMapError, LocalizerError};
use portolan_mapfile::{MapConversionError, PaintError};
use portolan_pointcloud::CloudError;

use crate::pipeline::PipelineError;

/// Why a job could not be done.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// The recording, or mapping.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// An option or its value.
    #[error(transparent)]
    Setting(#[from] ConfigError),
    /// Options with values that they cannot have, or that do not fit each other.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Options(Vec<ConfigError>),
    /// An engine that is not there in 2D.
    #[error("planes are for mapping in 3D; scans in 2D are matched to grids")]
    PlanesInThePlane,
    /// Single trajectories to be frozen of several maps.
    #[error("single trajectories to be frozen do not tell which of the known maps they are of")]
    AmbiguousFrozen,
    /// A known map.
    #[error("{}: {reason}", path.display())]
    KnownMap {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: MapConversionError,
    },
    /// A known map in which nothing can be found.
    #[error("{}: {reason}", path.display())]
    UnusableMap {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: KnownMapError,
    },
    /// Localisation could not begin.
    #[error(transparent)]
    Localizer(#[from] LocalizerError),
    /// A file or folder.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The disk is too full.
    #[error(
        "{}: only {:.1} MB are free, and the results need at least {:.1} MB",
        folder.display(),
        *free as f64 / 1048576.0,
        *needed as f64 / 1048576.0
    )]
    NoRoom {
        /// Where the results should go.
        folder: PathBuf,
        /// Bytes that are free there.
        free: u64,
        /// Bytes that the results need at the very least.
        needed: u64,
    },
    /// A file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
    /// The map could not be written.
    #[error(transparent)]
    Map(#[from] MapConversionError),
    /// A picture.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// The map for ROS.
    #[error(transparent)]
    Paint(#[from] PaintError),
    /// A cloud.
    #[error(transparent)]
    Cloud(#[from] CloudError),
    /// Scans that were kept for pictures.
    #[error("scans that were kept cannot be read: {0}")]
    KeptScans(std::io::Error),
    /// The report could not be made.
    #[error(transparent)]
    Report(#[from] serde_json::Error),
    /// The report could not be read.
    #[error("{}: {reason}", path.display())]
    UnreadableReport {
        /// Its file.
        path: PathBuf,
        /// Why.
        reason: serde_json::Error,
    },
}

impl JobError {
    pub(super) fn file(path: &Path, source: std::io::Error) -> Self {
        Self::File { path: path.to_owned(), source }
    }
}

/// Writes a file that appears under its name only when it is complete.
pub(super) fn write_file(path: &Path, content: &[u8]) -> Result<(), JobError> {
    use std::io::Write;
    let written = AtomicFile::create(path).and_then(|mut file| match file.write_all(content) {
        Ok(()) => file.commit(),
        Err(source) => Err(file.error(source)),
    });
    written.map_err(|error| JobError::File { path: error.path, source: error.source })
}
