//! `cartographer_assets_writer`: the points of recordings, placed by a map, through a pipeline of stages.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use portolan_config::lua::{Limits, evaluate_file};
use portolan_evaluation::Trajectory;
use portolan_export::points::{Flush, Pipeline, PipelineContext, PointsBatch, pipeline_from_lua, table_of};
use portolan_geometry::{Duration, Point3f, to_f32};
use portolan_ingest::{IngestError, IngestOptions, Ingestion, Inventory, SensorPlan, plan, read_urdf};
use portolan_recording::{Recording, open};
use portolan_sensor::{Measurement, TimedPointCloudData};

use super::Flags;
use super::flags::Known;
use super::log;
use crate::GlobalArgs;
use crate::commands::evaluate::input::{nodes, read_pose_graph};
use crate::error::{CliError, Outcome};

/// Messages between two lines of the log.
const LOG_EVERY: u64 = 10_000;

const KNOWN: Known = Known {
    values: &[
        ("configuration_directory", ""),
        ("configuration_basename", ""),
        ("urdf_filename", ""),
        ("bag_filenames", ""),
        ("pose_graph_filename", ""),
        ("output_file_prefix", ""),
    ],
    switches: &[("use_bag_transforms", true)],
    usage: "usage: cartographer_assets_writer -configuration_directory DIR -configuration_basename FILE \
            -bag_filenames BAG[,BAG...] -pose_graph_filename MAP [-urdf_filename FILE] [-output_file_prefix PREFIX]",
};

/// Runs a pipeline over the recordings of a map, one for each of its trajectories.
pub fn run(arguments: &[String], _: &GlobalArgs) -> Result<Outcome, CliError> {
    let flags = Flags::parse(arguments, &KNOWN)?;
    let (bags, map) = (flags.list("bag_filenames"), flags.path("pose_graph_filename")?);
    let Some(first_bag) = bags.first() else { return Err(flags.wrong("-bag_filenames is missing")) };
    let graph = read_pose_graph(&map)?;
    if graph.trajectory.len() != bags.len() {
        let (found, given) = (graph.trajectory.len(), bags.len());
        let text =
            format!("the map has {found} trajectories but {given} bags are given: one each, in their order");
        return Err(CliError::in_file(&map, text));
    }
    let trajectories = graph
        .trajectory
        .iter()
        .map(|t| Ok(Trajectory::new(nodes(&map, &graph, t.trajectory_id)?).0))
        .collect::<Result<Vec<_>, CliError>>()?;
    let prefix = match flags.value("output_file_prefix") {
        "" => format!("{first_bag}_"),
        prefix => prefix.to_owned(),
    };
    let poses = |t: &Trajectory| t.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    let context =
        PipelineContext { file_prefix: prefix, trajectories: trajectories.iter().map(poses).collect() };
    let (mut pipeline, tracking_frame) = read_pipeline(&flags, &context)?;
    let options = ingest_options(&flags, tracking_frame)?;
    let mut bags = bags
        .into_iter()
        .map(|bag| Bag::open(PathBuf::from(bag), &options))
        .collect::<Result<Vec<_>, CliError>>()?;
    let dropped = loop {
        let mut dropped = 0;
        for (id, (bag, trajectory)) in bags.iter_mut().zip(&trajectories).enumerate() {
            dropped += bag.send(id, trajectory, &options, &mut pipeline)?;
        }
        if pipeline.flush(&mut log::info).map_err(failed)? == Flush::Finished {
            break dropped;
        }
    };
    if dropped > 0 {
        log::info(&format!("{dropped} points were left out: before or after the trajectory."));
    }
    Ok(Outcome::Done)
}

fn failed(error: impl std::fmt::Display) -> CliError {
    CliError::Failed(error.to_string())
}

/// The stages of the configuration, and the frame whose poses the map has.
fn read_pipeline(flags: &Flags, context: &PipelineContext) -> Result<(Pipeline, String), CliError> {
    let directory = PathBuf::from(flags.required("configuration_directory")?);
    let name = Path::new(flags.required("configuration_basename")?);
    let in_directory = directory.join(name);
    let path = if in_directory.is_file() { &in_directory } else { name };
    let table = evaluate_file(path, &[directory], Limits::default()).map_err(failed)?.table;
    let frame = table.entries.get("tracking_frame").and_then(portolan_config::Value::as_text);
    let frame = frame.ok_or_else(|| CliError::in_file(path, "tracking_frame is missing"))?;
    let stages = table_of(&table, "pipeline").map_err(failed)?;
    let pipeline = pipeline_from_lua(&stages, context, &mut log::info);
    Ok((pipeline.map_err(|error| CliError::in_file(path, error))?, frame))
}

fn ingest_options(flags: &Flags, tracking_frame: String) -> Result<IngestOptions, CliError> {
    let description = match flags.value("urdf_filename") {
        "" => None,
        urdf => Some(read_urdf(Path::new(urdf))?),
    };
    Ok(IngestOptions {
        tracking_frame: Some(tracking_frame),
        description,
        use_recorded_transforms: flags.is_on("use_bag_transforms"),
        with_intensities: true,
        // Only range sensors are wanted.
        use_imu: Some(false),
        use_odometry: Some(false),
        ..IngestOptions::default()
    })
}

/// A recording that is read once for each pass.
struct Bag {
    path: PathBuf,
    recording: Box<dyn Recording>,
    inventory: Inventory,
    plan: SensorPlan,
}

impl Bag {
    fn open(path: PathBuf, options: &IngestOptions) -> Result<Self, CliError> {
        let recording = open(&path)?;
        let failed = |error: IngestError| CliError::in_file(&path, error);
        let inventory = Inventory::of(recording.as_ref(), options)?;
        let plan = plan(&inventory, options).map_err(|error| failed(error.into()))?;
        Ok(Self { path, recording, inventory, plan })
    }

    /// Sends all points through the pipeline; how many were left out.
    fn send(
        &mut self,
        id: usize,
        trajectory: &Trajectory,
        options: &IngestOptions,
        pipeline: &mut Pipeline,
    ) -> Result<u64, CliError> {
        log::info(&format!("Processing {}...", self.path.display()));
        let ingestion =
            Ingestion::with_plan(self.recording.as_ref(), &self.inventory, self.plan.clone(), options);
        let mut ingestion = ingestion.map_err(failed)?;
        let total = trajectory.span().map_or(0.0, |(first, last)| last.seconds_since(first));
        let (mut messages, mut dropped) = (0_u64, 0);
        while let Some((sensor, measurement)) = ingestion.next_measurement()? {
            let Measurement::Range(sweep) = measurement else { continue };
            let frame = self.plan.range.iter().find(|r| r.source.sensor == sensor).map(|r| &r.source.frame);
            let frame: Arc<str> = frame.cloned().unwrap_or_default();
            if let Some(batch) = place(&sweep, trajectory, frame, id, &mut dropped) {
                pipeline.process(batch).map_err(failed)?;
            }
            messages += 1;
            if messages.is_multiple_of(LOG_EVERY) {
                let done = trajectory.span().map_or(0.0, |(first, _)| sweep.time.seconds_since(first));
                log::info(&format!("Processed {done:.1} of {total:.1} bag time seconds..."));
            }
        }
        Ok(dropped)
    }
}

/// Puts each point where the tracking frame was at its time; none if all are outside of the trajectory.
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
