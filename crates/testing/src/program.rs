//! Running the built program, and what it makes once for all tests.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::Duration;

use crate::folders::target;

/// Folders that this process makes or has made.
static MADE: Mutex<BTreeMap<PathBuf, Arc<OnceLock<()>>>> = Mutex::new(BTreeMap::new());

/// Results of older programs are removed when they have not been touched for so long.
const FORGOTTEN_AFTER: Duration = Duration::from_secs(3600);

/// What a run gave.
#[derive(Clone, Debug)]
pub struct Run {
    /// Exit code; none where a signal ended it.
    pub code: Option<i32>,
    /// What it wrote to stdout.
    pub stdout: String,
    /// What it wrote to stderr.
    pub stderr: String,
}

/// The built program.
#[derive(Debug)]
pub struct Program {
    path: &'static str,
    folder: OnceLock<PathBuf>,
}

impl Program {
    /// The program of this file: `Program::at(env!("CARGO_BIN_EXE_portolan"))`.
    pub const fn at(path: &'static str) -> Self {
        Self { path, folder: OnceLock::new() }
    }

    /// Runs it.
    ///
    /// # Panics
    ///
    /// If it cannot be started, or writes what is not UTF-8.
    pub fn run<S: AsRef<OsStr>>(&self, arguments: &[S]) -> Run {
        let output = Command::new(self.path).args(arguments).output().unwrap();
        Run {
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// Runs it; it must end with this code.
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

    /// A simulated recording `walk.EXTENSION` (`bag`, `mcap`) with its truth beside it, simulated once for all tests
    /// with these arguments: `simulated("mcap", &["museum", "--seconds", "20"])`. Nothing may be written beside it.
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

    /// A folder in `target/simulated-<hash of the program>` with what `make` put into it, made once for all tests that
    /// name it alike. Nothing may be changed in it afterwards.
    ///
    /// It is made under another name and moved, so that test programs may run at the same time and none sees half of it.
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
                // Another test program was faster.
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
            // Another test program may be removing it, too.
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_made_once() {
        // Any file will do for the hash; no program runs.
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
