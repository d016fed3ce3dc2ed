#![doc = include_str!("../README.md")]

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

static PATHS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Registers a temporary file or folder of this process while this value lives. Dropping it unregisters the path and
/// does not remove the file.
#[derive(Debug)]
pub struct Unfinished {
    path: PathBuf,
}

impl Unfinished {
    /// Creates a file or folder of this name and registers it. [`remove_all`] cannot run between the two.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn create<T>(path: &Path, make: impl FnOnce() -> io::Result<T>) -> io::Result<(Self, T)> {
        let mut paths = paths();
        let made = make()?;
        Ok((Self::listed(&mut paths, path), made))
    }

    /// Creates a file or folder whose name is known only after creation, and registers it.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn create_named<T>(
        make: impl FnOnce() -> io::Result<T>,
        path: impl FnOnce(&T) -> &Path,
    ) -> io::Result<(Self, T)> {
        let mut paths = paths();
        let made = make()?;
        Ok((Self::listed(&mut paths, path(&made)), made))
    }

    fn listed(paths: &mut BTreeSet<PathBuf>, path: &Path) -> Self {
        // Absolute, because the process may change its working directory.
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        paths.insert(path.clone());
        Self { path }
    }

    /// Gives the file its final name by `rename` and unregisters it; [`remove_all`] waits meanwhile.
    ///
    /// # Errors
    /// Those of `rename`; then the caller still has to remove the file.
    pub fn complete<T, E>(self, rename: impl FnOnce() -> Result<T, E>) -> Result<T, E> {
        let mut paths = paths();
        let renamed = rename();
        if renamed.is_ok() {
            paths.remove(&self.path);
        }
        drop(paths);
        renamed
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        paths().remove(&self.path);
    }
}

fn paths() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    PATHS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes all registered files and folders, and blocks every later creation or completion: to be called immediately
/// before the process ends. Returns the number of registered paths.
pub fn remove_all() -> usize {
    let mut paths = paths();
    let count = remove(&mut paths);
    // The lock is never released: threads that create or complete a file now wait until the process ends.
    std::mem::forget(paths);
    count
}

fn remove(paths: &mut BTreeSet<PathBuf>) -> usize {
    for path in paths.iter() {
        // Errors are ignored: the process ends, and nothing could report them.
        let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    }
    std::mem::take(paths).len()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn unfinished_files_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let make = |name: &str| Unfinished::create(&at(name), || fs::write(at(name), "")).unwrap().0;
        let (done, failed, left) = (make("done.part"), make("failed.part"), make("left.part"));
        done.complete(|| fs::rename(at("done.part"), at("done"))).unwrap();
        assert!(failed.complete(|| fs::rename(at("none"), at("failed"))).is_err());
        let (_unfinished, _) =
            Unfinished::create_named(|| fs::create_dir(at("d")).map(|()| at("d")), |p| p).unwrap();
        assert!(Unfinished::create(&at("no"), || fs::write(at("no/no"), "")).is_err());
        // Not `remove_all`, which keeps the lock, so that nothing could be created afterwards.
        assert_eq!(remove(&mut paths()), 2);
        drop(left);
        let names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        // A file that could not be completed is removed by its caller, not by the list.
        assert_eq!(names.len(), 2, "{names:?}");
    }
}
