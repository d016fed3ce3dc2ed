//! Writes the map as a cloud and as X-ray pictures, with all points placed by the finished trajectory. Points
//! of the cloud come from a second pass over the recording, those of the pictures are the ones that mapping
//! used and kept.

use std::path::{Path, PathBuf};

use portolan_atomic_file::ResultFolder;
use portolan_geometry::{Dimension, Rigid3, Time};
use portolan_ingest::{IngestOptions, Ingestion};
use portolan_mapping::Space;
use portolan_pointcloud::{
    Attributes, BATCH_POINTS, CloudError, CloudFormat, CloudWriter, PointCloud, VoxelThinner, WriteOptions,
    create,
};
use portolan_recording::Recording;
use portolan_reprojection::{KeptScans, MapPoint, RangeLimits, Reprojected, Reprojector, SmoothMotion};
use portolan_sensor::Measurement;

use super::error::JobError;
use super::event::{Event, Observer, Remark, remark};
use super::output_folder::OutputFolder;
use super::xray::{self, NotDrawn, Points};
use crate::pipeline::{MappedRecording, PipelineError, Preparation};

/// Attributes of each point.
const ATTRIBUTES: Attributes = Attributes { intensity: true, time: true, color: false };

/// Which cloud and pictures of the map are made.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudRequest {
    /// The map as a cloud of all raw points: .ply, .pcd, .las, .laz, .e57 or .xyz; none without. A name without a
    /// folder goes to the results.
    pub file: Option<PathBuf>,
    /// One point of the cloud for each cube of this size, metres: the mean of its points. None for all points.
    pub voxel_size_metres: Option<f64>,
    /// Whether X-ray pictures of maps in 3D are drawn.
    pub with_xrays: bool,
}

impl Default for CloudRequest {
    fn default() -> Self {
        Self { file: None, voxel_size_metres: None, with_xrays: true }
    }
}

impl CloudRequest {
    /// Lets mapping keep the scans that [`write_clouds`] draws, in the folder of the results.
    pub fn keep_scans(&self, preparation: &mut Preparation, folder: &Path) {
        preparation.keep_scans_in = self.draws_xrays(preparation).then(|| folder.to_owned());
    }

    fn draws_xrays(&self, preparation: &Preparation) -> bool {
        preparation.dimension == Dimension::ThreeD && self.with_xrays
    }

    /// Refuses impossible requests before mapping begins.
    ///
    /// # Errors
    /// A file extension of no known format; an impossible size of cubes.
    pub fn check(&self) -> Result<(), CloudError> {
        if let Some(path) = &self.file {
            CloudFormat::from_path(path)?;
        }
        self.voxel_size_metres.map_or(Ok(()), |size| VoxelThinner::new(size).map(drop))
    }

    /// Makes the folder of the cloud, which is removed again if it stays empty, and checks that files can be
    /// written there.
    ///
    /// # Errors
    /// A folder that cannot be made or written to.
    pub fn make_room(&self) -> Result<ResultFolder, JobError> {
        let Some(path) = &self.file else { return Ok(ResultFolder::default()) };
        if path.is_dir() {
            return Err(JobError::file(path, std::io::ErrorKind::IsADirectory.into()));
        }
        // A name without a folder goes to the folder of results, which is made elsewhere.
        let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) else {
            return Ok(ResultFolder::default());
        };
        ResultFolder::make(folder).map_err(|source| JobError::file(folder, source))
    }

    fn path(&self, folder: &Path) -> Option<PathBuf> {
        let path = self.file.as_ref()?;
        let is_bare = path.parent().is_none_or(|parent| parent.as_os_str().is_empty());
        Some(if is_bare { folder.join(path) } else { path.clone() })
    }
}

/// Results made from the points.
#[derive(Debug, Default)]
pub struct CloudResults {
    /// Files in order.
    pub files: Vec<PathBuf>,
    /// For the report ([`add_to_report`](super::add_to_report), as `cloud`).
    pub report: serde_json::Value,
    /// If a cloud was written: the number of points in the file, and the counts of the re-projection.
    pub cloud: Option<(u64, Reprojected)>,
}

/// Receives the points of a sweep.
type Sink<'a> = dyn FnMut(&[MapPoint]) -> Result<(), CloudError> + 'a;

impl CloudResults {
    /// Writes the cloud (its file and voxels) and draws the X-rays, if requested, from all points that
    /// `reproject` gives.
    fn add_second_pass(
        &mut self,
        cloud: Option<(PathBuf, Option<f64>)>,
        to_draw: Option<&xray::Request>,
        folder: &OutputFolder,
        observe: &mut Observer,
        reproject: &mut dyn FnMut(&mut Sink, &mut Observer) -> Result<Reprojected, JobError>,
    ) -> Result<(), JobError> {
        let cloud_sink = cloud.as_ref().map(|(path, voxel)| CloudSink::create(path, *voxel));
        let mut cloud_sink = cloud_sink.transpose()?;
        let xray_sink = to_draw.map(|request| VoxelThinner::new(request.voxel_size));
        let xray_sink = xray_sink.transpose()?;
        let mut xray_sink = xray_sink.map(|thinner| thinner.in_folder(folder.path()));
        let mut sink = |points: &[MapPoint]| {
            if let Some(thinner) = &mut xray_sink {
                points.iter().try_for_each(|p| thinner.add(p.position, p.intensity, p.time))?;
            }
            cloud_sink.as_mut().map_or(Ok(()), |sink| sink.add(points))
        };
        let reprojected = reproject(&mut sink, observe)?;
        if reprojected.interrupted {
            remark(observe, Remark::StoppedSecondPass);
            return Ok(());
        }
        self.report["unwound"] = serde_json::json!(reprojected);
        if let Some((sink, (path, voxel))) = cloud_sink.zip(cloud) {
            if let Some(name) = path.strip_prefix(folder.path()).ok().and_then(Path::to_str) {
                folder.file(name)?;
            }
            let points = sink.finish()?;
            self.cloud = Some((points, reprojected));
            self.report["points_in_file"] = points.into();
            self.report["voxel_size"] = voxel.into();
            self.files.push(path);
        }
        if let Some((thinner, request)) = xray_sink.zip(to_draw) {
            let mut points = Points::Thinned(thinner.finish()?);
            let files = request.draw(&mut points, folder, observe);
            self.files.extend(files.or_else(|reason| not_drawn(reason, observe))?);
        }
        Ok(())
    }
}

/// Sink of the points of the cloud: all of them, or thinned.
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

    /// Returns the number of points in the file.
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

/// Writes the requested cloud, and X-rays of maps in 3D; none if nothing is requested. `ingest` and
/// `preparation` are those that the recording was mapped with.
///
/// # Errors
/// Fails if the recording cannot be read again, or a file cannot be written.
pub fn write_clouds<S: Space>(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: &Preparation,
    mapped: &MappedRecording<S>,
    request: &CloudRequest,
    folder: &OutputFolder,
    observe: &mut Observer,
) -> Result<Option<CloudResults>, JobError> {
    let with_xrays = request.draws_xrays(preparation);
    let cloud = request.path(folder.path());
    if cloud.is_none() && !with_xrays {
        return Ok(None);
    }
    if observe(&Event::Drawing).is_break() {
        remark(observe, Remark::StoppedBeforeClouds);
        return Ok(None);
    }
    let poses = mapped.connected_scan_poses();
    mapped.map.whole().map_err(|source| JobError::file(folder.path(), source))?;
    let view = with_xrays.then(|| xray::Request::new(&poses, &mapped.plan, preparation));
    let drawn = match &view {
        Some(view) => draw_kept(view, &mapped.kept_scans, &poses, folder, observe)?,
        None => Some(Vec::new()),
    };
    let mut results = CloudResults { report: serde_json::json!({}), ..CloudResults::default() };
    if with_xrays {
        let source = if drawn.is_some() { "scans kept while mapping" } else { "a second pass" };
        results.report["xrays_from"] = source.into();
    }
    if cloud.is_some() || drawn.is_none() {
        let to_draw = view.as_ref().filter(|_| drawn.is_none());
        let mut reproject = |sink: &mut Sink, observe: &mut Observer| {
            reproject_all(recording, ingest, preparation, &poses, sink, observe)
        };
        let cloud = cloud.zip(Some(request.voxel_size_metres));
        results.add_second_pass(cloud, to_draw, folder, observe, &mut reproject)?;
    }
    results.files.extend(drawn.into_iter().flatten());
    Ok(Some(results))
}

/// Draws X-rays of the scans that mapping kept; none if these are not complete.
fn draw_kept(
    request: &xray::Request,
    scans: &KeptScans,
    poses: &[(Time, Rigid3)],
    folder: &OutputFolder,
    observe: &mut Observer,
) -> Result<Option<Vec<PathBuf>>, JobError> {
    if let Some(error) = scans.failure() {
        let (folder, reason) = (folder.path().to_owned(), error.to_string());
        remark(observe, Remark::ScansNotKept { folder, reason });
    }
    if !scans.is_complete() {
        return Ok(None);
    }
    let motion = SmoothMotion::new(poses.to_vec());
    match request.draw(&mut Points::Kept(scans, &motion), folder, observe) {
        Ok(files) => Ok(Some(files)),
        Err(NotDrawn::Kept(error)) => {
            remark(observe, Remark::KeptScansUnreadable(error));
            Ok(None)
        }
        Err(other) => not_drawn(other, observe).map(Some),
    }
}

fn not_drawn(reason: NotDrawn, observe: &mut Observer) -> Result<Vec<PathBuf>, JobError> {
    match reason {
        NotDrawn::Interrupted => {
            remark(observe, Remark::StoppedXrays);
            Ok(Vec::new())
        }
        NotDrawn::Points(error) => Err(error.into()),
        NotDrawn::Kept(error) => Err(JobError::KeptScans(error)),
        NotDrawn::Failed(error) => Err(error),
    }
}

/// Places all points of a recording within the range limits of mapping by the poses of its trajectory. `sink`
/// receives the points of each sweep in order of the recording.
fn reproject_all(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: &Preparation,
    poses: &[(Time, Rigid3)],
    sink: &mut Sink,
    observe: &mut Observer,
) -> Result<Reprojected, JobError> {
    let motion = SmoothMotion::new(poses.to_vec());
    let mut reprojector = Reprojector::new(&motion, limits_of_mapping(preparation));
    let mut ingestion = range_sensors(recording, ingest, preparation)?;
    let mut interrupted = false;
    while let Some((_, measurement)) = ingestion.next_measurement().map_err(PipelineError::from)? {
        let Measurement::Range(sweep) = measurement else { continue };
        sink(reprojector.place(&sweep))?;
        let (position_bytes, total_bytes) = ingestion.progress();
        interrupted = observe(&Event::PlacingPoints { position_bytes, total_bytes }).is_break();
        if interrupted {
            break;
        }
    }
    // The work is done, so the answer is ignored.
    let _ = observe(&Event::PointsPlaced);
    Ok(Reprojected { interrupted, ..reprojector.reprojected() })
}

/// The range limits of mapping.
fn limits_of_mapping(preparation: &Preparation) -> RangeLimits {
    let builder = &preparation.options.trajectory_builder;
    let (two, three) = (&builder.trajectory_builder_2d, &builder.trajectory_builder_3d);
    match preparation.dimension {
        Dimension::TwoD => RangeLimits { min_range: two.min_range, max_range: two.max_range },
        Dimension::ThreeD => RangeLimits { min_range: three.min_range, max_range: three.max_range },
    }
}

/// Reads the range sensors that mapping read, and nothing else.
fn range_sensors(
    recording: &dyn Recording,
    ingest: &IngestOptions,
    preparation: &Preparation,
) -> Result<Ingestion, PipelineError> {
    let mut plan = preparation.plan.clone();
    (plan.imu, plan.odometry) = (None, None);
    (plan.nav_sat, plan.fixed_frame_pose, plan.landmarks) = (None, None, None);
    let ingest =
        IngestOptions { with_intensities: true, num_subdivisions_per_laser_scan: 1, ..ingest.clone() };
    Ok(Ingestion::with_plan(recording, preparation.inventory(), plan, &ingest)?)
}
