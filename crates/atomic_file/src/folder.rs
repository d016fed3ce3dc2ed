//! Folders for results that are not left behind empty.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A folder for results. Dropped, it goes again if it was made for this and nothing came into it.
#[derive(Debug, Default)]
pub struct ResultFolder {
    /// What was made, the innermost first.
    made: Vec<PathBuf>,
}

impl ResultFolder {
    /// Makes a folder, with those above it that are missing, and tries whether files can be written there, so that this
    /// does not fail after hours of work.
    ///
    /// # Errors
    /// It cannot be made or written to, or there is something else of this name.
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
        // The system refuses to remove folders that hold something.
        let _ = self.made.iter().try_for_each(fs::remove_dir);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_made_and_stayed_empty_goes() {
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
    fn what_takes_no_files_is_refused() {
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
