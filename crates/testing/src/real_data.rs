//! Paths of real recordings and maps, which are not part of the repository (`TESTING.md`).

use std::path::{Path, PathBuf};

use crate::folders::repository;
use crate::left_out::left_out;

/// Path of a file or folder of the real data, `real_data("lidar2d/aces/aces.bag")`. If it is missing: none, and a line
/// in the list of skipped tests.
///
/// The data are in the folder given by the environment variable `PORTOLAN_DATA`, else in `../shared/data` beside the
/// repository.
///
/// # Panics
///
/// If `PORTOLAN_DATA` names no folder.
pub fn real_data(path: &str) -> Option<PathBuf> {
    existing(data_folder(std::env::var_os("PORTOLAN_DATA").map(PathBuf::from)).join(path))
}

/// Path of a golden file made with Cartographer, from `spec/testdata` beside the data.
///
/// # Panics
///
/// As [`real_data`].
pub fn spec_data(path: &str) -> Option<PathBuf> {
    let data = data_folder(std::env::var_os("PORTOLAN_DATA").map(PathBuf::from));
    existing(data.join("../spec/testdata").join(path))
}

fn data_folder(named: Option<PathBuf>) -> PathBuf {
    let Some(folder) = named else { return repository().join("../shared/data") };
    assert!(folder.is_dir(), "PORTOLAN_DATA names {}, which is no folder", Path::display(&folder));
    folder
}

fn existing(file: PathBuf) -> Option<PathBuf> {
    let exists = file.exists();
    if !exists {
        left_out(&format!("{} is missing", file.display()));
    }
    exists.then_some(file)
}

/// All maps of the real data, sorted by path.
pub fn real_maps() -> Vec<PathBuf> {
    let mut maps = Vec::new();
    let folders = [real_data("maps/reference"), real_data("maps/wild"), spec_data("")];
    for folder in folders.into_iter().flatten() {
        let files = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        maps.extend(files.filter(|p| p.extension().is_some_and(|e| e == "pbstream")));
    }
    maps.sort();
    maps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_named_must_exist() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(data_folder(Some(folder.path().to_owned())), folder.path());
        let nowhere = folder.path().join("nowhere");
        assert!(std::panic::catch_unwind(|| data_folder(Some(nowhere))).is_err());
        assert!(data_folder(None).ends_with("shared/data"));
    }
}
