//! `portolan evaluate relations`: compares the motions of a trajectory with known relations.

use std::path::{Path, PathBuf};

use portolan::trajectory_file::TrajectoryFile;
use portolan_evaluation::{RelationError, RelationReport, TimeBaseNotice, in_time_base, relation_errors};
use portolan_export::{HistogramPanel, draw_histograms, write_picture};
use serde::Serialize;

use super::input::{read_relations_file, read_trajectory};
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{counted, print, print_json, write_file};
use crate::progress::print_line;

/// Translational error below which a relation counts as right, metres.
const GOOD: f64 = 0.2;

/// Compare the relative poses of a trajectory with known ones (relations).
///
/// The result is that of cartographer_compute_relations_metrics: mean and standard deviation over all
/// relations. Poses are interpolated at the times of the relations; for times outside the trajectory its
/// nearest end is taken, and their number is reported. Relations with times from the start of a CARMEN log
/// are shifted to the clock of the trajectory, with a notice.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  portolan evaluate relations aces.pbstream aces.relations\n  \
    portolan evaluate relations trajectory.tum aces.relations --csv errors.csv\n  \
    portolan evaluate relations aces.pbstream aces.relations --histogram errors.png")]
pub struct RelationsArgs {
    /// Map (.pbstream), or trajectory: TUM, KITTI poses, or a table with a header line.
    #[arg(value_name = "MAP_OR_TRAJECTORY")]
    estimate: PathBuf,
    /// Relations: lines `time1 time2 x y z roll pitch yaw`, or the binary form of `evaluate generate`.
    relations: PathBuf,
    /// Also write the error of each relation as a table.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Also draw a histogram of the errors.
    #[arg(long, value_name = "FILE.png")]
    histogram: Option<PathBuf>,
    /// Trajectory of a map. Default: all of them if they follow one another in time, as the pieces of one
    /// recording do, else the one with the lowest id.
    #[arg(long, value_name = "ID")]
    trajectory: Option<i32>,
    /// Times of KITTI poses, one per line.
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// Print JSON, with more figures.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    report: &'a RelationReport,
    /// Fraction of the relations with a translational error within 0.2 m, 0 to 1.
    share_within_0_2_metres: f64,
    /// Time offset that was added to the times of the relations, seconds.
    time_shift: f64,
}

pub fn run(args: &RelationsArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let estimate =
        TrajectoryFile { path: &args.estimate, trajectory_id: args.trajectory, times: args.times.as_deref() };
    let trajectory = read_trajectory(estimate, global.quiet)?;
    let relations = read_relations_file(&args.relations)?;
    let (relations, notice) = in_time_base(&trajectory, &relations)?;
    let report = relation_errors(&trajectory, &relations)?;
    if let Some(path) = &args.csv {
        write_file(path, |out| report.write_csv(out))?;
    }
    if let Some(path) = &args.histogram {
        draw(&report, path)?;
    }
    if !global.quiet {
        remark(&report, notice.as_ref());
    }
    if args.json {
        let time_shift = notice.map_or(0.0, |notice| notice.offset.seconds());
        let share_within_0_2_metres = report.share_within(GOOD);
        print_json(&Report { report: &report, share_within_0_2_metres, time_shift })?;
    } else {
        print(&format!("Result:\n{report}"))?;
    }
    Ok(Outcome::Done)
}

/// Draws the histograms of translational and rotational errors, one below the other.
fn draw(report: &RelationReport, path: &Path) -> Result<(), CliError> {
    let values = |of: fn(&RelationError) -> f64| report.errors.iter().map(of).collect::<Vec<f64>>();
    let (translation, rotation) = (values(|e| e.translation), values(|e| e.rotation_degrees));
    let panels = [
        HistogramPanel { title: "translational error, m", values: &translation },
        HistogramPanel { title: "rotational error, deg", values: &rotation },
    ];
    match draw_histograms(&panels) {
        Some(picture) => Ok(write_picture(path, &picture)?),
        None => Ok(()),
    }
}

fn remark(report: &RelationReport, notice: Option<&TimeBaseNotice>) {
    if let Some(notice) = notice {
        print_line(&notice.to_string());
    }
    if report.outside_trajectory > 0 {
        print_line(&format!(
            "{} outside the trajectory; its nearest end was taken instead",
            counted(report.outside_trajectory as u64, "relation reaches", "relations reach")
        ));
    }
    print_line(&format!(
        "{}: {:.1} % within {GOOD} m, median {:.4} m and {:.4} deg",
        counted(report.count as u64, "relation", "relations"),
        100.0 * report.share_within(GOOD),
        report.translation.median,
        report.rotation_degrees.median
    ));
}
