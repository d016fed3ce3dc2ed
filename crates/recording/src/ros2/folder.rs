//! Finds the files of one recording in a folder: ROS 2 bags with `metadata.yaml`, or bags recorded in parts.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use crate::RecordingError;
use portolan_issue::{Issue, IssueKind, IssueLog};

/// Files of a folder in the order in which they were recorded.
pub(crate) struct FolderFiles {
    pub(crate) files: Vec<PathBuf>,
    pub(crate) issues: Vec<Issue>,
}

/// Maximum size of `metadata.yaml`, bytes; a longer one is ignored.
const MAX_METADATA_BYTES: u64 = 1 << 24;

/// Finds the recording's files; `is_recording` decides whether a file is one. `None` if there are none.
pub(crate) fn files(
    folder: &Path,
    is_recording: &dyn Fn(&Path) -> bool,
) -> Result<Option<FolderFiles>, RecordingError> {
    let mut issues = IssueLog::default();
    let metadata = folder.join("metadata.yaml");
    if metadata.is_file() {
        let listed = match std::fs::metadata(&metadata).map(|metadata| metadata.len()) {
            Ok(length) if length <= MAX_METADATA_BYTES => std::fs::read(&metadata),
            Ok(_) => Ok(Vec::new()),
            Err(error) => Err(error),
        };
        let listed = listed.map_err(|source| RecordingError::Io { path: metadata.clone(), source })?;
        let listed = relative_file_paths(&String::from_utf8_lossy(&listed));
        let mut files = Vec::new();
        for entry in &listed {
            match resolve(folder, entry) {
                Some(file) => files.push(file),
                None => issues.add(IssueKind::ListedFileMissing),
            }
        }
        if !files.is_empty() {
            return Ok(Some(FolderFiles { files, issues: issues.list() }));
        }
        if listed.is_empty() {
            issues.add(IssueKind::NoFilesListed);
        }
    }
    let error = |source| RecordingError::Io { path: folder.to_owned(), source };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(error)? {
        let path = entry.map_err(error)?.path();
        if path.is_file() && is_recording(&path) {
            files.push(path);
        }
    }
    files.sort_by(|a, b| natural_order(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok((!files.is_empty()).then(|| FolderFiles { files, issues: issues.list() }))
}

/// The file that an entry of the metadata refers to. Old recorders put the folder's name in front. Files
/// outside of the folder are not opened.
fn resolve(folder: &Path, entry: &str) -> Option<PathBuf> {
    use std::path::Component;
    let relative = Path::new(entry);
    let inside = relative.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    let as_written = inside.then(|| folder.join(relative));
    let by_name = relative.file_name().map(|name| folder.join(name));
    as_written.into_iter().chain(by_name).find(|path| path.is_file())
}

/// Parses the list `relative_file_paths` of a ROS 2 bag's metadata, as block (`- a.mcap`) or flow (`[a, b]`)
/// list. Nothing else is needed: topics and compression are known from the files themselves.
fn relative_file_paths(yaml: &str) -> Vec<String> {
    let mut lines = yaml.lines().skip_while(|line| !line.trim_start().starts_with("relative_file_paths:"));
    let Some(first) = lines.next().and_then(|line| line.split_once(':')).map(|(_, rest)| rest.trim()) else {
        return Vec::new();
    };
    if let Some(inner) = first.strip_prefix('[') {
        let inner = inner.split(']').next().unwrap_or_default();
        return inner.split(',').map(unquoted).filter(|entry| !entry.is_empty()).collect();
    }
    lines
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map_while(|line| line.strip_prefix("- "))
        .map(unquoted)
        .collect()
}

fn unquoted(text: &str) -> String {
    let text = text.trim();
    let inner = |quote| text.strip_prefix(quote).and_then(|text: &str| text.strip_suffix(quote));
    match (inner('"'), inner('\'')) {
        (Some(inner), _) => inner.replace("\\\"", "\"").replace("\\\\", "\\"),
        (_, Some(inner)) => inner.replace("''", "'"),
        _ => text.split(" #").next().unwrap_or_default().trim_end().to_owned(),
    }
}

/// Natural sort order of names: `bag_2` before `bag_10`.
pub(crate) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut a_rest, mut b_rest) = (a, b);
    loop {
        let (mut a_chars, mut b_chars) = (a_rest.chars(), b_rest.chars());
        let (Some(x), Some(y)) = (a_chars.next(), b_chars.next()) else {
            return a_rest.len().cmp(&b_rest.len()).then_with(|| a.cmp(b));
        };
        if x.is_ascii_digit() && y.is_ascii_digit() {
            let ((x, a_behind), (y, b_behind)) = (split_digits(a_rest), split_digits(b_rest));
            let (x_value, y_value) = (x.trim_start_matches('0'), y.trim_start_matches('0'));
            let order = x_value.len().cmp(&y_value.len()).then_with(|| x_value.cmp(y_value));
            if order != Ordering::Equal {
                return order;
            }
            (a_rest, b_rest) = (a_behind, b_behind);
        } else {
            if x != y {
                return x.cmp(&y);
            }
            (a_rest, b_rest) = (a_chars.as_str(), b_chars.as_str());
        }
    }
}

/// Splits a text after its leading digits.
fn split_digits(text: &str) -> (&str, &str) {
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    text.split_at_checked(digits).unwrap_or((text, ""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_lists_of_all_shapes_are_read() {
        let block = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - bag/a_0.db3\n    - \"b 1.db3\"\n  duration:\n    - x";
        assert_eq!(relative_file_paths(block), ["bag/a_0.db3", "b 1.db3"]);
        let unindented = "a:\n  relative_file_paths:\n  - 'it''s.mcap'\n  - b.mcap # second\n  version: 9";
        assert_eq!(relative_file_paths(unindented), ["it's.mcap", "b.mcap"]);
        assert_eq!(relative_file_paths("relative_file_paths: [a.mcap, 'b.mcap']"), ["a.mcap", "b.mcap"]);
        assert!(relative_file_paths("relative_file_paths: []").is_empty());
        assert!(relative_file_paths("nothing").is_empty());
    }

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = ["bag_10.db3", "bag_9.db3", "bag_09.db3", "bag.db3", "bäg_1", "bag_1.db3"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["bag.db3", "bag_1.db3", "bag_09.db3", "bag_9.db3", "bag_10.db3", "bäg_1"]);
    }
}
