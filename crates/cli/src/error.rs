//! Outcomes and errors of commands.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use portolan::job::JobError;
use portolan::pipeline::PipelineError;
use portolan::trajectory_file::TrajectoryFileError;

use crate::exit::ExitStatus;
use crate::interrupt;

/// Outcome of a command that ran to its end, ordered from best to worst.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// The result is complete.
    Done,
    /// Some of the input could not be used, or some of the result is not connected with the rest.
    DataLost,
    /// The whole result is unreliable; the reason has been printed.
    Untrusted,
}

impl From<Outcome> for ExitStatus {
    fn from(outcome: Outcome) -> Self {
        match outcome {
            Outcome::Done => Self::Done,
            Outcome::DataLost => Self::Loss,
            Outcome::Untrusted => Self::Untrusted,
        }
    }
}

/// Error of a command that failed.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// Wrong usage of the command line.
    #[error("{0}")]
    Usage(String),
    /// Any other error, as a sentence.
    #[error("{0}")]
    Failed(String),
    /// The command ran, but its whole result is unreliable; the reason.
    #[error("{0}")]
    Untrusted(String),
    /// No scan of a recording could be used.
    #[error("{0}")]
    NoScans(String),
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: std::io::Error,
    },
    /// Too little free disk space.
    #[error(transparent)]
    NoRoom(#[from] portolan_atomic_file::NoRoom),
    /// Error of a recording.
    #[error(transparent)]
    Recording(#[from] portolan_recording::RecordingError),
    /// Error of mapping.
    #[error(transparent)]
    Mapper(#[from] portolan_mapping::MapperError),
    /// Results could not be printed.
    #[error("cannot write to the standard output: {0}")]
    Output(#[from] std::io::Error),
}

impl CliError {
    /// Error of a file that cannot be used, with the reason.
    pub fn in_file(path: &Path, reason: impl Display) -> Self {
        Self::Failed(format!("{}: {reason}", path.display()))
    }

    /// Exit status of the program for this error.
    pub fn exit_status(&self) -> ExitStatus {
        match self {
            Self::Usage(_) => ExitStatus::Usage,
            _ if interrupt::interrupted() => ExitStatus::Interrupted,
            Self::Untrusted(_) => ExitStatus::Untrusted,
            Self::Output(e) if e.kind() == std::io::ErrorKind::BrokenPipe => ExitStatus::ClosedPipe,
            _ => ExitStatus::Failed,
        }
    }
}

impl From<portolan_compat::CompatError> for CliError {
    fn from(error: portolan_compat::CompatError) -> Self {
        use portolan_compat::CompatError;
        match error {
            CompatError::Usage(error) => error.into(),
            CompatError::File { path, source } => Self::File { path, source },
            CompatError::Recording(error) => error.into(),
            CompatError::Output(error) => error.into(),
            CompatError::Failed(_) => Self::Failed(error.to_string()),
        }
    }
}

impl From<portolan_compat::FlagError> for CliError {
    fn from(error: portolan_compat::FlagError) -> Self {
        Self::Usage(error.to_string())
    }
}

impl From<portolan_atomic_file::WriteError> for CliError {
    fn from(error: portolan_atomic_file::WriteError) -> Self {
        Self::File { path: error.path, source: error.source }
    }
}

impl From<PipelineError> for CliError {
    fn from(error: PipelineError) -> Self {
        match error {
            PipelineError::Setting(message) => Self::Usage(message),
            PipelineError::NoScans(_) if interrupt::interrupted() => {
                Self::Failed("interrupted before the first scan: nothing was written".to_owned())
            }
            PipelineError::NoScans(_) => Self::NoScans(error.to_string()),
            other => Self::Failed(other.to_string()),
        }
    }
}

impl From<JobError> for CliError {
    fn from(error: JobError) -> Self {
        match error {
            JobError::Pipeline(error) => error.into(),
            JobError::File { path, source } => Self::File { path, source },
            JobError::Setting(_) | JobError::Options(_) => Self::Usage(error.to_string()),
            JobError::PlaneEngineIn2d => {
                Self::Usage("--engine planes is for 3D; 2D scans are matched to grids".to_owned())
            }
            JobError::AmbiguousFrozen => Self::Usage(
                "--frozen=TRAJECTORIES is ambiguous with several maps; freeze all of them, or continue only one"
                    .to_owned(),
            ),
            other => Self::Failed(other.to_string()),
        }
    }
}

impl From<portolan::job::LastPoseError> for CliError {
    fn from(error: portolan::job::LastPoseError) -> Self {
        match error {
            portolan::job::LastPoseError::File { path, source } => Self::File { path, source },
            other => Self::Failed(other.to_string()),
        }
    }
}

impl From<TrajectoryFileError> for CliError {
    fn from(error: TrajectoryFileError) -> Self {
        match error {
            TrajectoryFileError::File { path, source } => Self::File { path, source },
            other => Self::Failed(other.to_string()),
        }
    }
}

impl From<portolan_evaluation::EvaluationError> for CliError {
    fn from(error: portolan_evaluation::EvaluationError) -> Self {
        Self::Failed(error.to_string())
    }
}

impl From<portolan_mapfile::EditError> for CliError {
    fn from(error: portolan_mapfile::EditError) -> Self {
        Self::Failed(error.to_string())
    }
}
