//! The map as a cloud and as X-ray pictures, all points with the finished trajectory: those of the cloud from a
//! second pass over the recording, those of the pictures as mapping used and kept them.

use std::path::{Path, PathBuf};

use portolan::pipeline::{MappedRecording, PipelineError, Preparation};
use portolan::unwind::{KeptScans, MapPoint, SmoothMotion, UnwindOptions, Unwound, unwind};
use portolan_geometry::{Dimension, Rigid3, Time};
use portolan_ingest::IngestOptions;
use portolan_mapping::Space;
use portolan_pointcloud::{
    Attributes, BATCH_POINTS, CloudError, CloudFormat, CloudWriter, PointCloud, VoxelThinner, WriteOptions,
    create,
};
use portolan_recording::Recording;

use super::xray::{self, NotDrawn, Points};
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
    /// Draw no X-ray pictures of maps in 3D.
    #[arg(long)]
    pub no_xray: bool,
}

impl CloudArgs {
    /// Has mapping keep in the folder of the results what [`write_clouds`] draws.
    pub fn keep_scans(&self, preparation: &mut Preparation, folder: &Path) {
        preparation.keep_scans_in = self.with_xrays(preparation).then(|| folder.to_owned());
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

    /// Makes the folder of the cloud and tries whether files can be written there, so that this does not fail after
    /// hours of mapping.
    pub fn make_room(&self) -> Result<(), CliError> {
        let Some(path) = &self.cloud else { return Ok(()) };
        let file = |path: &Path, source| CliError::File { path: path.to_owned(), source };
        if path.is_dir() {
            return Err(file(path, std::io::ErrorKind::IsADirectory.into()));
        }
        // A name without a folder goes to the results, which are made on their own.
        let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) else {
            return Ok(());
        };
        std::fs::create_dir_all(folder).map_err(|source| file(folder, source))?;
        tempfile::tempfile_in(folder).map(drop).map_err(|source| file(folder, source))
    }

    fn path(&self, folder: &Path) -> Option<PathBuf> {
        let path = self.cloud.as_ref()?;
        let is_bare = path.parent().is_none_or(|parent| parent.as_os_str().is_empty());
        Some(if is_bare { folder.join(path) } else { path.clone() })
    }
}

/// What was made of the points.
#[derive(Default)]
pub struct CloudResults {
    /// Files in order.
    pub files: Vec<PathBuf>,
    /// For the report.
    pub report: serde_json::Value,
    /// For people; may be empty.
    pub text: String,
}

/// Takes the points of a sweep.
type Sink<'a> = dyn FnMut(&[MapPoint]) -> Result<(), CloudError> + 'a;

impl CloudResults {
    /// Writes the cloud (its file and voxels) and draws the X-rays, as far as they are asked for, of all points that
    /// `unwind` gives.
    fn add_second_pass(
        &mut self,
        cloud: Option<(PathBuf, Option<f64>)>,
        to_draw: Option<&xray::Request>,
        folder: &Path,
        unwind: &mut dyn FnMut(&mut Sink) -> Result<Unwound, CliError>,
    ) -> Result<(), CliError> {
        let cloud_sink = cloud.as_ref().map(|(path, voxel)| CloudSink::create(path, *voxel));
        let mut cloud_sink = cloud_sink.transpose().map_err(failed)?;
        let xray_sink = to_draw.map(|request| VoxelThinner::new(request.voxel_size));
        let xray_sink = xray_sink.transpose().map_err(failed)?;
        let mut xray_sink = xray_sink.map(|thinner| thinner.in_folder(folder));
        let unwound = unwind(&mut |points| {
            if let Some(thinner) = &mut xray_sink {
                points.iter().try_for_each(|p| thinner.add(p.position, p.intensity, p.time))?;
            }
            cloud_sink.as_mut().map_or(Ok(()), |sink| sink.add(points))
        })?;
        if unwound.interrupted {
            say("stopped: nothing was made of the second pass");
            return Ok(());
        }
        self.report["unwound"] = serde_json::json!(unwound);
        if let Some((sink, (path, voxel))) = cloud_sink.zip(cloud) {
            let points = sink.finish().map_err(failed)?;
            self.text = summary(&unwound, points);
            self.report["points_in_file"] = points.into();
            self.report["voxel_size"] = voxel.into();
            self.files.push(path);
        }
        if let Some((thinner, request)) = xray_sink.zip(to_draw) {
            let mut points = Points::Thinned(thinner.finish().map_err(failed)?);
            self.files.extend(request.draw(&mut points, folder).or_else(not_drawn)?);
        }
        Ok(())
    }
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
            Some(size) => {
                // Beside the cloud, where there is room for it.
                let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
                let thinner = VoxelThinner::new(size)?.in_folder(folder.unwrap_or(Path::new(".")));
                Self::Thinned { writer, thinner }
            }
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
    let drawn = match &view {
        Some(request) => draw_kept(request, &mapped.kept_scans, &poses, folder)?,
        None => Some(Vec::new()),
    };
    let mut results = CloudResults { report: serde_json::json!({}), ..CloudResults::default() };
    if with_xrays {
        let source = if drawn.is_some() { "scans kept while mapping" } else { "a second pass" };
        results.report["xrays_from"] = source.into();
    }
    if cloud.is_some() || drawn.is_none() {
        let to_draw = view.as_ref().filter(|_| drawn.is_none());
        let mut unwind = |sink: &mut Sink| unwind_all(recording, ingest, preparation, &poses, sink, global);
        results.add_second_pass(cloud.zip(Some(args.cloud_voxel)), to_draw, folder, &mut unwind)?;
    }
    results.files.extend(drawn.into_iter().flatten());
    Ok(Some(results))
}

/// X-rays of what mapping kept; none if that is not there.
fn draw_kept(
    request: &xray::Request,
    scans: &KeptScans,
    poses: &[(Time, Rigid3)],
    folder: &Path,
) -> Result<Option<Vec<PathBuf>>, CliError> {
    if let Some(error) = scans.failure() {
        say(&format!("scans could not be kept in {} ({error}): X-rays need a second pass", folder.display()));
    }
    if !scans.is_complete() {
        return Ok(None);
    }
    let motion = SmoothMotion::new(poses.to_vec());
    match request.draw(&mut Points::Kept(scans, &motion), folder) {
        Ok(files) => Ok(Some(files)),
        Err(NotDrawn::Kept(error)) => {
            say(&format!("scans that were kept cannot be read ({error}): X-rays need a second pass"));
            Ok(None)
        }
        Err(other) => not_drawn(other).map(Some),
    }
}

fn not_drawn(reason: NotDrawn) -> Result<Vec<PathBuf>, CliError> {
    match reason {
        NotDrawn::Interrupted => {
            say("stopped: no X-rays of it");
            Ok(Vec::new())
        }
        NotDrawn::Points(error) => Err(failed(error)),
        NotDrawn::Kept(error) => {
            Err(CliError::Failed(format!("scans that were kept cannot be read: {error}")))
        }
        NotDrawn::Failed(error) => Err(error),
    }
}

fn unwind_all(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: &Preparation,
    poses: &[(Time, Rigid3)],
    sink: &mut Sink,
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
    let unwound = unwind(recording, ingest, preparation, poses.to_vec(), options, &mut observe, sink);
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
