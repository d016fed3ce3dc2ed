//! Finding a recording in a saved map, scan by scan; nothing of the map changes.

use std::collections::BTreeSet;
use std::path::PathBuf;

use portolan_config::Options;
use portolan_geometry::Dimension;
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_issue::IssueLog;
use portolan_localization::{Estimate, Localizer, LocalizerSettings, PlanarMap, StartPose, State};
use portolan_mapfile::{FrozenTrajectories, PlacedTexture, submap_textures_2d};
use portolan_mapping::{Map, Planar};
use portolan_recording::Recording;
use portolan_sensor::SensorId;

use super::error::JobError;
use super::event::{Event, Observer};
use super::known_map::KnownMaps;
use super::localized::LocalizedRecording;
use super::{Job, MapRequest};
use crate::RequestedOptions;
use crate::pipeline::PipelineError;
use crate::silence::Silences;

/// What is to be found where.
#[derive(Clone, Debug)]
pub struct LocalizeRequest {
    /// The map (`.pbstream`).
    pub map: PathBuf,
    /// Where the results go.
    pub folder: PathBuf,
    /// What is said of the sensors; the rest is found out.
    pub ingest: IngestOptions,
    /// Options that are asked for; the rest is chosen from the recording.
    pub requested: RequestedOptions,
    /// Where the recording starts, as far as somebody knows.
    pub start: Option<StartPose>,
    /// Threads; 0 for as many as there are cores. Results do not depend on it.
    pub threads: usize,
}

/// Finds a recording in a map. `observe` is told how far it is and may stop it.
///
/// # Errors
/// A map that is damaged, empty or in 3D; a recording that cannot be read, is in 3D or has not a single scan that can
/// be used; options that are not possible.
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
    let job = Job::prepare(recording, how, observe)?;
    let preparation = job.preparation();
    if preparation.dimension == Dimension::Three {
        return Err(JobError::LocalizationInSpace("the recording"));
    }
    let LoadedMap { planar, textures, mut issues } = load(request, &preparation.options, observe)?;
    let mut ingestion =
        Ingestion::with_plan(recording, preparation.inventory(), preparation.plan.clone(), &request.ingest)
            .map_err(PipelineError::from)?;
    let sensors: BTreeSet<SensorId> = ingestion.sensors().into_iter().collect();
    let settings = LocalizerSettings { start: request.start, threads: request.threads };
    let mut localizer = Localizer::new(planar, &preparation.options, &sensors, &settings)?;
    let mut estimates: Vec<Estimate> = Vec::new();
    let mut silences = Silences::default();
    let mut interrupted = false;
    while let Some((sensor_id, measurement)) = ingestion.next_measurement().map_err(PipelineError::from)? {
        silences.add(&sensor_id, measurement.time());
        estimates.extend(localizer.add(&sensor_id, measurement));
        let (position_bytes, total_bytes) = ingestion.progress();
        let state = estimates.last().map_or(State::Searching, |e| e.state);
        if observe(&Event::Localizing { position_bytes, total_bytes, state }).is_break() {
            interrupted = true;
            break;
        }
    }
    estimates.extend(localizer.finish());
    if estimates.is_empty() {
        return Err(PipelineError::NoScans.into());
    }
    issues.merge(&ingestion.issues());
    if !interrupted {
        issues.merge(&silences.issues());
    }
    issues.append(&localizer.issues());
    Ok(LocalizedRecording {
        estimates,
        plan: preparation.plan.clone(),
        start: request.start,
        start_agrees: localizer.start_agrees(),
        issues,
        recorded_times: ingestion.recorded_times().clone(),
        textures,
        interrupted,
    })
}

/// A map as the localizer wants it, what it looks like, and what was wrong with its file.
struct LoadedMap {
    planar: PlanarMap,
    textures: Vec<PlacedTexture>,
    issues: IssueLog,
}

fn load(request: &LocalizeRequest, options: &Options, observe: &mut Observer) -> Result<LoadedMap, JobError> {
    let known = KnownMaps { files: vec![request.map.clone()], frozen: FrozenTrajectories::All, start: None };
    let known = known.load::<Planar>(options, observe)?;
    let planar = PlanarMap::new(known.graph.state());
    let planar = planar.map_err(|reason| JobError::UnusableMap { path: request.map.clone(), reason })?;
    let textures = submap_textures_2d(&Map::new(options.clone(), known.graph, known.trajectories));
    Ok(LoadedMap { planar, textures, issues: known.issues })
}
