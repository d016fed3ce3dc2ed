//! Writes the results of a refinement.

use std::path::{Path, PathBuf};

use portolan_export::write_tum;
use portolan_geometry::{Duration, Rigid3, Time};
use portolan_mapfile::MapDraft;
use portolan_pbstream::ReadLimits;
use portolan_pointcloud::{Attributes, BATCH_POINTS, CloudError, PointCloud, WriteOptions, create};
use portolan_refinement::continuous::Refined;

use super::cloud_pair::CloudPair;
use super::judgement::Judgement;
use super::page::report_page;
use super::pictures::pictures;
use super::points::ReadPoints;
use crate::job::error::write_file;
use crate::job::event::{Event, Remark, remark};
use crate::job::{JobError, Observer, OutputFolder, REPORT_VERSION, Stale, resident_and_peak_bytes};

/// Interval between poses of the input above which these do not show the whole correction, seconds.
const SPARSE: f64 = 0.05;
/// Seconds between the poses of the dense trajectory.
const DENSE: f64 = 0.02;

/// Results of a finished refinement.
pub struct RefineResults<'a> {
    /// The trajectory it began with.
    pub input: &'a [(Time, Rigid3)],
    /// The refined trajectory and its report.
    pub refined: &'a Refined,
    /// The points, and how they were read.
    pub read: &'a ReadPoints,
    /// Time of the whole refinement, seconds.
    pub seconds: f64,
    /// Files of the cloud, relative to the folder; their extensions give the format.
    pub clouds: &'a [String],
    /// Recordings, trajectory and map.
    pub files: &'a [PathBuf],
    /// The command line, for the page; none for no page.
    pub command: Option<&'a str>,
    /// Whether no cloud and no map are written, because the result is not better than the input.
    pub without_results: bool,
    /// The map the trajectory came from, and which of its trajectories.
    pub map: Option<(&'a Path, i32)>,
}

/// The files that [`write_refinement`] writes, depending on the request. Clouds without a name of their own
/// have these names, too.
pub const REFINED_FILES: [&str; 11] = [
    "refined.tum",
    "refined_dense.tum",
    "refined.pbstream",
    "refined.ply",
    "refined.pcd",
    "refined.xyz",
    "refined.las",
    "refined.laz",
    "refined.e57",
    "report.html",
    "report.json",
];

/// Writes trajectory, cloud and report; returns their names.
///
/// # Errors
/// Files that cannot be written, and a map whose trajectory cannot be replaced.
pub fn write_refinement(
    results: &RefineResults,
    folder: &OutputFolder,
    observe: &mut Observer,
) -> Result<Vec<PathBuf>, JobError> {
    let mut files = Vec::new();
    let mut file = |name: &str| folder.add(name, &mut files);
    let trajectory = &results.refined.trajectory;
    let corrected: Vec<(Time, Rigid3)> =
        results.input.iter().map(|(time, pose)| (*time, trajectory.corrected(*time, pose))).collect();
    // Without an improvement this is the input.
    write_tum(&file("refined.tum")?, &corrected)?;
    let duration = trajectory.duration();
    if !results.without_results && duration > SPARSE * (results.input.len() - 1) as f64 {
        let dense: Vec<(Time, Rigid3)> = (0..=(duration / DENSE) as usize)
            .map(|i| i as f64 * DENSE)
            .map(|s| (trajectory.start() + Duration::from_seconds(s), trajectory.pose(s)))
            .collect();
        write_tum(&file("refined_dense.tum")?, &dense)?;
    }
    if let Some((map, id)) = results.map.filter(|_| !results.without_results) {
        let failed = |error| JobError::Edit { path: map.to_owned(), reason: Box::new(error) };
        let mut draft = MapDraft::open(map, ReadLimits::default()).map_err(failed)?;
        draft.replace_trajectory(id, &corrected).map_err(failed)?;
        draft.write(file("refined.pbstream")?).map_err(failed)?;
    }
    let pair = CloudPair::new(&results.read.store, results.refined);
    let start = results.read.store.start().unix_seconds();
    // After a stop the user has the trajectory, from which the rest can be made again.
    let is_stopped = observe(&Event::Drawing).is_break();
    if is_stopped {
        remark(observe, Remark::StoppedBeforeRefinedCloud);
    }
    for name in results.clouds.iter().filter(|_| !is_stopped && !results.without_results) {
        write_cloud(&pair, start, &file(name)?)?;
    }
    let judgement = results.command.filter(|_| !is_stopped).map(|_| Judgement::of(&pair));
    if let (Some(judgement), Some(command)) = (&judgement, results.command) {
        let pictures = pictures(&pair, trajectory, &judgement.largest_changes);
        let page = report_page(results, judgement, &pictures, command)?;
        write_file(&file("report.html")?, page.as_bytes())?;
    }
    let report = serde_json::to_vec_pretty(&report(results, judgement.as_ref()))?;
    write_file(&file("report.json")?, &report)?;
    let stale = if is_stopped || results.without_results { Stale::Name } else { Stale::Remove };
    folder.finish(stale, results.files, observe)?;
    Ok(files)
}

/// Writes all points within the trajectory, in order of time.
fn write_cloud(pair: &CloudPair, start: f64, path: &Path) -> Result<(), JobError> {
    let failed = |reason: CloudError| JobError::CloudFile { path: path.to_owned(), reason };
    let attributes = Attributes { time: true, ..Attributes::default() };
    let mut writer = create(path, attributes, &WriteOptions::default()).map_err(failed)?;
    let mut batch = PointCloud::new(attributes);
    for (seconds, position) in pair.refined() {
        batch.push(position, 0.0, start + seconds, [0; 3]);
        if batch.len() == BATCH_POINTS {
            writer.write(&batch).map_err(failed)?;
            batch.reset(attributes);
        }
    }
    writer.write(&batch).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(())
}

fn report(results: &RefineResults, judgement: Option<&Judgement>) -> serde_json::Value {
    let plan = &results.read.plan;
    let topics: Vec<&str> = plan.range.iter().map(|r| &*r.source.topic).collect();
    serde_json::json!({
        "version": REPORT_VERSION,
        "tracking_frame": plan.tracking_frame,
        "range_topics": topics,
        "poses": results.input.len(),
        "trajectory_seconds": results.refined.trajectory.duration(),
        "wall_seconds": results.seconds,
        "peak_memory_bytes": resident_and_peak_bytes().map(|(_, peak)| peak),
        "refinement": results.refined.report,
        "quality": judgement,
        "issues": results.read.issues,
        "data_lost": results.read.lost_data(),
    })
}
