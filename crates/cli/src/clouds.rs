//! Reads point clouds and reports repairs.

use std::path::Path;

use portolan::job::ReadCloud;
use portolan_pointcloud::{CloudError, CloudReader};

use crate::error::CliError;
use crate::output::counted;
use crate::progress::print_line;

/// Reads a cloud of any format, or a folder of uos scans, thinned if it has more than `limit` points. Repairs are
/// reported on stderr.
///
/// # Errors
/// Fails if the file cannot be read or has no points.
pub fn read_cloud(path: &Path, limit: usize, quiet: bool) -> Result<ReadCloud, CliError> {
    reported(portolan::job::read_cloud(path, limit), path, quiet)
}

/// As [`read_cloud`], from a reader; `path` is used in messages only.
///
/// # Errors
/// As [`read_cloud`].
pub fn read_cloud_from(
    reader: Box<dyn CloudReader>,
    path: &Path,
    limit: usize,
    quiet: bool,
) -> Result<ReadCloud, CliError> {
    reported(portolan::job::read_cloud_from(reader, limit), path, quiet)
}

fn reported(cloud: Result<ReadCloud, CloudError>, path: &Path, quiet: bool) -> Result<ReadCloud, CliError> {
    let cloud = cloud.map_err(|error| CliError::Failed(error.to_string()))?;
    for issue in cloud.issues.iter().filter(|_| !quiet) {
        print_line(&format!("{}: {} ({})", path.display(), issue, counted(issue.count, "time", "times")));
    }
    if cloud.not_finite > 0 && !quiet {
        print_line(&format!(
            "{}: {} with coordinates that are not numbers were left out",
            path.display(),
            counted(cloud.not_finite, "point", "points")
        ));
    }
    if cloud.points.is_empty() {
        return Err(CliError::in_file(path, "there are no points in it"));
    }
    Ok(cloud)
}
