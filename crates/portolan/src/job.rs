//! Makes the results from a recording: a folder with map, trajectory, pictures, report and clouds.
//!
//! [`map`] does all of it. [`Job`] has the steps, for programs that do something between them.
//!
//! | file | what it is |
//! |---|---|
//! | `map.pbstream` | the map: submaps, nodes, constraints; can be continued and localised in ([`KnownMaps`]) |
//! | `trajectory.tum` | pose of the tracking frame in the map for each scan: seconds since 1970, metres, quaternion |
//! | `map.png` | the map from above, with the trajectory and the loop closures |
//! | `map.pgm`, `map.yaml` | the map for ROS's map server, cells of 5 cm |
//! | `map_xray_*.png`, `map_section.png` | maps in 3D from three sides, and a section |
//! | `report.json` | sensors, options, counts, times, degenerate intervals, repairs |
//! | `portolan.json` | which files these are ([`OutputFolder`]): others are not overwritten |

mod change_map;
mod error;
mod event;
mod examine;
mod examined_places;
mod fixes;
mod journal;
mod known_map;
mod last_pose;
mod localisation;
mod localize;
mod localized;
mod map_cloud;
mod memory;
mod output_folder;
mod pictures;
mod read_cloud;
pub mod refine;
pub mod register;
mod report;
mod results;
mod room;
mod saved_map;
mod summary;
mod xray;

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use portolan_atomic_file::{ResultFolder, require_room};
use portolan_config::{Engine, little_effect};
use portolan_geometry::Dimension;
use portolan_ingest::IngestOptions;
use portolan_mapfile::MapFileSpace;
use portolan_mapping::{MapperSettings, Space, Space2d, Space3d};
use portolan_recording::Recording;

/// Version of the keys of `report.json`, of every job.
pub const REPORT_VERSION: u32 = 2;

pub use error::JobError;
pub use event::{Event, Observer, Remark};
pub use examine::{ExaminedMap, PlaceCount, examine_map};
pub use examined_places::Places;
pub use journal::JOURNAL;
use journal::{Identity, Journal, Resumed};
pub use known_map::KnownMaps;
pub use last_pose::{LastPoseError, last_pose};
pub use localisation::{Localisation, Place};
pub use localize::{LocalizeRequest, Start, localize};
pub use localized::{Found, LOCALIZED_FILES, LocalizedRecording, StateCount, write_localized};
pub use map_cloud::{CloudRequest, CloudResults, write_clouds};
pub use memory::resident_and_peak_bytes;
pub use output_folder::{MANIFEST, OutputFolder, Stale};
pub use read_cloud::{ReadCloud, read_cloud, read_cloud_from};
pub use results::{ResultFiles, ResultSpace, add_to_report, write_results};
pub use saved_map::{SaveMap, SavedMap, is_same_file};
pub use summary::MappingSummary;

use crate::RequestedOptions;
use crate::automatic::search_in_known_map;
use crate::known_places::KnownMapSpace;
use crate::pipeline::{
    KnownMap, MappedRecording, PipelineError, PipelineProgress, Preparation, map_recording, prepare,
};

/// A request to map a recording.
#[derive(Clone, Debug)]
pub struct MapRequest {
    /// Folder of the results; made if missing.
    pub folder: PathBuf,
    /// Sensor options of the user; the rest is determined automatically.
    pub ingest: IngestOptions,
    /// Options that the user sets; the rest is chosen from the recording.
    pub requested: RequestedOptions,
    /// Map representation that scans in 3D are matched to; none: as in the options.
    pub engine: Option<Engine>,
    /// Maps that the recording is added to.
    pub known: KnownMaps,
    /// Whether map and clouds are written even if the recording was not found in the known maps or the map is
    /// not sound, and even over files that no earlier run wrote.
    pub force: bool,
    /// Clouds and pictures of them.
    pub cloud: CloudRequest,
    /// Whether the trajectory with the times of the map is written, too (`all_poses.tum`).
    pub all_poses: bool,
    /// Whether to resume an earlier run that was interrupted ([`JOURNAL`]).
    pub resume: bool,
    /// Number of threads; 0 for as many as there are cores, but not more than options allow. Results do not
    /// depend on it.
    pub threads: usize,
}

impl MapRequest {
    /// The usual results, with automatic options.
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: folder.into(),
            ingest: IngestOptions::default(),
            requested: RequestedOptions::default(),
            engine: None,
            known: KnownMaps::default(),
            force: false,
            cloud: CloudRequest::default(),
            all_poses: false,
            resume: false,
            threads: 0,
        }
    }
}

/// Results of mapping a recording.
#[derive(Clone, Debug)]
pub struct Finished {
    /// The files, in the order in which they were written. If the map is refused
    /// ([`MappingSummary::is_refused`]) it is not among them, unless it was forced.
    pub files: Vec<PathBuf>,
    /// Counts and quality of the mapped recording.
    pub summary: MappingSummary,
}

/// Maps a recording and writes the results to the folder of the request. `observe` receives the events.
///
/// # Errors
/// Fails if the recording has nothing that can be mapped, options or known maps are invalid, or a file cannot
/// be written.
pub fn map(
    recording: &dyn Recording,
    request: MapRequest,
    observe: &mut Observer,
) -> Result<Finished, JobError> {
    request.cloud.check()?;
    let folder =
        ResultFolder::make(&request.folder).map_err(|source| JobError::file(&request.folder, source))?;
    let _made = [request.cloud.make_room()?, folder];
    let mut request = request;
    request.requested.configure(&mut request.ingest)?;
    let mut job = Job::prepare(recording, request, observe)?;
    job.keep_journal(observe)?;
    job.run(observe)
}

/// A recording about to be mapped, and the steps to its results.
pub struct Job<'a> {
    recording: &'a dyn Recording,
    request: MapRequest,
    preparation: Preparation,
    folder: OutputFolder,
    journal: Option<Journal>,
}

/// The verb recorded for these results.
const MAP: &str = "map";
/// The files that a job may write, depending on the recording and on the request; clouds have names of their
/// own.
const FILES: [&str; 11] = [
    "map.pbstream",
    "trajectory.tum",
    "all_poses.tum",
    "map.png",
    "map.pgm",
    "map.yaml",
    "map_xray_top.png",
    "map_xray_front.png",
    "map_xray_side.png",
    "map_section.png",
    "report.json",
];

impl<'a> Job<'a> {
    /// Surveys a recording, reports the choices, and changes the options as requested. What the options
    /// determine about the sensors has to be in `request.ingest` already ([`RequestedOptions::configure`]).
    ///
    /// # Errors
    /// Fails if the folder has files that would be lost, nothing in the recording can be mapped, or options
    /// are invalid.
    pub fn prepare(
        recording: &'a dyn Recording,
        request: MapRequest,
        observe: &mut Observer,
    ) -> Result<Self, JobError> {
        let folder = OutputFolder::begin(&request.folder, MAP, &FILES, request.force, observe)?;
        Self::prepare_in(folder, recording, request, observe)
    }

    /// As [`Job::prepare`] for a folder that the caller manages.
    fn prepare_in(
        folder: OutputFolder,
        recording: &'a dyn Recording,
        request: MapRequest,
        observe: &mut Observer,
    ) -> Result<Self, JobError> {
        let configuration = request.requested.configuration.clone();
        let is_configured = configuration.is_some();
        require_room(&request.folder, needed_room(recording, &request))?;
        let mut preparation = prepare(recording, &request.ingest, configuration)?;
        for notice in &preparation.plan.notices {
            event::remark(observe, Remark::Chosen(notice.clone()));
        }
        if !request.known.files.is_empty() && !is_configured {
            search_in_known_map(&mut preparation.options, request.known.count_submaps()?);
        }
        choose_engine(&mut preparation, request.engine)?;
        change_options(&mut preparation, &request.requested.settings, observe)?;
        preparation.background_threads = request.requested.background_threads();
        request.cloud.keep_scans(&mut preparation, &request.folder);
        preparation.spool_in = Some(request.folder.clone());
        Ok(Self { recording, request, preparation, folder, journal: None })
    }

    /// Keeps a journal in the folder of results while mapping, so that an interrupted run can be resumed;
    /// resumes one if requested.
    ///
    /// # Errors
    /// There is nothing to resume, or it is of another job; a known map cannot be read.
    pub fn keep_journal(&mut self, observe: &mut Observer) -> Result<(), JobError> {
        let identity = Identity::of(self.recording, &self.request, &self.preparation)?;
        let folder = &self.request.folder;
        let reserve = needed_room(self.recording, &self.request);
        let path = folder.join(JOURNAL);
        let journal = if self.request.resume {
            let (journal, Resumed { answers, cut_off }) = Journal::resume(folder, &identity, reserve)?;
            event::remark(observe, Remark::Resumed { path, answers, cut_off });
            journal
        } else {
            if path.is_file() {
                event::remark(observe, Remark::JournalReplaced(path));
            }
            Journal::begin(folder, &identity, reserve)
        };
        self.preparation.memory = journal.memory();
        self.journal = Some(journal);
        Ok(())
    }

    /// To be called once all results are written. Files that an earlier run left in the folder and this one
    /// did not write are removed, or reported if this one was stopped or has no map. The journal is removed,
    /// or stays if mapping was stopped, so that the rest can be mapped.
    ///
    /// # Errors
    /// The folder cannot be written to.
    pub fn end<S: Space>(&self, mapped: &MappedRecording<S>, observe: &mut Observer) -> Result<(), JobError> {
        let was_stopped = mapped.interrupted || observe(&Event::Drawing).is_break();
        let stale = if was_stopped || !self.is_wanted(mapped) { Stale::Name } else { Stale::Remove };
        self.folder.finish(stale, &self.request.known.files, observe)?;
        self.end_journal(mapped.interrupted, observe);
        Ok(())
    }

    /// Closes the journal, which stays if the rest can be mapped with it.
    fn end_journal(&self, is_kept: bool, observe: &mut Observer) {
        let Some(journal) = &self.journal else { return };
        let (file, written) = journal.close();
        let reason = written.err().map(|error| error.to_string());
        match (file, reason) {
            (Some(path), reason) if is_kept => {
                event::remark(observe, Remark::JournalLeft { path, ends_early: reason });
            }
            (file, reason) => {
                if let Some(reason) = reason {
                    let folder = self.request.folder.clone();
                    event::remark(observe, Remark::NoJournal { folder, reason });
                }
                // It is no longer needed; if it cannot be removed that does no harm.
                file.map_or(Ok(()), std::fs::remove_file).unwrap_or_default();
            }
        }
    }

    /// What is mapped, and with which options.
    pub fn preparation(&self) -> &Preparation {
        &self.preparation
    }

    /// Loads the maps that the recording is added to.
    ///
    /// # Errors
    /// As [`KnownMaps::load`].
    pub fn load_known<S: MapFileSpace>(&self, observe: &mut Observer) -> Result<KnownMap<S>, JobError> {
        self.request.known.load(&self.preparation.options, observe)
    }

    /// Maps the recording, and checks the result.
    ///
    /// # Errors
    /// Fails if the recording cannot be read or holds no usable scan.
    pub fn map<S: MapFileSpace + KnownMapSpace>(
        &self,
        known: KnownMap<S>,
        observe: &mut Observer,
    ) -> Result<MappedRecording<S>, JobError> {
        let threads = thread_count(self.request.threads, self.preparation.background_threads);
        let settings = MapperSettings { threads, ..MapperSettings::default() };
        let mut progress = |state: &PipelineProgress| observe(&Event::Mapping(state)).is_continue();
        let (ingest, preparation) = (&self.request.ingest, self.preparation.clone());
        let mapped = map_recording(self.recording, ingest, preparation, known, settings, &mut progress);
        if let Err(PipelineError::NoScans(_)) = mapped {
            // There would be nothing to resume.
            self.end_journal(false, observe);
        }
        let mut mapped = mapped?;
        mapped.judge()?;
        Ok(mapped)
    }

    /// Writes everything but clouds and pictures of them; returns the files. `seconds` is the time of loading
    /// and mapping.
    ///
    /// # Errors
    /// Fails if something cannot be written.
    pub fn write_results<S: ResultSpace>(
        &self,
        mapped: &MappedRecording<S>,
        seconds: f64,
        observe: &mut Observer,
    ) -> Result<Vec<PathBuf>, JobError> {
        let what = ResultFiles { map: self.is_wanted(mapped), all_poses: self.request.all_poses };
        write_results(mapped, &self.folder, seconds, what, observe)
    }

    /// Whether the result can be used, or is requested nevertheless.
    fn is_wanted<S: Space>(&self, mapped: &MappedRecording<S>) -> bool {
        let is_found = Localisation::of(mapped).is_none_or(|found| !found.is_refused());
        self.request.force || is_found && mapped.is_sound()
    }

    /// Writes the requested clouds and pictures of them, and adds to the report written by
    /// [`Job::write_results`].
    ///
    /// # Errors
    /// Fails if the recording cannot be read again, or something cannot be written.
    pub fn write_clouds<S: Space>(
        &self,
        mapped: &MappedRecording<S>,
        observe: &mut Observer,
    ) -> Result<Option<CloudResults>, JobError> {
        let (MapRequest { ingest, cloud, .. }, folder) = (&self.request, &self.folder);
        if !self.is_wanted(mapped) {
            return Ok(None);
        }
        let clouds = write_clouds(self.recording, ingest, &self.preparation, mapped, cloud, folder, observe)?;
        if let Some(clouds) = &clouds {
            add_to_report(folder, "cloud", &clouds.report)?;
        }
        Ok(clouds)
    }

    /// All steps: loads known maps, maps, writes the results and clouds. If one fails, a remark reports
    /// whether the journal holds the results of the others.
    ///
    /// # Errors
    /// As the steps.
    pub fn run(&self, observe: &mut Observer) -> Result<Finished, JobError> {
        let finished = match self.preparation.dimension {
            Dimension::TwoD => self.run_in::<Space2d>(observe),
            Dimension::ThreeD => self.run_in::<Space3d>(observe),
        };
        if finished.is_err() {
            self.end_journal(true, observe);
        }
        finished
    }

    fn run_in<S: ResultSpace>(&self, observe: &mut Observer) -> Result<Finished, JobError> {
        let start = Instant::now();
        let known = self.load_known::<S>(observe)?;
        let mapped = self.map(known, observe)?;
        let seconds = start.elapsed().as_secs_f64();
        let mut files = self.write_results(&mapped, seconds, observe)?;
        let summary = MappingSummary::of(&mapped);
        // Written files stay, whatever the observer answers.
        let _ = observe(&Event::Written { summary: &summary, files: &files, seconds });
        if let Some(clouds) = self.write_clouds(&mapped, observe)? {
            let _ = observe(&Event::CloudsWritten(&clouds));
            files.extend(clouds.files);
        }
        self.end(&mapped, observe)?;
        Ok(Finished { files, summary })
    }
}

/// Minimum size of the results, bytes.
fn needed_room(recording: &dyn Recording, request: &MapRequest) -> u64 {
    let with_cloud = request.cloud.file.is_some() && request.cloud.voxel_size_metres.is_none();
    room::needed(recording.size_bytes(), with_cloud)
}

/// Continues always: for [`map`] without an observer.
pub fn unobserved(_: &Event) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Number of threads: the requested one, otherwise the number of cores, but not more than options allow.
fn thread_count(asked: usize, most: Option<usize>) -> usize {
    let cores = || std::thread::available_parallelism().map_or(2, std::num::NonZero::get);
    match (asked, most) {
        (0, Some(most)) => cores().min(most),
        (0, None) => cores(),
        (asked, _) => asked,
    }
}

fn choose_engine(preparation: &mut Preparation, engine: Option<Engine>) -> Result<(), JobError> {
    let Some(engine) = engine else { return Ok(()) };
    if preparation.dimension == Dimension::TwoD && engine == Engine::Planes {
        return Err(JobError::PlaneEngineIn2d);
    }
    preparation.options.set_engine(engine);
    Ok(())
}

fn change_options(
    preparation: &mut Preparation,
    settings: &[String],
    observe: &mut Observer,
) -> Result<(), JobError> {
    for setting in settings {
        preparation.options.set(setting)?;
    }
    for path in settings.iter().filter_map(|setting| setting.split_once('=')).map(|(path, _)| path) {
        if let Some(why) = little_effect(path, &preparation.options, preparation.plan.imu.is_some()) {
            event::remark(observe, Remark::LittleEffect { path: path.to_owned(), why });
        }
    }
    preparation.options.validate().map_err(JobError::Options)
}
