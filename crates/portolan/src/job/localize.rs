//! Localises a recording in a saved map, scan by scan, and adds it to the map if requested.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use portolan_geometry::{Dimension, NearFrame};
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_issue::IssueLog;
use portolan_localization::{
    Estimate, Jumps, KnownMap, KnownMap2d, KnownMap3d, KnownMapError, Localizer, LocalizerSettings,
    StartPose, State,
};
use portolan_mapfile::{
    FrozenTrajectories, MapFileSpace, PlacedTexture, submap_textures_2d, submap_textures_3d,
};
use portolan_mapping::{Map, Space, Space2d, Space3d};
use portolan_optimization::LandmarkNode;
use portolan_recording::Recording;
use portolan_sensor::{Measurement, SensorId};
use portolan_spool::Spool;

use super::error::JobError;
use super::event::{Event, Observer};
use super::fixes::FixesInMap;
use super::known_map::KnownMaps;
use super::localized::LocalizedRecording;
use super::saved_map::{KnownFile, SaveMap, SavedMap};
use super::{Job, MapRequest, OutputFolder};
use crate::RequestedOptions;
use crate::pipeline::{KnownMap as LoadedGraph, PipelineError, Preparation};
use crate::silence::Silences;
use crate::unusable_scans::ScanTally;

/// Start of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum Start {
    /// At this pose.
    At(StartPose),
    /// At a landmark of the map.
    Landmark {
        /// Its name.
        name: String,
        /// Standard deviation of the position along each axis, metres.
        sigma_metres: f64,
        /// Standard deviation of the heading relative to that of the landmark, radians; π if the heading is
        /// unknown.
        sigma_radians: f64,
    },
    /// At its satellite fixes, in a map that was made with fixes.
    Fixes,
    /// Unknown: the pose is searched in the whole map, even if there are fixes.
    Unknown,
}

impl Start {
    /// The given start, if any, in a near frame, in which the landmarks are given as well. If the landmark
    /// does not exist, the names of all landmarks.
    fn in_frame(
        &self,
        landmarks: &BTreeMap<String, LandmarkNode>,
        frame: &NearFrame,
    ) -> Result<Option<StartPose>, Vec<String>> {
        match self {
            Self::At(pose) => Ok(Some(pose.near(frame))),
            Self::Fixes | Self::Unknown => Ok(None),
            Self::Landmark { name, sigma_metres, sigma_radians } => {
                let (sigma_metres, sigma_radians) = (*sigma_metres, *sigma_radians);
                let pose = landmarks.get(name).and_then(|landmark| landmark.map_from_landmark);
                pose.map(|map_from_tracking| StartPose { map_from_tracking, sigma_metres, sigma_radians })
                    .map(Some)
                    .ok_or_else(|| landmarks.keys().cloned().collect())
            }
        }
    }
}

/// A request to localise a recording in a map.
#[derive(Clone, Debug)]
pub struct LocalizeRequest {
    /// The map (`.pbstream`).
    pub map: PathBuf,
    /// Folder of the results.
    pub folder: PathBuf,
    /// Sensor options of the user; the rest is determined automatically.
    pub ingest: IngestOptions,
    /// Options that the user sets; the rest is chosen from the recording.
    pub requested: RequestedOptions,
    /// Start of the recording, if given. Without it, the recording is searched at its satellite fixes, if the
    /// map was made with fixes, too; otherwise in the whole map.
    pub start: Option<Start>,
    /// How a consumer of the poses takes in corrections, if `driver.tum` is wanted.
    pub jumps: Option<Jumps>,
    /// Request to save the known map with this recording.
    pub save_map: Option<SaveMap>,
    /// Number of threads; 0 for as many as there are cores. Results do not depend on it.
    pub threads: usize,
}

/// Localises a recording in a map. `observe` receives the progress and may stop the work.
///
/// # Errors
/// A map that is damaged, empty or of the other dimension, or has no landmark of the given name; a recording
/// that cannot be read or has no usable scan; invalid options; a map that cannot be renewed or written.
pub fn localize(
    recording: &dyn Recording,
    request: &LocalizeRequest,
    observe: &mut Observer,
) -> Result<LocalizedRecording, JobError> {
    let how = MapRequest {
        ingest: request.ingest.clone(),
        requested: request.requested.clone(),
        ..MapRequest::new(&request.folder)
    };
    // Nothing is written to it here.
    let folder = OutputFolder::begin::<&str>(&request.folder, "localize", &[], false, observe)?;
    let job = Job::prepare_in(folder, recording, how, observe)?;
    request.save_map.as_ref().map_or(Ok(()), SaveMap::check)?;
    match job.preparation().dimension {
        Dimension::TwoD => {
            let known = load::<Space2d>(request, job.preparation(), observe)?;
            let map = KnownMap2d::new(known.graph.state()).map_err(|reason| unusable(request, reason))?;
            let map = textured(map, known, submap_textures_2d, job.preparation());
            localize_in(map, recording, request, job.preparation(), observe)
        }
        Dimension::ThreeD => {
            let known = load::<Space3d>(request, job.preparation(), observe)?;
            let map = KnownMap3d::new(known.graph.state()).map_err(|reason| unusable(request, reason))?;
            let map = textured(map, known, submap_textures_3d, job.preparation());
            localize_in(map, recording, request, job.preparation(), observe)
        }
    }
}

/// Localises a recording in a loaded map.
fn localize_in<M: KnownMap<Space: MapFileSpace>>(
    loaded: LoadedMap<M>,
    recording: &dyn Recording,
    request: &LocalizeRequest,
    preparation: &Preparation,
    observe: &mut Observer,
) -> Result<LocalizedRecording, JobError> {
    let LoadedMap { map, graph, frame, textures, mut issues } = loaded;
    let start = start(request, &graph, &frame)?;
    let mut plan = preparation.plan.clone();
    let fixes = FixesInMap::of(request, &graph, preparation.inventory(), &mut plan)?;
    let ingestion = Ingestion::with_plan(recording, preparation.inventory(), plan.clone(), &request.ingest)
        .map_err(PipelineError::from)?;
    let sensors: BTreeSet<SensorId> = ingestion.sensors().into_iter().collect();
    let localizer = localizer(map, request, preparation, &sensors, start)?;
    let mut run = Run {
        ingestion,
        fixes,
        localizer,
        frame,
        estimates: Spool::in_folder(existing(&request.folder)),
        silences: Silences::default(),
        tally: ScanTally::default(),
        interrupted: false,
    };
    run.read(observe)?;
    let saved_map = match &request.save_map {
        Some(wanted) => Some(run.save_map(
            wanted,
            KnownFile { path: &request.map, map: graph, frame },
            &request.folder,
        )?),
        None => None,
    };
    run.add_issues(&mut issues);
    if let Some(SavedMap::Unsound(found)) = &saved_map {
        issues.append(found);
    }
    let localizer = run.localizer;
    Ok(LocalizedRecording {
        estimates: run.estimates,
        dimension: preparation.dimension,
        plan,
        start: start.or_else(|| localizer.searched_start()).map(|start| start.in_map(&frame)),
        starts_at_fix: start.is_none() && localizer.searched_start().is_some(),
        jumps: request.jumps,
        start_agrees: localizer.start_agrees(),
        changes: localizer.changes().into_iter().map(|change| change.in_map(&frame)).collect(),
        issues,
        recorded_times: run.ingestion.recorded_times().clone(),
        textures,
        saved_map,
        interrupted: run.interrupted,
    })
}

/// The localizer for the map.
fn localizer<M: KnownMap>(
    map: M,
    request: &LocalizeRequest,
    preparation: &Preparation,
    sensors: &BTreeSet<SensorId>,
    start: Option<StartPose>,
) -> Result<Localizer<M>, JobError> {
    let settings =
        LocalizerSettings { start, threads: request.threads, keeps_track: request.save_map.is_some() };
    // The map contains the far walls; the local track inserts only the hits of beams.
    let mut options = preparation.options.clone();
    options.portolan.join_surfaces = false;
    Ok(Localizer::new(map, &options, sensors, &settings)?)
}

/// A localizer reading a recording, and its results so far.
struct Run<M: KnownMap> {
    ingestion: Ingestion,
    fixes: Option<FixesInMap>,
    localizer: Localizer<M>,
    frame: NearFrame,
    /// In the frame of the map.
    estimates: Spool<Estimate>,
    silences: Silences,
    tally: ScanTally,
    interrupted: bool,
}

impl<M: KnownMap<Space: MapFileSpace>> Run<M> {
    /// Reads to the end, or until the observer stops it.
    fn read(&mut self, observe: &mut Observer) -> Result<(), JobError> {
        while let Some((sensor_id, measurement)) =
            self.ingestion.next_measurement().map_err(PipelineError::from)?
        {
            self.add(&sensor_id, measurement);
            let (position_bytes, total_bytes) = self.ingestion.progress();
            let state = self.estimates.last().map_or(State::Searching, |e| e.state);
            if observe(&Event::Localizing { position_bytes, total_bytes, state }).is_break() {
                self.interrupted = true;
                break;
            }
        }
        let last = self.localizer.finish().into_iter();
        last.for_each(|estimate| self.estimates.push(estimate.in_map(&self.frame)));
        if self.estimates.is_empty() {
            let verdict = std::mem::take(&mut self.tally).verdict(&self.localizer.issues());
            return Err(PipelineError::NoScans(Box::new(verdict)).into());
        }
        Ok(())
    }

    fn add(&mut self, sensor_id: &SensorId, measurement: Measurement) {
        self.silences.add(sensor_id, measurement.time());
        self.tally.add(&measurement);
        if let Some(fix) = self.fixes.as_ref().and_then(|fixes| fixes.newest(&self.ingestion, &measurement)) {
            self.localizer.add_fix(fix);
        }
        let known = self.localizer.add(sensor_id, measurement).into_iter();
        known.for_each(|estimate| self.estimates.push(estimate.in_map(&self.frame)));
    }

    /// Extends the known map by the recording, and writes it, unless the reading was stopped.
    fn save_map(
        &mut self,
        wanted: &SaveMap,
        known: KnownFile<'_, M::Space>,
        folder: &Path,
    ) -> Result<SavedMap, JobError> {
        if self.interrupted {
            return Ok(SavedMap::Interrupted);
        }
        let estimates: Vec<Estimate> = self.estimates.iter().collect();
        self.estimates.whole().map_err(|source| JobError::file(folder, source))?;
        wanted.save(known, &mut self.localizer, self.ingestion.sensors(), &estimates)
    }

    /// Adds repairs and losses.
    fn add_issues(&self, issues: &mut IssueLog) {
        issues.merge(&self.ingestion.issues());
        if !self.interrupted {
            issues.merge(&self.silences.issues());
        }
        issues.append(&self.localizer.issues());
    }
}

/// A folder, or, if it does not exist yet, its nearest existing parent.
fn existing(folder: &Path) -> &Path {
    folder.ancestors().find(|folder| folder.is_dir()).unwrap_or(Path::new("."))
}

/// A map for the localizer, its pictures, and the issues of its file.
struct LoadedMap<M: KnownMap> {
    map: M,
    /// The map as loaded, in the near frame.
    graph: Map<M::Space>,
    frame: NearFrame,
    /// In the frame of the map.
    textures: Vec<PlacedTexture>,
    issues: IssueLog,
}

fn load<S: MapFileSpace>(
    request: &LocalizeRequest,
    preparation: &Preparation,
    observe: &mut Observer,
) -> Result<LoadedGraph<S>, JobError> {
    let known = KnownMaps { files: vec![request.map.clone()], frozen: FrozenTrajectories::All, start: None };
    known.load(&preparation.options, observe)
}

fn unusable(request: &LocalizeRequest, reason: KnownMapError) -> JobError {
    JobError::UnusableMap { path: request.map.clone(), reason }
}

/// The start in the near frame.
fn start<S: Space>(
    request: &LocalizeRequest,
    map: &Map<S>,
    frame: &NearFrame,
) -> Result<Option<StartPose>, JobError> {
    let Some(start) = &request.start else { return Ok(None) };
    let no_such = |landmarks| JobError::NoSuchLandmark { path: request.map.clone(), landmarks };
    start.in_frame(&map.graph.problem().landmarks, frame).map_err(no_such)
}

fn textured<M: KnownMap>(
    map: M,
    known: LoadedGraph<M::Space>,
    textures: fn(&Map<M::Space>) -> Vec<PlacedTexture>,
    preparation: &Preparation,
) -> LoadedMap<M> {
    let graph = Map::new(preparation.options.clone(), known.graph, known.trajectories);
    let mut textures = textures(&graph);
    for texture in &mut textures {
        texture.map_from_submap = known.frame.in_map(&texture.map_from_submap);
    }
    LoadedMap { map, graph, frame: known.frame, textures, issues: known.issues }
}
