//! `portolan evaluate cloud`.

use std::path::{Path, PathBuf};

use portolan_evaluation::cloud::{
    Sharpness, SharpnessOptions, SolidBox, SurfaceErrors, WallThickness, read_boxes, sharpness,
    spread_sample, surface_errors, wall_thickness,
};
use portolan_evaluation::{Alignment, Association, Trajectory, absolute_errors};
use portolan_geometry::{Quaternion, Rigid3, nalgebra as na};
use portolan_recording::open_all;
use portolan_refinement::PointStore;
use portolan_refinement::continuous::DenseTrajectory;
use serde::Serialize;

use super::input::TrajectorySource;
use crate::GlobalArgs;
use crate::commands::refine::points::{PointArgs, read_points};
use crate::error::{CliError, Outcome};
use crate::output::{print, print_json};

/// Edge of the cells in which walls are looked for, metres.
const WALL_CELL: f64 = 0.5;

/// Judge the cloud that a trajectory makes of the points of a recording: how sharp it is, and with the truth
/// how far its points are from the true surfaces.
///
/// Each point is placed with the trajectory at its own time. Sharpness can only be compared between clouds of
/// one density, measured with equal options. Several trajectories are compared with the first.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    portolan evaluate cloud walk.bag walk.tum walk_refined/refined.tum\n  \
    portolan evaluate cloud walk.bag refined.tum --surfaces walk.surfaces.csv --truth walk.truth.tum")]
pub struct CloudArgs {
    /// The recording with the raw points.
    recording: PathBuf,
    /// Trajectories: TUM, a map, or a table with a line of names.
    #[arg(required = true, value_name = "TRAJECTORY")]
    trajectories: Vec<PathBuf>,
    #[command(flatten)]
    points: PointArgs,
    /// True surfaces: solid boxes, one a line, `x0,y0,z0,x1,y1,z1` in metres.
    #[arg(long, value_name = "FILE")]
    surfaces: Option<PathBuf>,
    /// The true trajectory, onto which each one is laid (rigidly, by least squares over its positions) before
    /// its points are compared with the surfaces. Without it the frames must be the same.
    #[arg(long, value_name = "FILE", requires = "surfaces")]
    truth: Option<PathBuf>,
    /// Radius of the neighbourhoods, metres.
    #[arg(long, value_name = "METRES", default_value_t = SharpnessOptions::default().radius)]
    radius: f64,
    /// So many points are looked at.
    #[arg(long, value_name = "N", default_value_t = SharpnessOptions::default().max_points)]
    sample: usize,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct CloudReport {
    trajectory: String,
    points: usize,
    sharpness: Option<Sharpness>,
    walls: Option<WallThickness>,
    surfaces: Option<SurfaceErrors>,
}

pub fn run(args: &CloudArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    if !(args.radius > 0.0 && args.radius < 1e3) {
        return Err(CliError::Usage(format!("--radius must be above 0 m, but is {}", args.radius)));
    }
    let recording = open_all(std::slice::from_ref(&args.recording))?;
    let read = read_points(recording.as_ref(), &args.points, global)?;
    let boxes = args.surfaces.as_deref().map(boxes_of).transpose()?;
    let truth = args.truth.as_deref().map(|path| trajectory_of(path, global)).transpose()?;
    let mut reports = Vec::new();
    for path in &args.trajectories {
        let trajectory = trajectory_of(path, global)?;
        let cloud = cloud(&read.store, &trajectory, args.sample)?;
        let surfaces = match (&boxes, &truth) {
            (Some(boxes), Some(truth)) => {
                let world = truth_from(truth, &trajectory)?;
                let aligned: Vec<[f64; 3]> =
                    cloud.iter().map(|p| (world * na::Point3::from(*p)).coords.into()).collect();
                surface_errors(&aligned, boxes)
            }
            (Some(boxes), None) => surface_errors(&cloud, boxes),
            (None, _) => None,
        };
        let options =
            SharpnessOptions { radius: args.radius, max_points: args.sample, ..SharpnessOptions::default() };
        reports.push(CloudReport {
            trajectory: path.display().to_string(),
            points: cloud.len(),
            sharpness: sharpness(&cloud, options),
            walls: wall_thickness(&cloud, WALL_CELL),
            surfaces,
        });
    }
    if args.json {
        print_json(&reports)?
    } else {
        print(&text(&reports))?
    }
    Ok(Outcome::Done)
}

fn boxes_of(path: &Path) -> Result<Vec<SolidBox>, CliError> {
    let file =
        std::fs::File::open(path).map_err(|source| CliError::File { path: path.to_owned(), source })?;
    read_boxes(std::io::BufReader::new(file)).map_err(|error| CliError::in_file(path, error))
}

fn trajectory_of(path: &Path, global: &GlobalArgs) -> Result<Trajectory, CliError> {
    TrajectorySource { path, trajectory_id: 0, times: None, quiet: global.quiet }.read()
}

/// Up to `count` points, spread over all, in the world of a trajectory.
fn cloud(store: &PointStore, trajectory: &Trajectory, count: usize) -> Result<Vec<[f64; 3]>, CliError> {
    let poses: Vec<_> = trajectory.poses().iter().map(|p| (p.time, p.map_from_tracking)).collect();
    let dense = DenseTrajectory::new(&poses).map_err(|error| CliError::Failed(error.to_string()))?;
    let matrices = dense.matrices();
    let offset = store.start().seconds_since(dense.start());
    let end = dense.duration();
    let chosen = spread_sample(store.points().len(), count);
    let points: Vec<[f64; 3]> = chosen
        .into_iter()
        .filter_map(|i| {
            let point = &store.points()[i as usize];
            let seconds = point.seconds() + offset;
            (0.0..=end).contains(&seconds).then(|| matrices.to_world(seconds, point.in_tracking))
        })
        .collect();
    if points.is_empty() {
        return Err(CliError::Failed("no point lies within the time of the trajectory".to_owned()));
    }
    Ok(points)
}

fn truth_from(truth: &Trajectory, estimate: &Trajectory) -> Result<Rigid3, CliError> {
    let errors = absolute_errors(truth, estimate, Association::default(), Alignment::Se3)?;
    let [x, y, z, qx, qy, qz, qw] = errors.truth_from_estimate;
    let rotation = Quaternion::new_normalize(na::Quaternion::new(qw, qx, qy, qz));
    Ok(Rigid3::from_parts(na::Translation3::new(x, y, z), rotation))
}

fn text(reports: &[CloudReport]) -> String {
    let mut parts = Vec::new();
    for report in reports {
        parts.push(format!("{} ({} points)", report.trajectory, report.points));
        parts.extend(report.sharpness.iter().map(ToString::to_string));
        parts.extend(report.walls.iter().map(ToString::to_string));
        parts.extend(report.surfaces.iter().map(ToString::to_string));
    }
    if let [first, others @ ..] = reports {
        for other in others {
            if let (Some(a), Some(b)) = (&first.sharpness, &other.sharpness) {
                let change = b.mean_map_entropy - a.mean_map_entropy;
                let error = a.entropy_standard_error.hypot(b.entropy_standard_error);
                let verdict = match change {
                    c if c < -2.0 * error => "sharper than",
                    c if c > 2.0 * error => "less sharp than",
                    _ => "as sharp as",
                };
                parts.push(format!(
                    "{} is {verdict} {}: entropy {change:+.3} ± {error:.3}",
                    other.trajectory, first.trajectory
                ));
            }
        }
    }
    parts.join("\n")
}
