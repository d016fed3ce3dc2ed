//! Numbered files of KITTI and their times.

use std::path::{Path, PathBuf};

use portolan_geometry::{Duration, Time};

use crate::RecordingError;
use portolan_issue::{Issue, IssueKind, IssueLog};

/// Maximum size of a list of times, bytes.
const MAX_LIST_BYTES: u64 = 1 << 28;

/// The number that is the file's name.
pub(super) fn number_of(path: &Path) -> Option<usize> {
    path.file_stem()?.to_str()?.parse().ok()
}

/// The files of a folder whose name is a number, with this extension, in ascending order.
pub(super) fn numbered_files(folder: &Path, extension: &str) -> Result<Vec<PathBuf>, RecordingError> {
    let error = |source| RecordingError::Io { path: folder.to_owned(), source };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(error)? {
        let path = entry.map_err(error)?.path();
        if path.extension().is_some_and(|e| e == extension) && number_of(&path).is_some() {
            files.push(path);
        }
    }
    files.sort_by_key(|path| number_of(path));
    Ok(files)
}

/// Pairs each file with the time of its number; files without a time are counted.
pub(super) fn paired(
    files: Vec<PathBuf>,
    times: Vec<Option<Time>>,
    what: &str,
    issues: &mut IssueLog,
) -> impl Iterator<Item = (PathBuf, Time)> {
    let count = files.len();
    let time = move |path: &PathBuf| times.get(number_of(path)?).copied().flatten();
    let pairs: Vec<(PathBuf, Time)> =
        files.into_iter().filter_map(|path| time(&path).map(|time| (path, time))).collect();
    let missing = (count - pairs.len()) as u64;
    issues.add(Issue::new(IssueKind::WithoutTime).with("what", what).times(missing));
    pairs.into_iter()
}

/// Reads a list of dates, one line for each number; a line that is not a date gives none.
pub(super) fn date_file(path: &Path) -> Result<Vec<Option<Time>>, RecordingError> {
    Ok(lines(path)?.iter().map(|line| parse_date(line)).collect())
}

/// Reads a list of seconds since `start`.
pub(super) fn seconds_file(path: &Path, start: Time) -> Result<Vec<Option<Time>>, RecordingError> {
    let time = |line: &String| {
        let seconds: f64 = line.trim().parse().ok()?;
        (seconds.is_finite() && seconds.abs() < 1e9).then(|| start + Duration::from_seconds(seconds))
    };
    Ok(lines(path)?.iter().map(time).collect())
}

/// The lines of a list; empty if the file is missing.
fn lines(path: &Path) -> Result<Vec<String>, RecordingError> {
    let error = |source| RecordingError::Io { path: path.to_owned(), source };
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_file() && metadata.len() <= MAX_LIST_BYTES => {
            let bytes = std::fs::read(path).map_err(error)?;
            Ok(String::from_utf8_lossy(&bytes).lines().map(str::to_owned).collect())
        }
        _ => Ok(Vec::new()),
    }
}

/// Parses `2011-09-26 13:02:25.594360375` as UTC.
fn parse_date(text: &str) -> Option<Time> {
    let (date, time) = text.trim().split_once(' ')?;
    let mut date = date.split('-').map(|part| part.parse::<i64>().ok());
    let (year, month, day) = (date.next()??, date.next()??, date.next()??);
    let mut time = time.split(':');
    let (hours, minutes): (i64, i64) = (time.next()?.parse().ok()?, time.next()?.parse().ok()?);
    let seconds = Time::from_unix_decimal(time.next()?)?;
    let is_valid = (1970..3000).contains(&year)
        && (1..=12).contains(&month)
        && (1..=31).contains(&day)
        && (0..24).contains(&hours)
        && (0..60).contains(&minutes);
    // Days since 1970 of the Gregorian calendar (Fliegel and Van Flandern, 1968).
    let a = (month - 14) / 12;
    let julian = (1461 * (year + 4800 + a)) / 4 + (367 * (month - 2 - 12 * a)) / 12
        - (3 * ((year + 4900 + a) / 100)) / 4
        + day
        - 32_075;
    let whole = (julian - 2_440_588) * 86_400 + hours * 3600 + minutes * 60;
    is_valid.then(|| Time::from_ros(whole, 0) + (seconds - Time::UNIX_EPOCH))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_exact() {
        let time = parse_date("2011-09-26 13:02:25.594360375").unwrap();
        assert_eq!(time.unix_decimal(), "1317042145.5943604");
        assert_eq!(parse_date("1970-01-01 00:00:00.25"), Some(Time::from_ros(0, 250_000_000)));
        assert_eq!(parse_date("2000-02-29 00:00:00"), Some(Time::from_ros(951_782_400, 0)));
        for wrong in ["", "2011-13-26 13:02:25", "2011-09-26", "x-09-26 1:2:3", "2011-09-26 13:02:x"] {
            assert_eq!(parse_date(wrong), None, "{wrong}");
        }
    }
}
