//! Errors of programs.

use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

use portolan::assets::AssetsError;
use portolan::trajectory_file::TrajectoryFileError;
use portolan_atomic_file::WriteError;
use portolan_evaluation::EvaluationError;
use portolan_recording::RecordingError;

use crate::flags::FlagError;

/// Error of a program that failed.
#[derive(Debug, thiserror::Error)]
pub enum CompatError {
    /// Wrong flags.
    #[error(transparent)]
    Usage(#[from] FlagError),
    /// Any other error, as a sentence.
    #[error("{0}")]
    Failed(String),
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// Error of a recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Results could not be printed.
    #[error("cannot write to the standard output: {0}")]
    Output(#[from] io::Error),
}

impl CompatError {
    /// Error of a file that cannot be used, with the reason.
    pub(crate) fn in_file(path: &Path, reason: impl Display) -> Self {
        Self::Failed(format!("{}: {reason}", path.display()))
    }
}

impl From<WriteError> for CompatError {
    fn from(error: WriteError) -> Self {
        Self::File { path: error.path, source: error.source }
    }
}

impl From<AssetsError> for CompatError {
    fn from(error: AssetsError) -> Self {
        match error {
            AssetsError::Recording(error) => error.into(),
            other => Self::Failed(other.to_string()),
        }
    }
}

impl From<TrajectoryFileError> for CompatError {
    fn from(error: TrajectoryFileError) -> Self {
        match error {
            TrajectoryFileError::File { path, source } => Self::File { path, source },
            other => Self::Failed(other.to_string()),
        }
    }
}

impl From<EvaluationError> for CompatError {
    fn from(error: EvaluationError) -> Self {
        Self::Failed(error.to_string())
    }
}
