//! `portolan evaluate trajectory`: absolute and relative errors of a trajectory.

use std::path::PathBuf;

use portolan::trajectory_file::TrajectoryFile;
use portolan_evaluation::{
    AbsoluteErrors, Alignment, Association, Drift, KITTI_LENGTHS, KITTI_STRIDE, RelativeErrors, Step,
    Trajectory, absolute_errors, drift, relative_errors,
};
use serde::Serialize;

use super::input::{positive_seconds, read_trajectory};
use crate::GlobalArgs;
use crate::commands::argument::{positive_metres, seconds};
use crate::error::{CliError, Outcome};
use crate::output::{print, print_json};
use crate::progress::print_line;

/// Range of heights below which a trajectory counts as 2D, metres.
const FLAT: f64 = 1e-6;

/// Compare a trajectory with the true one: absolute and relative errors.
///
/// Both files may be a map (.pbstream), TUM (`time x y z qx qy qz qw`), KITTI poses (twelve numbers per line,
/// with --times) or a table with a header line; the format is recognised by the content. Both must have
/// stamps of the same clock.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  portolan evaluate trajectory walk_map/trajectory.tum walk.truth.tum\n  \
    portolan evaluate trajectory walk.pbstream walk.truth.tum --align se3 --rpe-distance 10 --json\n  \
    portolan evaluate trajectory 00.txt poses/00.txt --times 00/times.txt --drift"
)]
pub struct TrajectoryArgs {
    /// Trajectory to evaluate.
    estimate: PathBuf,
    /// True trajectory.
    truth: PathBuf,
    /// Alignment of the trajectories before errors are computed: by least squares in 2D (se2) or in 3D (se3),
    /// by the first pose, or none. Default: se2 if the estimate stays at one height, else se3. In 2D heights,
    /// roll and pitch are not compared.
    #[arg(long, value_enum)]
    align: Option<Align>,
    /// Compare with the true pose nearest in time, within this tolerance, instead of interpolating the truth.
    #[arg(long, value_name = "SECONDS", conflicts_with = "max_gap")]
    nearest: Option<f64>,
    /// Do not interpolate over gaps of the truth longer than this.
    #[arg(long, value_name = "SECONDS")]
    max_gap: Option<f64>,
    /// Time step of relative errors, seconds; may be given several times. Default: 1, unless --rpe-distance
    /// is given.
    #[arg(long, value_name = "SECONDS", value_parser = positive_step)]
    rpe: Vec<f64>,
    /// Distance step of relative errors along the true path, metres; may be given several times.
    #[arg(long, value_name = "METRES", value_parser = positive_metres)]
    rpe_distance: Vec<f64>,
    /// Also compute the drift over segments of 100 to 800 m, as the KITTI benchmark does.
    #[arg(long)]
    drift: bool,
    /// Trajectory of a map. Default: all of them if they follow one another in time, as the pieces of one
    /// recording do, else the one with the lowest id.
    #[arg(long, value_name = "ID")]
    trajectory: Option<i32>,
    /// Times of KITTI poses, one per line.
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Align {
    /// Least squares in 2D.
    Se2,
    /// Least squares in 3D.
    Se3,
    /// Equal first poses.
    First,
    /// No alignment.
    None,
}

#[derive(Serialize)]
struct Report {
    absolute: AbsoluteErrors,
    relative: Vec<RelativeErrors>,
    drift: Option<Drift>,
}

/// Time step, seconds, above 0.
fn positive_step(text: &str) -> Result<f64, String> {
    seconds(text)
        .ok()
        .filter(|step| *step > 0.0)
        .ok_or_else(|| format!("expected seconds, more than 0, not \"{text}\""))
}

pub fn run(args: &TrajectoryArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let association = association(args)?;
    let read = |path| {
        let times = args.times.as_deref();
        read_trajectory(TrajectoryFile { path, trajectory_id: args.trajectory, times }, global.quiet)
    };
    let (estimate, truth) = (read(&args.estimate)?, read(&args.truth)?);
    let alignment = alignment(args.align, &estimate);
    let absolute = absolute_errors(&truth, &estimate, association, alignment)?;
    let relative = |step| relative_errors(&truth, &estimate, association, step);
    let report = Report {
        relative: relative_steps(args).into_iter().map(relative).collect::<Result<_, _>>()?,
        drift: match args.drift {
            true => Some(drift(&truth, &estimate, association, &KITTI_LENGTHS, KITTI_STRIDE)?),
            false => None,
        },
        absolute,
    };
    if !global.quiet && report.absolute.count < report.absolute.estimate_poses {
        print_line(&format!(
            "{} of {} poses of the estimate have no counterpart in the truth and were not compared",
            report.absolute.estimate_poses - report.absolute.count,
            report.absolute.estimate_poses
        ));
    }
    if args.json {
        print_json(&report)?
    } else {
        print(&report.text())?
    }
    Ok(Outcome::Done)
}

fn association(args: &TrajectoryArgs) -> Result<Association, CliError> {
    Ok(match (args.nearest, args.max_gap) {
        (Some(seconds), _) => Association::Nearest { tolerance: positive_seconds("--nearest", seconds)? },
        (None, Some(seconds)) => {
            Association::Interpolate { max_gap: Some(positive_seconds("--max-gap", seconds)?) }
        }
        (None, None) => Association::default(),
    })
}

fn alignment(asked: Option<Align>, estimate: &Trajectory) -> Alignment {
    match asked {
        Some(Align::Se2) => Alignment::Se2,
        Some(Align::Se3) => Alignment::Se3,
        Some(Align::First) => Alignment::FirstPose,
        Some(Align::None) => Alignment::None,
        None if is_flat(estimate) => Alignment::Se2,
        None => Alignment::Se3,
    }
}

fn is_flat(trajectory: &Trajectory) -> bool {
    let heights = trajectory.poses().iter().map(|pose| pose.map_from_tracking.translation.z);
    let (low, high) = heights.fold((f64::MAX, f64::MIN), |(low, high), z| (low.min(z), high.max(z)));
    high - low < FLAT
}

fn relative_steps(args: &TrajectoryArgs) -> Vec<Step> {
    let seconds = args.rpe.iter().map(|seconds| Step::Time(*seconds));
    let mut steps: Vec<Step> =
        seconds.chain(args.rpe_distance.iter().map(|metres| Step::Distance(*metres))).collect();
    if steps.is_empty() {
        steps.push(Step::Time(1.0));
    }
    steps
}

impl Report {
    fn text(&self) -> String {
        let mut parts = vec![self.absolute.to_string()];
        parts.extend(self.relative.iter().map(ToString::to_string));
        parts.extend(self.drift.iter().map(ToString::to_string));
        parts.join("\n")
    }
}
