//! Runs the built program, and keeps results that it makes once for all tests.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use crate::folders::target;

/// Folders that this process is making or has made.
static MADE: Mutex<BTreeMap<PathBuf, Arc<OnceLock<()>>>> = Mutex::new(BTreeMap::new());

/// Age of the modification time after which results of older builds of the program are removed.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(3600);

/// Result of a run.
#[derive(Clone, Debug)]
pub struct Run {
    /// Exit code; none if a signal ended the program.
    pub code: Option<i32>,
    /// Output on stdout.
    pub stdout: String,
    /// Output on stderr.
    pub stderr: String,
}

/// The built program.
#[derive(Debug)]
pub struct Program {
    path: &'static str,
    folder: OnceLock<PathBuf>,
}

impl Program {
    /// The program at this path: `Program::at(env!("CARGO_BIN_EXE_portolan"))`.
    pub const fn at(path: &'static str) -> Self {
        Self { path, folder: OnceLock::new() }
    }

    /// Runs the program.
    ///
    /// # Panics
    ///
    /// If it cannot be started, or its output is not UTF-8.
    pub fn run<S: AsRef<OsStr>>(&self, arguments: &[S]) -> Run {
        let output = Command::new(self.path).args(arguments).output().unwrap();
        Run {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// Runs the program and asserts its exit code.
    ///
    /// # Panics
    ///
    /// If it ends with another code, and as [`Self::run`].
    #[track_caller]
    pub fn run_with_code<S: AsRef<OsStr>>(&self, code: i32, arguments: &[S]) -> Run {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(code), "stdout: {}\nstderr: {}", run.stdout, run.stderr);
        run
    }

    /// Path of a simulated recording `walk.EXTENSION` (`bag`, `mcap`) with its ground truth beside it. It is simulated
    /// once for all tests with these arguments: `simulated("mcap", &["museum", "--seconds", "20"])`. Tests must not
    /// write into its folder.
    ///
    /// # Panics
    ///
    /// If the simulation fails.
    #[track_caller]
    pub fn simulated(&self, extension: &str, arguments: &[&str]) -> PathBuf {
        let name = format!("walk.{extension}");
        let made = self.made_once(&[arguments, &[extension]].concat(), |folder| {
            let output = folder.join(&name);
            let arguments = [&["simulate", "-q", "-o", output.to_str().unwrap()], arguments].concat();
            self.run_with_code(0, &arguments);
        });
        made.join(name)
    }

    /// A folder in `target/simulated-<hash of the program>` that `make` fills once for all tests that use the same
    /// `name`. Its content must not be changed afterwards.
    ///
    /// It is made under a temporary name and renamed, so that test programs may run concurrently and never see an
    /// incomplete folder.
    ///
    /// # Panics
    ///
    /// If `make` does, or the folder cannot be made.
    pub fn made_once(&self, name: &[&str], make: impl FnOnce(&Path)) -> PathBuf {
        let words = name.join(" ");
        let folder = self.folder().join(format!("{}-{:08x}", name[0], crc32fast::hash(words.as_bytes())));
        let once = Arc::clone(MADE.lock().unwrap().entry(folder.clone()).or_default());
        once.get_or_init(|| {
            if folder.exists() {
                return;
            }
            let unfinished = folder.with_extension(format!("{}.unfinished", std::process::id()));
            std::fs::create_dir_all(&unfinished).unwrap();
            make(&unfinished);
            if std::fs::rename(&unfinished, &folder).is_err() {
                assert!(folder.exists(), "{} cannot be made", folder.display());
                // Another test program has made the folder meanwhile.
                std::fs::remove_dir_all(&unfinished).unwrap();
            }
        });
        folder
    }

    fn folder(&self) -> &Path {
        self.folder.get_or_init(|| {
            let hash = crc32fast::hash(&std::fs::read(self.path).unwrap());
            let folder = target().join(format!("simulated-{hash:08x}"));
            if !folder.exists() {
                remove_forgotten();
            }
            folder
        })
    }
}

fn remove_forgotten() {
    let is_forgotten = |path: &Path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().starts_with("simulated-");
        let age = path.metadata().and_then(|data| data.modified()).ok().and_then(|time| time.elapsed().ok());
        name && age.is_some_and(|age| age > FORGOTTEN_AFTER)
    };
    for entry in std::fs::read_dir(target()).into_iter().flatten().flatten() {
        if is_forgotten(&entry.path()) {
            // Another test program may be removing it at the same time.
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_made_once() {
        // Any file will do: only its hash is used, and it is not run.
        let program = Program::at(concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"));
        let name = format!("test-{}", std::process::id());
        let made = || {
            program.made_once(&[&name, "twice"], |folder| {
                let file = folder.join("file");
                assert!(!file.exists());
                std::fs::write(file, "whole").unwrap();
            })
        };
        let folders: Vec<PathBuf> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(made)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert!(folders.iter().all(|folder| *folder == folders[0]));
        assert_eq!(std::fs::read_to_string(folders[0].join("file")).unwrap(), "whole");
        assert_eq!(std::fs::read_dir(&folders[0]).unwrap().count(), 1);
        std::fs::remove_dir_all(&folders[0]).unwrap();
    }
}
