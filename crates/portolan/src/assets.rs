//! Sends points of recordings, placed by trajectories, through the stages of `portolan_export::points`.

use std::path::PathBuf;
use std::sync::Arc;

use portolan_evaluation::Trajectory;
use portolan_export::points::{Pipeline, PointsBatch, PointsError};
use portolan_geometry::{Duration, Point3f, to_f32};
use portolan_ingest::{IngestError, IngestOptions, Ingestion, Inventory, SensorPlan, plan};
use portolan_recording::{Recording, RecordingError, open};
use portolan_sensor::{Measurement, TimedPointCloudData};

/// Messages between two lines of the log.
const LOG_EVERY: u64 = 10_000;

/// Reasons why points could not be sent through the stages.
#[derive(Debug, thiserror::Error)]
pub enum AssetsError {
    /// A recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The sensors of a recording.
    #[error("{}: {source}", path.display())]
    Sensors {
        /// Its file.
        path: PathBuf,
        /// The error.
        source: IngestError,
    },
    /// The content of a recording.
    #[error(transparent)]
    Ingest(#[from] IngestError),
    /// A stage.
    #[error(transparent)]
    Stage(#[from] PointsError),
}

/// A recording that is read once for each pass of the pipeline.
pub struct PlacedRecording {
    path: PathBuf,
    recording: Box<dyn Recording>,
    inventory: Inventory,
    plan: SensorPlan,
}

impl PlacedRecording {
    /// Opens the recording and finds its sensors.
    ///
    /// # Errors
    /// Fails if it cannot be read, or the poses of its sensors are unknown.
    pub fn open(path: PathBuf, options: &IngestOptions) -> Result<Self, AssetsError> {
        let recording = open(&path)?;
        let inventory = Inventory::of(recording.as_ref(), options)?;
        let plan = plan(&inventory, options)
            .map_err(|error| AssetsError::Sensors { path: path.clone(), source: error.into() })?;
        Ok(Self { path, recording, inventory, plan })
    }

    /// Sends all points through the pipeline, placed by a trajectory in the frame that the pipeline works in.
    /// Returns how many were left out.
    ///
    /// # Errors
    /// Fails if the recording cannot be read, or a stage cannot write.
    pub fn send(
        &mut self,
        id: usize,
        trajectory: &Trajectory,
        options: &IngestOptions,
        pipeline: &mut Pipeline,
        log: &mut dyn FnMut(&str),
    ) -> Result<u64, AssetsError> {
        log(&format!("Processing {}...", self.path.display()));
        let ingestion =
            Ingestion::with_plan(self.recording.as_ref(), &self.inventory, self.plan.clone(), options);
        let mut ingestion = ingestion?;
        let total = trajectory.span().map_or(0.0, |(first, last)| last.seconds_since(first));
        let (mut messages, mut dropped) = (0_u64, 0);
        while let Some((sensor, measurement)) = ingestion.next_measurement()? {
            let Measurement::Range(sweep) = measurement else { continue };
            let frame = self.plan.range.iter().find(|r| r.source.sensor == sensor).map(|r| &r.source.frame);
            let frame: Arc<str> = frame.cloned().unwrap_or_default();
            if let Some(batch) = place(&sweep, trajectory, frame, id, &mut dropped) {
                pipeline.process(batch)?;
            }
            messages += 1;
            if messages.is_multiple_of(LOG_EVERY) {
                let done = trajectory.span().map_or(0.0, |(first, _)| sweep.time.seconds_since(first));
                log(&format!("Processed {done:.1} of {total:.1} bag time seconds..."));
            }
        }
        Ok(dropped)
    }
}

/// Transforms each point by the pose of the tracking frame at its time; none if all are outside of the
/// trajectory.
fn place(
    sweep: &TimedPointCloudData,
    trajectory: &Trajectory,
    frame_id: Arc<str>,
    trajectory_id: usize,
    dropped: &mut u64,
) -> Option<PointsBatch> {
    let mut batch = PointsBatch {
        start_time: sweep.time,
        origin: Point3f::origin(),
        frame_id,
        trajectory_id,
        points: Vec::with_capacity(sweep.points_in_tracking.len()),
        intensities: Vec::with_capacity(sweep.intensities.len()),
        colors: Vec::new(),
    };
    // Beams of one shot have the same time.
    let mut known: Option<(f32, Option<portolan_geometry::Rigid3f>)> = None;
    for (i, point) in sweep.points_in_tracking.iter().enumerate() {
        let map_from_tracking = match known {
            Some((time, pose)) if time.to_bits() == point.time.to_bits() => pose,
            _ => {
                let time = sweep.time + Duration::from_seconds(f64::from(point.time));
                trajectory.lookup(time).map(|pose| to_f32(&pose))
            }
        };
        known = Some((point.time, map_from_tracking));
        let Some(map_from_tracking) = map_from_tracking else {
            *dropped += 1;
            continue;
        };
        batch.points.push(map_from_tracking * point.position);
        batch.intensities.extend(sweep.intensities.get(i));
        batch.origin = map_from_tracking * sweep.origin_in_tracking;
    }
    (!batch.points.is_empty()).then_some(batch)
}
