//! Reads the clouds that are evaluated.

use std::path::{Path, PathBuf};

use portolan::trajectory_file::TrajectoryFile;
use portolan_evaluation::cloud::spread_sample;
use portolan_evaluation::{Alignment, Association, Trajectory, absolute_errors};
use portolan_geometry::{Quaternion, Rigid3, nalgebra as na};
use portolan_recording::{Recording, RecordingError, open_all};
use portolan_refinement::PointStore;
use portolan_refinement::continuous::DenseTrajectory;

use crate::GlobalArgs;
use crate::clouds::read_cloud;
use crate::commands::evaluate::input::read_trajectory;
use crate::commands::refine::points::{PointArgs, read_points};
use crate::error::CliError;

/// Number of points that are read from a file before they are thinned evenly to the sample, as a multiple of its size.
const SPARE: usize = 4;

/// A cloud that is evaluated.
pub struct JudgedCloud {
    /// Path of the cloud, or of its trajectory.
    pub name: String,
    /// Number of points before thinning.
    pub total: u64,
    /// Points, metres.
    pub points: Vec<[f64; 3]>,
    /// Times of the points, seconds; empty if unknown.
    pub seconds: Vec<f64>,
    /// Positions of the same points in the first cloud, metres; empty if the clouds have no common points.
    pub places: Vec<[f64; 3]>,
    /// Alignment of the cloud with the truth, from the trajectories; none without a true trajectory.
    pub truth_from_cloud: Option<Rigid3>,
}

/// All clouds that are evaluated.
pub struct Clouds {
    pub clouds: Vec<JudgedCloud>,
    pub lost_data: bool,
}

/// Reads clouds, or a recording and trajectories: the format of the first file decides.
pub fn read_clouds(
    inputs: &[PathBuf],
    point_args: &PointArgs,
    truth: Option<&Path>,
    sample: usize,
    global: &GlobalArgs,
) -> Result<Clouds, CliError> {
    let Some((first, others)) = inputs.split_first() else {
        return Err(CliError::Usage("a cloud, or a recording and a trajectory, is needed".to_owned()));
    };
    match open_all(std::slice::from_ref(first)) {
        Ok(recording) if others.is_empty() => Err(CliError::Usage(format!(
            "{} is a recording{}: name the trajectory to judge it with",
            first.display(),
            if recording.size_bytes() == 0 { " (an empty one)" } else { "" }
        ))),
        Ok(recording) => of_recording(recording.as_ref(), others, point_args, truth, sample, global),
        Err(RecordingError::UnknownFormat { .. }) if truth.is_some() => Err(CliError::Usage(
            "--truth needs a recording and trajectories; clouds are laid onto surfaces with --fit".to_owned(),
        )),
        Err(RecordingError::UnknownFormat { .. }) => of_files(inputs, sample, global),
        Err(error) => Err(error.into()),
    }
}

fn of_files(paths: &[PathBuf], sample: usize, global: &GlobalArgs) -> Result<Clouds, CliError> {
    let mut clouds = Clouds { clouds: Vec::new(), lost_data: false };
    for path in paths {
        let read = read_cloud(path, sample.saturating_mul(SPARE), global.quiet)?;
        clouds.lost_data |= read.lost_data();
        let chosen = spread_sample(read.points.len(), sample);
        let pick = |values: &[f64]| chosen.iter().filter_map(|i| values.get(*i as usize).copied()).collect();
        clouds.clouds.push(JudgedCloud {
            name: path.display().to_string(),
            total: read.total,
            points: chosen.iter().map(|i| read.points[*i as usize]).collect(),
            seconds: pick(&read.seconds),
            places: Vec::new(),
            truth_from_cloud: None,
        });
    }
    Ok(clouds)
}

fn of_recording(
    recording: &dyn Recording,
    trajectories: &[PathBuf],
    point_args: &PointArgs,
    truth: Option<&Path>,
    sample: usize,
    global: &GlobalArgs,
) -> Result<Clouds, CliError> {
    let read = read_points(recording, point_args, global)?;
    let truth = truth.map(|path| trajectory_of(path, global)).transpose()?;
    let paths = trajectories;
    let trajectories: Vec<Trajectory> =
        paths.iter().map(|path| trajectory_of(path, global)).collect::<Result<_, _>>()?;
    let dense: Vec<DenseTrajectory> = trajectories.iter().map(dense).collect::<Result<_, _>>()?;
    let chosen = within_all(&read.store, &dense, sample);
    if chosen.is_empty() {
        return Err(CliError::Failed(
            "no point of the recording is within the time span of the trajectory (of all trajectories)"
                .to_owned(),
        ));
    }
    let mut clouds = Vec::new();
    let mut places = Vec::new();
    for ((trajectory, dense), path) in trajectories.iter().zip(&dense).zip(paths) {
        let matrices = dense.matrices();
        let offset = read.store.start().seconds_since(dense.start());
        let place = |i: &u32| {
            let point = &read.store.points()[*i as usize];
            matrices.to_world(point.seconds() + offset, point.in_tracking)
        };
        let points: Vec<[f64; 3]> = chosen.iter().map(place).collect();
        if places.is_empty() {
            places.clone_from(&points);
        }
        clouds.push(JudgedCloud {
            name: path.display().to_string(),
            total: read.store.points().len() as u64,
            points,
            seconds: chosen.iter().map(|i| read.store.points()[*i as usize].seconds()).collect(),
            places: places.clone(),
            truth_from_cloud: truth.as_ref().map(|truth| truth_from(truth, trajectory)).transpose()?,
        });
    }
    Ok(Clouds { clouds, lost_data: read.lost_data() })
}

fn trajectory_of(path: &Path, global: &GlobalArgs) -> Result<Trajectory, CliError> {
    read_trajectory(TrajectoryFile { path, trajectory_id: None, times: None }, global.quiet)
}

fn dense(trajectory: &Trajectory) -> Result<DenseTrajectory, CliError> {
    let poses: Vec<_> = trajectory.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    DenseTrajectory::new(&poses).map_err(|error| CliError::Failed(error.to_string()))
}

/// Indices of up to `sample` evenly spread points, without those at times that a trajectory does not cover.
fn within_all(store: &PointStore, trajectories: &[DenseTrajectory], sample: usize) -> Vec<u32> {
    let spans: Vec<(f64, f64)> =
        trajectories.iter().map(|t| (store.start().seconds_since(t.start()), t.duration())).collect();
    let is_covered = |i: &u32| {
        let seconds = store.points()[*i as usize].seconds();
        spans.iter().all(|(offset, duration)| (0.0..=*duration).contains(&(seconds + offset)))
    };
    spread_sample(store.points().len(), sample).into_iter().filter(is_covered).collect()
}

fn truth_from(truth: &Trajectory, estimate: &Trajectory) -> Result<Rigid3, CliError> {
    let errors = absolute_errors(truth, estimate, Association::default(), Alignment::Se3)?;
    let [x, y, z, qx, qy, qz, qw] = errors.truth_from_estimate;
    let rotation = Quaternion::new_normalize(na::Quaternion::new(qw, qx, qy, qz));
    Ok(Rigid3::from_parts(na::Translation3::new(x, y, z), rotation))
}
