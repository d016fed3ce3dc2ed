//! `portolan evaluate loops`: checks the loop closures of a map against a true trajectory.

use std::path::PathBuf;

use portolan::trajectory_file::TrajectoryFile;
use portolan_evaluation::{
    RIGHT_WITHIN, Trajectory, at_times_of, in_time_base, loop_closure_relations, relation_errors,
};
use portolan_geometry::Duration;

use super::generate::read_map_graph;
use super::input::read_trajectory;
use crate::GlobalArgs;
use crate::error::{CliError, Outcome};
use crate::output::{print, print_json, write_file};
use crate::progress::print_line;

/// Maximum time difference between a loop closure and the true pose that it is compared with, seconds.
const MAX_TIME_DIFFERENCE: f64 = 2.5;

/// Evaluate the loop closures of a map against a true trajectory: how many are correct.
///
/// A loop closure is correct if the relative pose that it implies, from the nearest node of its submap to the
/// node that was matched to it, is within 0.2 m and 3 degrees of the truth. It is compared between the true
/// poses nearest in time; the short motion to them is taken from the map.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  portolan evaluate loops walk/map.pbstream walk.truth.tum --csv loops.csv"
)]
pub struct LoopsArgs {
    /// Map (.pbstream).
    map: PathBuf,
    /// True trajectory: TUM, KITTI poses, a table with a header line, or a map.
    truth: PathBuf,
    /// Also write the error of each loop closure as a table, with the times of its two ends.
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(args: &LoopsArgs, global: &GlobalArgs) -> Result<Outcome, CliError> {
    let truth = TrajectoryFile { path: &args.truth, trajectory_id: None, times: None };
    let truth = read_trajectory(truth, global.quiet)?;
    let map = read_map_graph(&args.map)?;
    let loops = loop_closure_relations(&map).map_err(|error| CliError::in_file(&args.map, error))?;
    if loops.len() < 2 {
        return Err(CliError::in_file(&args.map, "it has fewer than two loop closures to judge"));
    }
    let (in_time, notice) = in_time_base(&truth, &loops)?;
    let offset = notice.as_ref().map_or(Duration::ZERO, |notice| notice.offset);
    let estimate = Trajectory::new(map.nodes.values().copied()).0.shifted(offset);
    let judged = at_times_of(&truth, &estimate, &in_time, Duration::from_seconds(MAX_TIME_DIFFERENCE));
    let left_out = loops.len() - judged.len();
    if left_out > 0 && !global.quiet {
        print_line(&format!(
            "{left_out} loop closures have no true pose within {MAX_TIME_DIFFERENCE} s and are not judged"
        ));
    }
    if judged.len() < 2 {
        return Err(CliError::in_file(&args.truth, "it has no poses at the times of the loop closures"));
    }
    let loops = judged;
    let report = relation_errors(&truth, &loops)?;
    if let Some(path) = &args.csv {
        write_file(path, |out| report.write_csv_with_times(out))?;
    }
    if let Some(notice) = notice.filter(|_| !global.quiet) {
        print_line(&notice.to_string());
    }
    let fraction = report.fraction_right(RIGHT_WITHIN);
    if args.json {
        print_json(&serde_json::json!({ "fraction_right": fraction, "errors": report }))?;
    } else {
        print(&format!(
            "{} loop closures, {:.1} % right (within {} m and {} deg); median {:.3} m and {:.2} deg, \
             at most {:.3} m and {:.2} deg",
            report.count,
            100.0 * fraction,
            RIGHT_WITHIN.0,
            RIGHT_WITHIN.1,
            report.translation.median,
            report.rotation_degrees.median,
            report.translation.max,
            report.rotation_degrees.max,
        ))?;
    }
    Ok(Outcome::Done)
}
