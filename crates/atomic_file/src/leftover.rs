//! Removes temporary files that a killed process left behind. A process holds a lock on each temporary file that it
//! writes; the lock ends with the process.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// Prefix and suffix of the names of temporary files.
pub(crate) const PREFIX: &str = ".portolan-";
pub(crate) const SUFFIX: &str = ".tmp";

/// Temporary files that were found in a folder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Leftovers {
    /// Files that no process was writing; they have been removed.
    pub removed: Vec<PathBuf>,
    /// Files whose lock cannot be tested, or that cannot be removed.
    pub left: Vec<PathBuf>,
}

/// Removes the temporary files in a folder whose process has ended. Files that a running process writes stay.
pub fn remove_leftovers(folder: &Path) -> Leftovers {
    let mut leftovers = Leftovers::default();
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let is_ours = |name: &str| name.starts_with(PREFIX) && name.ends_with(SUFFIX);
    let files = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_file()));
    let mut paths: Vec<PathBuf> =
        files.filter(|entry| entry.file_name().to_str().is_some_and(is_ours)).map(|e| e.path()).collect();
    paths.sort();
    for path in paths {
        match remove_unless_locked(&path) {
            Ok(true) => leftovers.removed.push(path),
            Ok(false) => {}
            Err(_) if !path.exists() => {}
            Err(_) => leftovers.left.push(path),
        }
    }
    leftovers
}

/// Removes the file if no process holds its lock; returns whether it was removed.
fn remove_unless_locked(path: &Path) -> io::Result<bool> {
    let file = File::open(path)?;
    match file.try_lock() {
        Ok(()) => fs::remove_file(path).map(|()| true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Locks a temporary file that is being written; false if another process has taken it for a leftover meanwhile.
pub(crate) fn claim(file: &File, path: &Path) -> bool {
    match file.try_lock() {
        Ok(()) => path.exists(),
        Err(TryLockError::WouldBlock) => false,
        // Where files cannot be locked, no process removes leftovers either.
        Err(TryLockError::Error(_)) => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::AtomicFile;

    #[test]
    fn abandoned_temporary_files_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        for name in [".portolan-dead.tmp", ".portolan.tmp", "portolan-x.tmp", ".portolan-x.tmp.old"] {
            fs::write(at(name), "half").unwrap();
        }
        fs::create_dir(at(".portolan-folder.tmp")).unwrap();
        let writing = AtomicFile::create(at("map")).unwrap();
        let found = remove_leftovers(folder.path());
        assert_eq!(found, Leftovers { removed: vec![at(".portolan-dead.tmp")], left: Vec::new() });
        writing.commit().unwrap();
        assert!(at("map").exists());
        assert_eq!(remove_leftovers(folder.path()), Leftovers::default());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 5);
        assert_eq!(remove_leftovers(&at("nowhere")), Leftovers::default());
    }
}
