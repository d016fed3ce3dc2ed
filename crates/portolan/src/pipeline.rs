//! The whole job: from a recording to a map.

use std::collections::BTreeSet;

use portolan_config::Options;
use portolan_geometry::Time;
use portolan_mapping::{
    BackendProgress, LatencyHistogram, Map, Mapper, MapperError, MapperSettings, Planar, Repairs,
};
use portolan_recording::{
    Dimension, IngestError, IngestOptions, Ingestion, Inventory, Recording, RecordingError, Repair,
    SensorPlan, plan,
};
use portolan_sensor::SensorId;

use crate::automatic;

/// Why a recording could not be mapped.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The recording, or what is in it.
    #[error(transparent)]
    Ingest(#[from] IngestError),
    /// The recording could not be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Mapping.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// The recording needs a space that is not there yet.
    #[error(
        "the recording has no planar scanner, and mapping in 3D is not built yet; name a planar topic with --scan"
    )]
    NeedsThreeDimensions,
    /// A setting that was to be changed.
    #[error("{0}")]
    Setting(String),
    /// Nothing was mapped.
    #[error("not a single scan could be used; `portolan check` tells what is wrong with the recording")]
    NoScans,
}

/// How far mapping is.
#[derive(Clone, Copy, Debug)]
pub struct PipelineProgress {
    /// Bytes of the recording read.
    pub position_bytes: u64,
    /// Bytes of the recording.
    pub total_bytes: u64,
    /// Seconds of the recording that are mapped.
    pub recording_seconds: f64,
    /// The pose graph.
    pub backend: BackendProgress,
}

/// A mapped recording.
pub struct MappedRecording {
    /// The map.
    pub map: Map<Planar>,
    /// Which topics were used as which sensors.
    pub plan: SensorPlan,
    /// Scans matched.
    pub scans: u64,
    /// Seconds from the first to the last measurement.
    pub recording_seconds: f64,
    /// How long local SLAM took for each matched scan.
    pub scan_times: LatencyHistogram,
    /// Repairs while reading.
    pub reading_repairs: Vec<Repair>,
    /// Repairs while mapping.
    pub mapping_repairs: Repairs,
    /// Whether it was stopped before the end.
    pub interrupted: bool,
}

/// Maps a recording in the plane. Without `options` they are chosen from the recording; `adjust` sees
/// them before they are used and may refuse. `observe` is called now and then and stops everything cleanly by
/// returning false.
pub fn map_recording(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    options: Option<Options>,
    adjust: &mut dyn FnMut(&mut Options, &SensorPlan) -> Result<(), PipelineError>,
    settings: MapperSettings,
    observe: &mut dyn FnMut(&PipelineProgress) -> bool,
) -> Result<MappedRecording, PipelineError> {
    let inventory = Inventory::of(recording, ingest)?;
    let plan = plan(&inventory, ingest).map_err(IngestError::from)?;
    if plan.dimension != Dimension::Two {
        return Err(PipelineError::NeedsThreeDimensions);
    }
    let mut options = options.unwrap_or_else(|| automatic::options_2d(&plan, &plan.statistics()));
    adjust(&mut options, &plan)?;
    let mut ingestion = Ingestion::with_plan(recording, &inventory, plan.clone(), ingest)?;
    let mut mapper = Mapper::<Planar>::new(&options, settings)?;
    let sensors: BTreeSet<SensorId> = ingestion.sensors().into_iter().collect();
    let trajectory_id = mapper.add_trajectory(&sensors, None)?;
    let (mut scans, mut interrupted) = (0, false);
    let mut span: Option<(Time, Time)> = None;
    while let Some((sensor_id, measurement)) = ingestion.next_measurement()? {
        let time = measurement.time();
        let (first, last) = span.get_or_insert((time, time));
        *last = time.max(*last);
        let recording_seconds = last.seconds_since(*first);
        scans += mapper.add(trajectory_id, &sensor_id, measurement)?.len() as u64;
        let (position_bytes, total_bytes) = ingestion.progress();
        let backend = mapper.progress();
        if !observe(&PipelineProgress { position_bytes, total_bytes, recording_seconds, backend }) {
            interrupted = true;
            break;
        }
    }
    scans += mapper.finish_trajectory(trajectory_id)?.len() as u64;
    let scan_times = mapper.scan_times().clone();
    let (map, mapping_repairs) = mapper.finish()?;
    if scans == 0 {
        return Err(PipelineError::NoScans);
    }
    Ok(MappedRecording {
        map,
        plan,
        scans,
        recording_seconds: span.map_or(0.0, |(first, last)| last.seconds_since(first)),
        scan_times,
        reading_repairs: ingestion.repairs(),
        mapping_repairs,
        interrupted,
    })
}
