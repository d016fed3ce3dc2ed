//! The map as a cloud and as X-ray pictures: all points once more with the finished trajectory, from a second
//! pass over the recording or, for pictures of a short one, from memory.

use std::path::{Path, PathBuf};

use portolan::pipeline::{MappedRecording, PipelineError, Preparation};
use portolan::unwind::{MapPoint, UnwindOptions, Unwound, unwind, unwind_kept};
use portolan_geometry::{Rigid3, Time};
use portolan_mapping::Space;
use portolan_pointcloud::{
    Attributes, BATCH_POINTS, CloudError, CloudFormat, CloudWriter, PointCloud, VoxelThinner, WriteOptions,
    create,
};
use portolan_recording::{Dimension, IngestOptions, Recording};
use portolan_sensor::TimedPointCloudData;

use super::xray;
use crate::GlobalArgs;
use crate::error::CliError;
use crate::interrupt;
use crate::output::counted;
use crate::progress::{Progress, say};

/// What each point has.
const ATTRIBUTES: Attributes = Attributes { intensity: true, time: true, color: false };

/// The map as a cloud and as pictures of it.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Cloud (a second pass over the recording)")]
pub struct CloudArgs {
    /// Also write the map as a cloud of all raw points, each placed by the final trajectory at its own time:
    /// .ply, .pcd, .las, .laz, .e57 or .xyz. A name without a folder goes to the results.
    #[arg(long, value_name = "FILE")]
    pub cloud: Option<PathBuf>,
    /// Keep one point for each cube of this size: the mean of its points. 0.05 is a good start. Memory
    /// does not grow with the recording, with or without.
    #[arg(long, value_name = "METRES", requires = "cloud")]
    pub cloud_voxel: Option<f64>,
    /// Draw no X-ray pictures of maps in 3D, which need that pass, too.
    #[arg(long)]
    pub no_xray: bool,
}

/// Points that X-rays are made of are kept while mapping as long as they take no more memory than this: six
/// million points.
const MAX_KEPT_BYTES: usize = 96 << 20;

impl CloudArgs {
    /// How many bytes of sweeps mapping should keep for what [`write_clouds`] draws.
    pub fn bytes_to_keep(&self, preparation: &Preparation) -> usize {
        // Clouds have intensities, which are not kept.
        let only_xrays = self.cloud.is_none() && self.with_xrays(preparation);
        if only_xrays { MAX_KEPT_BYTES } else { 0 }
    }

    fn with_xrays(&self, preparation: &Preparation) -> bool {
        preparation.dimension == Dimension::Three && !self.no_xray
    }

    /// Refuses what cannot be done before anything is mapped.
    pub fn check(&self) -> Result<(), CliError> {
        let usage = |error: CloudError| CliError::Usage(error.to_string());
        if let Some(path) = &self.cloud {
            CloudFormat::from_path(path).map_err(usage)?;
        }
        self.cloud_voxel.map_or(Ok(()), |size| VoxelThinner::new(size).map(drop).map_err(usage))
    }

    fn path(&self, folder: &Path) -> Option<PathBuf> {
        let path = self.cloud.as_ref()?;
        let is_bare = path.parent().is_none_or(|parent| parent.as_os_str().is_empty());
        Some(if is_bare { folder.join(path) } else { path.clone() })
    }
}

/// What the second pass gave.
pub struct CloudResults {
    /// Files in order.
    pub files: Vec<PathBuf>,
    /// For the report.
    pub report: serde_json::Value,
    /// For people; may be empty.
    pub text: String,
}

/// Points on their way to the cloud: as they come, or thinned.
enum CloudSink {
    All { writer: Box<dyn CloudWriter>, batch: PointCloud },
    Thinned { writer: Box<dyn CloudWriter>, thinner: VoxelThinner },
}

impl CloudSink {
    fn create(path: &Path, voxel: Option<f64>) -> Result<Self, CloudError> {
        let writer = create(path, ATTRIBUTES, &WriteOptions::default())?;
        Ok(match voxel {
            Some(size) => Self::Thinned { writer, thinner: VoxelThinner::new(size)? },
            None => Self::All { writer, batch: PointCloud::new(ATTRIBUTES) },
        })
    }

    fn add(&mut self, points: &[MapPoint]) -> Result<(), CloudError> {
        match self {
            Self::Thinned { thinner, .. } => {
                points.iter().try_for_each(|p| thinner.add(p.position, p.intensity, p.time))
            }
            Self::All { writer, batch } => {
                for p in points {
                    batch.push(p.position, p.intensity, p.time, [0; 3]);
                }
                if batch.len() < BATCH_POINTS {
                    return Ok(());
                }
                writer.write(batch)?;
                batch.reset(ATTRIBUTES);
                Ok(())
            }
        }
    }

    /// How many points are in the file.
    fn finish(self) -> Result<u64, CloudError> {
        match self {
            Self::All { mut writer, batch } => {
                writer.write(&batch)?;
                Ok(writer.finish()?.points)
            }
            Self::Thinned { mut writer, thinner } => {
                let mut batch = PointCloud::new(ATTRIBUTES);
                thinner.finish()?.for_each(&mut |p| {
                    batch.push(p.position, p.intensity, p.time, [0; 3]);
                    if batch.len() == BATCH_POINTS {
                        writer.write(&batch)?;
                        batch.reset(ATTRIBUTES);
                    }
                    Ok(())
                })?;
                writer.write(&batch)?;
                Ok(writer.finish()?.points)
            }
        }
    }
}

/// Writes the cloud that was asked for, and X-rays of maps in 3D; none where nothing is to be done.
pub fn write_clouds<S: Space>(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: &Preparation,
    mapped: &MappedRecording<S>,
    args: &CloudArgs,
    folder: &Path,
    global: &GlobalArgs,
) -> Result<Option<CloudResults>, CliError> {
    let with_xrays = args.with_xrays(preparation);
    let cloud = args.path(folder);
    if cloud.is_none() && !with_xrays {
        return Ok(None);
    }
    if interrupt::interrupted() {
        say("stopped: no cloud and no X-rays of it");
        return Ok(None);
    }
    let poses = mapped.map.scan_poses(mapped.trajectory_id);
    let view = with_xrays.then(|| xray::Request::new(&poses, &mapped.plan, preparation));
    let mut cloud_sink = match &cloud {
        Some(path) => Some(CloudSink::create(path, args.cloud_voxel).map_err(failed)?),
        None => None,
    };
    let mut xray_sink = match &view {
        Some(request) => Some(VoxelThinner::new(request.voxel_size).map_err(failed)?),
        None => None,
    };
    let mut sink = |points: &[MapPoint]| {
        if let Some(thinner) = &mut xray_sink {
            points.iter().try_for_each(|p| thinner.add(p.position, p.intensity, p.time))?;
        }
        cloud_sink.as_mut().map_or(Ok(()), |sink| sink.add(points))
    };
    let kept = if cloud.is_none() { mapped.kept_sweeps.complete() } else { None };
    let unwound = unwind_all(recording, ingest, preparation, kept, poses.clone(), &mut sink, global)?;
    if unwound.interrupted {
        say("stopped: no cloud and no X-rays of it");
        return Ok(None);
    }
    let mut results = CloudResults {
        files: Vec::new(),
        report: serde_json::json!({ "unwound": unwound }),
        text: String::new(),
    };
    if let (Some(sink), Some(path)) = (cloud_sink, cloud) {
        let points = sink.finish().map_err(failed)?;
        results.text = summary(&unwound, points);
        results.report["points_in_file"] = points.into();
        results.report["voxel_size"] = args.cloud_voxel.into();
        results.files.push(path);
    }
    if let (Some(thinner), Some(request)) = (xray_sink, view) {
        let mut thinned = thinner.finish().map_err(failed)?;
        results.files.extend(request.draw(&mut thinned, folder)?);
    }
    Ok(Some(results))
}

fn unwind_all(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: &Preparation,
    kept: Option<&[TimedPointCloudData]>,
    poses: Vec<(Time, Rigid3)>,
    sink: &mut dyn FnMut(&[MapPoint]) -> Result<(), CloudError>,
    global: &GlobalArgs,
) -> Result<Unwound, CliError> {
    let mut progress = Progress::start("placing points", recording.size_bytes(), global.quiet);
    let options = UnwindOptions::as_mapped(preparation);
    let mut observe = |position, total| {
        if progress.is_due() {
            progress.update(position, total, String::new());
        }
        !interrupt::interrupted()
    };
    let unwound = match kept {
        Some(sweeps) => unwind_kept(sweeps, poses, options, &mut observe, sink),
        None => unwind(recording, ingest, preparation, poses, options, &mut observe, sink),
    };
    progress.finish();
    unwound.map_err(|error| match error {
        PipelineError::Cloud(error) => failed(error),
        other => CliError::Failed(other.to_string()),
    })
}

fn failed(error: CloudError) -> CliError {
    CliError::Failed(error.to_string())
}

fn summary(unwound: &Unwound, points: u64) -> String {
    let mut text = format!("cloud: {} of {}", counted(points, "point", "points"), unwound.points);
    let left_out = [
        (unwound.outside_range, "nearer or farther than mapping takes them"),
        (unwound.outside_trajectory, "at times without a pose"),
    ];
    for (count, why) in left_out.iter().filter(|(count, _)| *count > 0) {
        text += &format!("; {count} left out, {why}");
    }
    text
}
