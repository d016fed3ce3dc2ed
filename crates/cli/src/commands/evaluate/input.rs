//! Reads trajectories and relations from files of any format, and reports repairs.

use std::path::Path;

use portolan::trajectory_file::{ReadTrajectory, TrajectoryFile};
use portolan_evaluation::{EvaluationError, Relation, Trajectory, read_relations};
use portolan_geometry::Duration;
use portolan_input::Forward;

use crate::error::CliError;
use crate::input::{open_forward, read_bytes};
use crate::progress::print_line;

/// Reads a trajectory; reports repairs on stderr.
pub fn read_trajectory(file: TrajectoryFile, quiet: bool) -> Result<Trajectory, CliError> {
    read_trajectory_from(open_forward(file.path)?, file, quiet)
}

/// Reads a trajectory from an opened input.
pub fn read_trajectory_from(
    input: Forward,
    file: TrajectoryFile,
    quiet: bool,
) -> Result<Trajectory, CliError> {
    let ReadTrajectory { trajectory, notes } = file.read_from(input)?;
    if !quiet {
        report_notes(file.path, &notes);
    }
    Ok(trajectory)
}

/// Reports repairs of a file on stderr.
pub fn report_notes(path: &Path, notes: &[String]) {
    notes.iter().for_each(|note| print_line(&format!("{}: {note}", path.display())));
}

/// Reads relations, text or binary.
pub fn read_relations_file(path: &Path) -> Result<Vec<Relation>, CliError> {
    let bytes = read_bytes(path)?;
    if let Some(kind) = portolan_input::kind_of(&bytes) {
        return Err(CliError::in_file(path, format!("this is {kind}, and no relations, which come second")));
    }
    read_relations(&bytes).map_err(|error: EvaluationError| CliError::in_file(path, error))
}

/// Seconds as a duration. A value that is not a number or not above 0 is wrong usage.
pub fn positive_seconds(option: &str, seconds: f64) -> Result<Duration, CliError> {
    if seconds > 0.0 && seconds < 1e9 {
        return Ok(Duration::from_seconds(seconds));
    }
    Err(CliError::Usage(format!("{option} must be seconds above 0, but is {seconds}")))
}
