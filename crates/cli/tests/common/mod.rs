//! Running the built program.
#![allow(dead_code, clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

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

/// Maps a recording cut off after these shares of its bytes, and with `flips` bits flipped in several ways. Every
/// run must end in a map or a named error, and never in half a file.
pub fn survives_damage(recording: &str, folder: &Path, shares: &[f64], ways: usize, flips: usize) {
    let whole = std::fs::read(recording).unwrap();
    let extension = Path::new(recording).extension().unwrap();
    let (damaged, output) = (folder.join("damaged").with_extension(extension), folder.join("results"));
    let map = |bytes: &[u8], case: &str| {
        std::fs::write(&damaged, bytes).unwrap();
        let run = portolan(&["map", &text(&damaged), "-o", &text(&output), "-q"]);
        expect_map_or_error(&run, &output, case);
    };
    for share in shares {
        map(&whole[..(share * whole.len() as f64) as usize], &format!("cut off at {share}"));
    }
    for way in 0..ways {
        let mut bytes = whole.clone();
        for i in 0..flips {
            let at = (way * 7919 + i * 104_729) * 31 % bytes.len();
            bytes[at] ^= 1 << (i % 8);
        }
        map(&bytes, &format!("flipped in way {way}"));
    }
}

#[track_caller]
fn expect_map_or_error(run: &Run, output: &Path, case: &str) {
    assert!(!run.stderr.contains("panicked"), "{case}: {}", run.stderr);
    let map = output.join("map.pbstream");
    match run.code {
        Some(0 | 3) => {
            portolan_with_code(0, &["info", &text(&map)]);
            std::fs::remove_file(map).unwrap();
        }
        Some(1) => {
            assert!(run.stderr.starts_with("error: "), "{case}: {}", run.stderr);
            assert!(!map.exists(), "{case}");
        }
        code => panic!("{case}: {code:?} {}", run.stderr),
    }
}
