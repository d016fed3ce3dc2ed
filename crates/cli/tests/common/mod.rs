//! Running the built program.
#![allow(dead_code, clippy::unwrap_used, clippy::print_stderr)]

use std::path::{Path, PathBuf};
use std::process::Command;

/// What a run gave.
pub struct Run {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

/// Runs the program.
pub fn portolan<S: AsRef<std::ffi::OsStr>>(arguments: &[S]) -> Run {
    let output = Command::new(env!("CARGO_BIN_EXE_portolan")).args(arguments).output().unwrap();
    Run {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

/// Runs the program, which must end with this code.
#[track_caller]
pub fn portolan_with_code<S: AsRef<std::ffi::OsStr>>(code: i32, arguments: &[S]) -> Run {
    let run = portolan(arguments);
    assert_eq!(run.code, Some(code), "stdout: {}\nstderr: {}", run.stdout, run.stderr);
    run
}

/// Path of a shared file; says on stderr when it is missing, which in continuous integration is an error.
pub fn shared(path: &str) -> Option<String> {
    let beside = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared"));
    let file = std::env::var_os("PORTOLAN_SHARED").map_or_else(beside, PathBuf::from).join(path);
    if file.exists() {
        return Some(text(&file));
    }
    assert!(std::env::var_os("CI").is_none(), "{} is missing", file.display());
    eprintln!("skipped: {} is missing", file.display());
    None
}

/// A path as text.
pub fn text(path: &Path) -> String {
    path.to_str().unwrap().to_owned()
}

/// A small simulated recording in a folder of its own.
pub fn simulated(folder: &Path, name: &str, more: &[&str]) -> String {
    let path = text(&folder.join(name));
    let mut arguments =
        vec!["simulate", "corridors", "-o", &path, "--seconds", "12", "--seed", "5", "--beams", "90"];
    arguments.extend(more);
    portolan_with_code(0, &arguments);
    path
}
