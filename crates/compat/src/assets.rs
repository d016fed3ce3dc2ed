//! `cartographer_assets_writer`: transforms the points of recordings by the trajectories of a map and sends them
//! through a pipeline of stages.

use std::path::{Path, PathBuf};

use portolan::assets::{AssetsError, PlacedRecording};
use portolan::trajectory_file::{nodes, read_pose_graph};
use portolan_config::lua::{Limits, evaluate_file};
use portolan_evaluation::Trajectory;
use portolan_export::points::{Flush, Pipeline, PipelineContext, pipeline_from_lua, table_of};
use portolan_geometry::NearFrame;
use portolan_ingest::{IngestOptions, read_urdf};

use crate::flags::{Flags, KnownFlags};
use crate::{CompatError, Completeness, Console};

const KNOWN: KnownFlags = KnownFlags {
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

/// Runs a pipeline over the recordings of a map, one recording for each of its trajectories.
///
/// # Errors
/// If flags, the configuration or the map are wrong, or a file cannot be read or written.
pub fn assets_writer(arguments: &[String], console: &mut dyn Console) -> Result<Completeness, CompatError> {
    let flags = Flags::parse(arguments, &KNOWN)?;
    let (bags, map) = (flags.list("bag_filenames"), flags.path("pose_graph_filename")?);
    let Some(first_bag) = bags.first() else { return Err(flags.wrong("-bag_filenames is missing").into()) };
    let graph = read_pose_graph(&map)?;
    if graph.trajectory.len() != bags.len() {
        let (found, given) = (graph.trajectory.len(), bags.len());
        let text =
            format!("the map has {found} trajectories but {given} bags are given: one each, in their order");
        return Err(CompatError::in_file(&map, text));
    }
    let trajectories = graph
        .trajectory
        .iter()
        .map(|t| Ok(Trajectory::new(nodes(&map, &graph, t.trajectory_id)?).0))
        .collect::<Result<Vec<_>, CompatError>>()?;
    let places = trajectories.iter().flat_map(Trajectory::poses);
    let frame = NearFrame::around(places.map(|pose| pose.map_from_tracking.translation.vector));
    let trajectories: Vec<Trajectory> = trajectories.into_iter().map(|t| t.moved(&-frame.origin())).collect();
    let prefix = match flags.value("output_file_prefix") {
        "" => format!("{first_bag}_"),
        prefix => prefix.to_owned(),
    };
    let poses = |t: &Trajectory| t.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    let context = PipelineContext {
        file_prefix: prefix,
        trajectories: trajectories.iter().map(poses).collect(),
        frame,
    };
    let (mut pipeline, tracking_frame) = read_pipeline(&flags, &context, console)?;
    let options = ingest_options(&flags, tracking_frame)?;
    let mut bags = bags
        .into_iter()
        .map(|bag| PlacedRecording::open(PathBuf::from(bag), &options))
        .collect::<Result<Vec<_>, AssetsError>>()?;
    let dropped = loop {
        let mut dropped = 0;
        for (id, (bag, trajectory)) in bags.iter_mut().zip(&trajectories).enumerate() {
            dropped += bag.send(id, trajectory, &options, &mut pipeline, &mut |text| console.info(text))?;
        }
        if pipeline.flush(&mut |text| console.info(text)).map_err(failed)? == Flush::Finished {
            break dropped;
        }
    };
    if dropped > 0 {
        console.info(&format!("{dropped} points were left out: before or after the trajectory."));
    }
    Ok(Completeness::Complete)
}

fn failed(error: impl std::fmt::Display) -> CompatError {
    CompatError::Failed(error.to_string())
}

/// The pipeline of the configuration, and the tracking frame.
fn read_pipeline(
    flags: &Flags,
    context: &PipelineContext,
    console: &mut dyn Console,
) -> Result<(Pipeline, String), CompatError> {
    let directory = PathBuf::from(flags.required("configuration_directory")?);
    let name = Path::new(flags.required("configuration_basename")?);
    let in_directory = directory.join(name);
    let path = if in_directory.is_file() { &in_directory } else { name };
    let table = evaluate_file(path, &[directory], Limits::default()).map_err(failed)?.table;
    let frame = table.entries.get("tracking_frame").and_then(portolan_config::Value::as_text);
    let frame = frame.ok_or_else(|| CompatError::in_file(path, "tracking_frame is missing"))?;
    let stages = table_of(&table, "pipeline").map_err(failed)?;
    let pipeline = pipeline_from_lua(&stages, context, &mut |text| console.info(text));
    Ok((pipeline.map_err(|error| CompatError::in_file(path, error))?, frame))
}

fn ingest_options(flags: &Flags, tracking_frame: String) -> Result<IngestOptions, CompatError> {
    let description = match flags.value("urdf_filename") {
        "" => None,
        urdf => Some(read_urdf(Path::new(urdf))?),
    };
    Ok(IngestOptions {
        tracking_frame: Some(tracking_frame),
        description,
        use_recorded_transforms: flags.is_on("use_bag_transforms"),
        with_intensities: true,
        // Only range sensors are read.
        use_imu: Some(false),
        use_odometry: Some(false),
        ..IngestOptions::default()
    })
}
