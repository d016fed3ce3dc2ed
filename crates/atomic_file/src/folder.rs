//! Folders for results, removed again if they stay empty.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Folder for results. When it is dropped, the folders that it created are removed if they are still empty.
#[derive(Debug, Default)]
pub struct ResultFolder {
    /// Folders that were created, the innermost first.
    made: Vec<PathBuf>,
}

impl ResultFolder {
    /// Creates a folder with its missing parents, and tests whether files can be created in it, so that writing does
    /// not fail after hours of work.
    ///
    /// # Errors
    /// The folder cannot be created or written to, or a file of this name exists.
    pub fn make(path: impl AsRef<Path>) -> Result<Self, io::Error> {
        let path = path.as_ref();
        if path.exists() && !path.is_dir() {
            return Err(io::Error::new(
                io::ErrorKind::NotADirectory,
                "this is no folder, and results go to one",
            ));
        }
        let is_missing = |folder: &&Path| !folder.as_os_str().is_empty() && !folder.exists();
        let folder = Self { made: path.ancestors().take_while(is_missing).map(Path::to_owned).collect() };
        fs::create_dir_all(path)?;
        tempfile::tempfile_in(path).map_err(|error| {
            let cause = crate::plain(error);
            io::Error::new(cause.kind(), format!("no file can be written there: {cause}"))
        })?;
        Ok(folder)
    }
}

impl Drop for ResultFolder {
    fn drop(&mut self) {
        // `remove_dir` refuses to remove folders that are not empty.
        let _ = self.made.iter().try_for_each(fs::remove_dir);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn only_created_empty_folders_are_removed() {
        let here = tempfile::tempdir().unwrap();
        let at = |name: &str| here.path().join(name);
        fs::create_dir(at("a")).unwrap();
        drop(ResultFolder::make(at("a")).unwrap());
        let deep = ResultFolder::make(at("a/b/c")).unwrap();
        assert!(at("a/b/c").is_dir());
        drop(deep);
        assert!(at("a").is_dir() && !at("a/b").exists());
        let filled = ResultFolder::make(at("a/b/c")).unwrap();
        fs::write(at("a/b/map.png"), "").unwrap();
        drop(filled);
        assert!(at("a/b/map.png").is_file() && !at("a/b/c").exists());
    }

    #[test]
    fn folders_that_take_no_files_are_refused() {
        let here = tempfile::tempdir().unwrap();
        fs::write(here.path().join("file"), "").unwrap();
        let error = ResultFolder::make(here.path().join("file")).unwrap_err().to_string();
        assert!(error.contains("no folder"), "{error}");
        ResultFolder::make(here.path().join("file/inside")).unwrap_err();
        #[cfg(target_os = "linux")]
        assert!(ResultFolder::make("/proc").unwrap_err().to_string().starts_with("no file can be written"));
        assert_eq!(fs::read_dir(here.path()).unwrap().count(), 1);
    }
}
