//! The whole job: from a recording to a map.

use std::collections::BTreeSet;

use portolan_config::Options;
use portolan_geometry::Time;
use portolan_mapping::{
    BackendProgress, LatencyHistogram, Map, Mapper, MapperError, MapperSettings, Repairs, Space, WeakSpan,
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
pub struct MappedRecording<S: Space> {
    /// The map.
    pub map: Map<S>,
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
    /// Where scans left directions open and the prediction decided (3D).
    pub weak_spans: Vec<WeakSpan>,
    /// Whether it was stopped before the end.
    pub interrupted: bool,
}

/// A recording about to be mapped: what is in it, what is used of it, and how.
pub struct Preparation {
    inventory: Inventory,
    /// Which topics are used as which sensors.
    pub plan: SensorPlan,
    /// How it will be mapped; may still be changed.
    pub options: Options,
    /// In which space. Follows from the options.
    pub dimension: Dimension,
    /// Most threads for searching and optimising, if somebody set a number
    /// ([`RequestedOptions::background_threads`](crate::RequestedOptions::background_threads)).
    pub background_threads: Option<usize>,
}

/// Looks through a recording. Without `options` they are chosen from what is in it.
pub fn prepare(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    options: Option<Options>,
) -> Result<Preparation, PipelineError> {
    let inventory = Inventory::of(recording, ingest)?;
    let plan = plan(&inventory, ingest).map_err(IngestError::from)?;
    let options = options.unwrap_or_else(|| match plan.dimension {
        Dimension::Two => automatic::options_2d(&plan, &plan.statistics()),
        Dimension::Three => automatic::options_3d(&plan, &plan.statistics()),
    });
    let dimension = match options.map_builder.dimension() {
        Ok(portolan_config::Dimension::Two) => Dimension::Two,
        Ok(portolan_config::Dimension::Three) => Dimension::Three,
        Err(error) => return Err(PipelineError::Setting(error.to_string())),
    };
    Ok(Preparation { inventory, plan, options, dimension, background_threads: None })
}

/// Maps a recording in the space that the preparation names. `observe` is called now and then and stops
/// everything cleanly by returning false.
pub fn map_recording<S: Space>(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: Preparation,
    settings: MapperSettings,
    observe: &mut dyn FnMut(&PipelineProgress) -> bool,
) -> Result<MappedRecording<S>, PipelineError> {
    let Preparation { inventory, plan, options, .. } = preparation;
    let mut ingestion = Ingestion::with_plan(recording, &inventory, plan.clone(), ingest)?;
    let mut mapper = Mapper::<S>::new(&options, settings)?;
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
    let weak_spans = mapper.weak_spans().to_vec();
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
        weak_spans,
        interrupted,
    })
}
