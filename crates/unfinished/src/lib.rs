#![doc = include_str!("../README.md")]

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

static PATHS: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// A temporary file or folder of this process, for as long as this value lives. Dropping it forgets the path and
/// removes nothing.
#[derive(Debug)]
pub struct Unfinished {
    path: PathBuf,
}

impl Unfinished {
    /// Makes a file or folder of this name and remembers it; nothing can come in between.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn create<T>(path: &Path, make: impl FnOnce() -> io::Result<T>) -> io::Result<(Self, T)> {
        let mut paths = paths();
        let made = make()?;
        Ok((Self::listed(&mut paths, path), made))
    }

    /// Makes a file or folder whose name is known only then.
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
        // The process may go to another folder.
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        paths.insert(path.clone());
        Self { path }
    }

    /// Gives it its final name by `rename`; [`remove_all`] waits meanwhile.
    ///
    /// # Errors
    /// Those of `rename`; then it is still to be removed.
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

/// Removes all of them, and lets no other be made or completed: for the last moment of a process. Returns how many
/// there were.
pub fn remove_all() -> usize {
    let mut paths = paths();
    let count = remove(&mut paths);
    // Whoever wants to make or complete a file now waits until the process has ended.
    std::mem::forget(paths);
    count
}

fn remove(paths: &mut BTreeSet<PathBuf>) -> usize {
    for path in paths.iter() {
        // There is nobody to tell.
        let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    }
    std::mem::take(paths).len()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unfinished_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let make = |name: &str| Unfinished::create(&at(name), || fs::write(at(name), "")).unwrap().0;
        let (done, failed, left) = (make("done.part"), make("failed.part"), make("left.part"));
        done.complete(|| fs::rename(at("done.part"), at("done"))).unwrap();
        assert!(failed.complete(|| fs::rename(at("none"), at("failed"))).is_err());
        let (_unfinished, _) =
            Unfinished::create_named(|| fs::create_dir(at("d")).map(|()| at("d")), |p| p).unwrap();
        assert!(Unfinished::create(&at("no"), || fs::write(at("no/no"), "")).is_err());
        // Not `remove_all`, behind which nothing more can be written.
        assert_eq!(remove(&mut paths()), 2);
        drop(left);
        let names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        // Whoever fails to complete a file removes it.
        assert_eq!(names.len(), 2, "{names:?}");
    }
}
