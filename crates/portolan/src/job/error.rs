//! Errors of jobs.

use std::path::{Path, PathBuf};

use portolan_atomic_file::{AtomicFile, NoRoom, WriteError};
use portolan_config::ConfigError;
use portolan_export::PictureError;
use portolan_ingest::IngestError;
use portolan_localization::{KnownMapError, LocalizerError};
use portolan_mapfile::{EditError, MapConversionError, PaintError};
use portolan_pointcloud::CloudError;
use portolan_recording::RecordingError;

use crate::pipeline::PipelineError;

/// Reasons why a job could not be done.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// An error of the recording, or of mapping.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// An option or its value.
    #[error(transparent)]
    Setting(#[from] ConfigError),
    /// Options with invalid values, or values that conflict with each other.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Options(Vec<ConfigError>),
    /// An engine that does not exist in 2D.
    #[error("planes are for mapping in 3D; scans in 2D are matched to grids")]
    PlaneEngineIn2d,
    /// Single trajectories to be frozen of several maps.
    #[error("with several known maps, the numbers of the trajectories to freeze are ambiguous")]
    AmbiguousFrozen,
    /// A known map.
    #[error("{}: {reason}", path.display())]
    KnownMap {
        /// Which.
        path: PathBuf,
        /// The reason.
        reason: MapConversionError,
    },
    /// A known map in which localisation is not possible.
    #[error("{}: {reason}", path.display())]
    UnusableMap {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: KnownMapError,
    },
    /// A landmark that a map does not have.
    #[error("{}: the map has no such landmark; it has {}", path.display(), names(landmarks))]
    NoSuchLandmark {
        /// The map.
        path: PathBuf,
        /// The landmarks that it has.
        landmarks: Vec<String>,
    },
    /// A map without a georeference.
    #[error(
        "{}: the map is not georeferenced, so that satellite fixes give no start pose; map its recording again with \
         --gnss",
        .0.display()
    )]
    NotGeoreferenced(PathBuf),
    /// A recording without satellite fixes, although the user wants to start at one.
    #[error("the recording has no satellite fixes (sensor_msgs/NavSatFix) that could give a start pose")]
    NoFixes,
    /// A map in 3D whose places were to be examined.
    #[error("{}: this map is in 3D; places are examined in 2D only", .0.display())]
    PlacesOf3dMap(PathBuf),
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
    /// Files in the folder of results that an earlier run did not write.
    #[error(
        "{}: would be overwritten, and {}: take another folder, or move what you want to keep and say --force",
        named(folder, files),
        match files.len() {
            1 => format!("was not written by an earlier `portolan {verb}`, or was changed since"),
            _ => format!("were not written by an earlier `portolan {verb}`, or were changed since"),
        }
    )]
    ForeignFiles {
        /// The folder.
        folder: PathBuf,
        /// The verb that would write them.
        verb: &'static str,
        /// Their names.
        files: Vec<String>,
    },
    /// The disk is too full.
    #[error(transparent)]
    NoRoom(#[from] NoRoom),
    /// There is no journal to resume from.
    #[error("{}: there is no run to resume; without --resume mapping starts from the beginning", .0.display())]
    NoJournal(PathBuf),
    /// A journal of another job.
    #[error(
        "{} is the journal of another job: {difference} differ; without --resume mapping starts from the beginning",
        path.display()
    )]
    JournalOfAnother {
        /// Its file.
        path: PathBuf,
        /// What differs.
        difference: String,
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
    /// A file of a cloud.
    #[error("{}: {reason}", path.display())]
    CloudFile {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: CloudError,
    },
    /// A map that cannot be edited.
    #[error("{}: {reason}", path.display())]
    Edit {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: Box<EditError>,
    },
    /// A drawing for the report.
    #[error(transparent)]
    Drawing(std::io::Error),
    /// The assignment of topics to sensors failed.
    #[error(transparent)]
    Ingest(#[from] IngestError),
    /// A recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Scans that were kept for pictures.
    #[error("scans kept on disk cannot be read: {0}")]
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

/// Lists the first of some names.
fn names(all: &[String]) -> String {
    if all.is_empty() {
        return "none".to_owned();
    }
    let more = if all.len() > NAMED { format!(" and {} more", all.len() - NAMED) } else { String::new() };
    format!("{}{more}", all.iter().take(NAMED).cloned().collect::<Vec<_>>().join(", "))
}

/// Maximum number of files that are listed.
const NAMED: usize = 5;

/// Files of a folder, in words.
pub(super) fn named(folder: &Path, files: &[String]) -> String {
    format!("{}: {}", folder.display(), names(files))
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
