//! Reports events of a job while it works.

use std::fmt;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use portolan_export::PictureError;
use portolan_ingest::Notice;
use portolan_issue::Issue;
use portolan_localization::State;
use portolan_mapfile::PaintError;
use portolan_mapping::TrajectoryId;
use portolan_numeric::counted;

use super::error::named;
use super::map_cloud::CloudResults;
use super::summary::MappingSummary;
use crate::pipeline::PipelineProgress;

/// Receives the events of a job, and stops it with [`ControlFlow::Break`]: results obtained by then are kept.
/// Answers to remarks and to completed steps are ignored.
pub type Observer<'a> = dyn FnMut(&Event) -> ControlFlow<()> + 'a;

/// An event of a job.
#[derive(Debug)]
pub enum Event<'a> {
    /// Progress of mapping the recording.
    Mapping(&'a PipelineProgress),
    /// Map, trajectory, pictures and report are written.
    Written {
        /// Counts and quality of the mapped recording.
        summary: &'a MappingSummary,
        /// The files, in the order in which they were written.
        files: &'a [PathBuf],
        /// Time for loading and mapping, seconds.
        seconds: f64,
    },
    /// Clouds and pictures of them are written.
    CloudsWritten(&'a CloudResults),
    /// Progress of localising the recording.
    Localizing {
        /// Bytes of the recording read.
        position_bytes: u64,
        /// Bytes of the recording.
        total_bytes: u64,
        /// State of the localisation.
        state: State,
    },
    /// Progress of examining the places of a map.
    Examining {
        /// Places that are done.
        done: usize,
        /// Number of places.
        total: usize,
    },
    /// Pictures or clouds are about to be made, or the scans that mapping kept are being drawn.
    Drawing,
    /// The recording is read again, and its points are placed in the map.
    PlacingPoints {
        /// Bytes of the recording read.
        position_bytes: u64,
        /// Bytes of the recording.
        total_bytes: u64,
    },
    /// The second reading has ended.
    PointsPlaced,
    /// A remark for the user.
    Remark(Remark),
}

/// Remarks for the user that are not errors.
#[derive(Debug)]
pub enum Remark {
    /// A choice of sensors, and how to change it.
    Chosen(Notice),
    /// A setting that changes little or nothing.
    LittleEffect {
        /// Path of the option, as the user gave it.
        path: String,
        /// Why.
        why: &'static str,
    },
    /// Something in a known map was repaired or left out.
    KnownMapIssue {
        /// The map.
        path: PathBuf,
        /// The issue.
        issue: Issue,
    },
    /// A known map was loaded.
    KnownMapLoaded {
        /// The map.
        path: PathBuf,
        /// The numbers of its trajectories: in the file, and in the new map.
        trajectories: Vec<(i32, TrajectoryId)>,
    },
    /// There is no `map.png`.
    NoPicture(PictureError),
    /// There is no map for ROS.
    NoRosMap(PaintError),
    /// The map for ROS has larger cells than usual.
    CoarseRosMap {
        /// Size of its cells, metres.
        resolution_metres: f64,
        /// Usual size, metres.
        usual_metres: f64,
    },
    /// Results of an earlier run are reused.
    Resumed {
        /// The journal.
        path: PathBuf,
        /// Results that it holds.
        answers: usize,
        /// Incomplete bytes at its end.
        cut_off: u64,
    },
    /// This run cannot be resumed if it is interrupted.
    NoJournal {
        /// The folder.
        folder: PathBuf,
        /// Why.
        reason: String,
    },
    /// An earlier run did not end; its journal is replaced.
    JournalReplaced(PathBuf),
    /// The journal of a run that was stopped, or failed, stays.
    JournalLeft {
        /// The journal.
        path: PathBuf,
        /// Why it does not hold all results, if so.
        ends_early: Option<String>,
    },
    /// X-rays need the recording again, because scans could not be kept.
    ScansNotKept {
        /// The folder.
        folder: PathBuf,
        /// Why.
        reason: String,
    },
    /// X-rays need the recording again, because scans that were kept cannot be read.
    KeptScansUnreadable(std::io::Error),
    /// No map was written, because its parts would overlap wrongly, or it is not sound.
    NoMap {
        /// Whether the folder holds a map of an earlier run.
        left: bool,
    },
    /// Temporary files of a run that was killed were removed.
    LeftoversRemoved {
        /// The folder.
        folder: PathBuf,
        /// Number of files.
        count: usize,
    },
    /// A temporary file that may still be in use by another program.
    LeftoverKept(PathBuf),
    /// Results of an earlier run that this one did not write were removed.
    EarlierRemoved {
        /// The folder.
        folder: PathBuf,
        /// Their names.
        files: Vec<String>,
    },
    /// Results of an earlier run are still there.
    EarlierLeft {
        /// The folder.
        folder: PathBuf,
        /// Their names.
        files: Vec<String>,
    },
    /// Stopped before the pictures of the map.
    StoppedBeforePictures,
    /// Stopped before the cloud.
    StoppedBeforeClouds,
    /// Stopped before the refined cloud.
    StoppedBeforeRefinedCloud,
    /// Stopped while X-rays were drawn.
    StoppedXrays,
    /// Stopped while the recording was read again.
    StoppedSecondPass,
}

impl fmt::Display for Remark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Chosen(notice) => write!(f, "{} {}", notice.text, notice.change),
            Self::LittleEffect { path, why } => write!(f, "{path} has little effect or none: {why}"),
            Self::KnownMapIssue { path, issue } => {
                write!(f, "{}: repaired: {issue} ({}x)", path.display(), issue.count)
            }
            Self::KnownMapLoaded { path, trajectories } => {
                write!(f, "{}: trajectory {}", path.display(), numbers_of(trajectories))
            }
            Self::NoPicture(error) => write!(f, "no map.png: {error}"),
            Self::NoRosMap(error) => write!(f, "no map.pgm: {error}"),
            Self::CoarseRosMap { resolution_metres, usual_metres } => {
                write!(
                    f,
                    "map.pgm has cells of {resolution_metres} m: with {usual_metres} m it would be too large"
                )
            }
            Self::Resumed { path, answers, cut_off } => write_resumed(f, path, *answers, *cut_off),
            Self::NoJournal { folder, reason } => {
                let folder = folder.display();
                write!(
                    f,
                    "{folder}: no journal ({reason}): if this run is cut off, --resume cannot continue it"
                )
            }
            Self::JournalReplaced(path) => write_journal_replaced(f, path),
            Self::JournalLeft { path, ends_early } => write_journal_left(f, path, ends_early.as_deref()),
            Self::ScansNotKept { folder, reason } => {
                let folder = folder.display();
                write!(
                    f,
                    "scans could not be kept in {folder} ({reason}): X-rays need a second pass over the recording"
                )
            }
            Self::KeptScansUnreadable(error) => {
                write!(
                    f,
                    "scans kept on disk cannot be read ({error}): X-rays need a second pass over the recording"
                )
            }
            Self::NoMap { left: true } => {
                write!(f, "{NO_MAP}; map.pbstream there is of an earlier run")
            }
            Self::NoMap { left: false } => f.write_str(NO_MAP),
            Self::LeftoversRemoved { folder, count } => write_leftovers(f, folder, *count),
            Self::LeftoverKept(path) => {
                write!(f, "{}: if no program is writing this temporary file, remove it", path.display())
            }
            Self::EarlierRemoved { folder, files } => {
                write!(f, "{}: of an earlier run, removed", named(folder, files))
            }
            Self::EarlierLeft { folder, files } => {
                write!(f, "{}: of an earlier run, not of this one", named(folder, files))
            }
            Self::StoppedBeforePictures => f.write_str(
                "stopped: not all pictures were drawn (`portolan render` draws them from the map)",
            ),
            Self::StoppedBeforeClouds => f.write_str("stopped: no cloud and no X-rays were written"),
            Self::StoppedBeforeRefinedCloud => {
                f.write_str("stopped: no cloud and no report.html were written")
            }
            Self::StoppedXrays => f.write_str("stopped: no X-rays were written"),
            Self::StoppedSecondPass => f.write_str("stopped: nothing was written of the second pass"),
        }
    }
}

/// Message of a run without a map.
const NO_MAP: &str = "no map was written, because it could not be trusted";

/// Numbers of trajectories in the new map, with those in the known map where they differ.
fn numbers_of(trajectories: &[(i32, TrajectoryId)]) -> String {
    let number = |(old, new): &(i32, TrajectoryId)| {
        if *old == new.0 as i32 { new.to_string() } else { format!("{old} as {new}") }
    };
    let numbers: Vec<String> = trajectories.iter().map(number).collect();
    numbers.join(", ")
}

fn write_resumed(f: &mut fmt::Formatter<'_>, path: &Path, answers: usize, cut_off: u64) -> fmt::Result {
    write!(f, "{}: {answers} results of an earlier run are used again", path.display())?;
    if cut_off > 0 { write!(f, "; its last {cut_off} bytes are incomplete and were ignored") } else { Ok(()) }
}

fn write_journal_replaced(f: &mut fmt::Formatter<'_>, path: &Path) -> fmt::Result {
    let path = path.display();
    write!(f, "{path} of an earlier run that was cut off is replaced; --resume would go on with it")
}

fn write_journal_left(f: &mut fmt::Formatter<'_>, path: &Path, ends_early: Option<&str>) -> fmt::Result {
    write!(f, "{} is kept: the same command with --resume maps the rest", path.display())?;
    ends_early.map_or(Ok(()), |reason| write!(f, "; it ends early ({reason})"))
}

fn write_leftovers(f: &mut fmt::Formatter<'_>, folder: &Path, count: usize) -> fmt::Result {
    let files = counted(count as u64, "temporary file", "temporary files");
    write!(f, "{}: {files} of a run that was killed removed", folder.display())
}

/// Reports a remark.
pub(super) fn remark(observe: &mut Observer, remark: Remark) {
    // The answer to a remark is ignored.
    let _ = observe(&Event::Remark(remark));
}
