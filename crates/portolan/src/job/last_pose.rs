//! Reads the last pose of an earlier run, as the start of the next one.

use std::collections::BTreeMap;
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

use portolan_geometry::{Rigid3, Vector3, rotation_from_roll_pitch_yaw};
use portolan_input::{Line, read_line, regular_file};
use portolan_localization::{StartPose, State};

/// Minimum standard deviation of the position of a start, metres: a robot may be moved a little between two
/// runs.
const LEAST_METRES: f64 = 0.5;
/// The same of its rotation, radians.
const LEAST_RADIANS: f64 = 10.0 * std::f64::consts::PI / 180.0;
/// Maximum standard deviation of the position, metres: with a larger one a search of the whole map is as
/// good.
const MOST_METRES: f64 = 10.0;
/// The same of the rotation, radians.
const MOST_RADIANS: f64 = 1.0;
/// Maximum length of a line of `poses.csv`, bytes.
const LONGEST_LINE: usize = 4096;

/// Reasons why no start can be read from a file of poses.
#[derive(Debug, thiserror::Error)]
pub enum LastPoseError {
    /// It cannot be opened or read.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// It is not a table written by `localize`.
    #[error("{}, line {line}: {reason}; this should be the poses.csv of `portolan localize`", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// The error.
        reason: String,
    },
    /// No scan was localised in it.
    #[error("{}: none of its scans was localised, so that it gives no start pose", .0.display())]
    NeverLocalised(PathBuf),
}

/// The last localised pose in this `poses.csv`, as a start.
///
/// # Errors
/// If the file cannot be read, is no such table, or has no localised scan.
pub fn last_pose(path: &Path) -> Result<StartPose, LastPoseError> {
    let unreadable = |source| LastPoseError::File { path: path.to_owned(), source };
    let mut reader = BufReader::new(regular_file(path).map_err(unreadable)?);
    let malformed =
        |line, reason: &str| LastPoseError::Malformed { path: path.to_owned(), line, reason: reason.into() };
    let header =
        next_line(&mut reader).map_err(unreadable)?.ok_or_else(|| malformed(1, "the file is empty"))?;
    let columns: BTreeMap<&str, usize> = header.split(',').enumerate().map(|(i, name)| (name, i)).collect();
    let state_column = *columns.get("state").ok_or_else(|| malformed(1, "there is no column \"state\""))?;
    let (mut line, mut last) = (1, None);
    while let Some(text) = next_line(&mut reader).map_err(unreadable)? {
        line += 1;
        if text.split(',').nth(state_column) == Some(State::Localised.name()) {
            last = Some((line, text));
        }
    }
    let (line, text) = last.ok_or_else(|| LastPoseError::NeverLocalised(path.to_owned()))?;
    let fields: Vec<&str> = text.split(',').collect();
    let value = |name: &str| -> Result<f64, LastPoseError> {
        let field = columns.get(name).and_then(|column| fields.get(*column));
        let number = field.and_then(|field| field.parse::<f64>().ok()).filter(|v| v.is_finite());
        number.ok_or_else(|| malformed(line, &format!("there is no number in the column \"{name}\"")))
    };
    // Tables in 2D have no heights, roll or pitch.
    let or_level = |name: &str| if columns.contains_key(name) { value(name) } else { Ok(0.0) };
    let translation = Vector3::new(value("x")?, value("y")?, or_level("z")?);
    let rotation = rotation_from_roll_pitch_yaw(or_level("roll")?, or_level("pitch")?, value("yaw")?);
    let sigma = |variance: f64| variance.max(0.0).sqrt();
    let metres = sigma(value("cov_xx")?.max(value("cov_yy")?));
    Ok(StartPose {
        map_from_tracking: Rigid3::from_parts(translation.into(), rotation),
        sigma_metres: metres.clamp(LEAST_METRES, MOST_METRES),
        sigma_radians: sigma(value("cov_yaw_yaw")?).clamp(LEAST_RADIANS, MOST_RADIANS),
    })
}

fn next_line(reader: &mut impl BufRead) -> io::Result<Option<String>> {
    let mut bytes = Vec::new();
    match read_line(reader, LONGEST_LINE, &mut bytes)? {
        Line::End => Ok(None),
        Line::Whole => Ok(Some(String::from_utf8_lossy(&bytes).into_owned())),
        Line::TooLong => {
            Err(io::Error::new(io::ErrorKind::InvalidData, "a line is too long for a table of poses"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str =
        "time,state,reason,x,y,yaw,cov_xx,cov_xy,cov_x_yaw,cov_yy,cov_y_yaw,cov_yaw_yaw,explained";

    fn start(text: &str) -> Result<StartPose, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("poses.csv");
        std::fs::write(&path, text).unwrap();
        last_pose(&path).map_err(|error| error.to_string())
    }

    #[test]
    fn the_last_localised_pose_is_the_start() {
        let rows = "1,localised,scans_fit,1,2,0.5,0.01,0,0,4,0,0.001,1\n2,localised,scans_fit,3,4,0.25,0.01,0,0,4,0,0.001,1\n\
            3,lost,scans_contradict,,,,,,,,,,\n";
        let start = start(&format!("{HEADER}\n{rows}")).unwrap();
        let at = start.map_from_tracking;
        assert_eq!((at.translation.x, at.translation.y), (3.0, 4.0));
        assert!((portolan_geometry::yaw(&at.rotation) - 0.25).abs() < 1e-12);
        assert_eq!((start.sigma_metres, start.sigma_radians), (2.0, LEAST_RADIANS));
    }

    #[test]
    fn files_without_a_start_are_refused_with_the_reason() {
        let error = |text: &str| start(text).unwrap_err();
        assert!(error("").contains("the file is empty"));
        assert!(error("1 2 3\n").contains("no column \"state\""));
        assert!(
            error(&format!("{HEADER}\n1,searching,no_place_fits,,,,,,,,,,\n")).contains("none of its scans")
        );
        assert!(error(&format!("{HEADER}\n1,localised,scans_fit,1,x,0,1,0,0,1,0,1,1\n")).contains("line 2"));
        assert!(error(&"x".repeat(9000)).contains("too long"));
    }
}
