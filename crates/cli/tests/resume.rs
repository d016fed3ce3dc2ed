//! Maps that were cut off by SIGKILL, and what their journals are good for.
#![cfg(unix)]
#![allow(clippy::unwrap_used, clippy::expect_used)]

use crate::common;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use common::{portolan, portolan_with_code, simulated_once, text};
use portolan::job::JOURNAL;

/// A journal of so many bytes holds the results of many scans.
const MANY: u64 = 20_000;

/// How often mapping may be done before it could be cut off.
const ATTEMPTS: usize = 20;

/// Maps, and is ended as soon as there is a journal of many results; the journal. A run that was done before is
/// repeated.
fn cut_off(recording: &str, more: &[&str]) -> (tempfile::TempDir, PathBuf) {
    let cut = (0..ATTEMPTS).find_map(|_| cut_off_once(recording, more));
    cut.expect("mapping was done each time before it could be cut off")
}

fn cut_off_once(recording: &str, more: &[&str]) -> Option<(tempfile::TempDir, PathBuf)> {
    let folder = tempfile::tempdir().unwrap();
    let journal = folder.path().join(JOURNAL);
    let mut command = Command::new(env!("CARGO_BIN_EXE_portolan"));
    command.args(["map", recording, "-q", "-o", &text(folder.path())]).args(more);
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let start = Instant::now();
    while !std::fs::metadata(&journal).is_ok_and(|file| file.len() > MANY) {
        if child.try_wait().unwrap().is_some() {
            return None;
        }
        assert!(start.elapsed() < Duration::from_secs(300), "no journal");
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let is_cut = journal.exists() && !folder.path().join("map.pbstream").exists();
    is_cut.then_some((folder, journal))
}

/// Maps on with what is in the folder of a journal; map, trajectory, and what was said.
fn resumed(recording: &str, folder: &Path, more: &[&str]) -> ([Vec<u8>; 2], String) {
    let run = portolan_with_code(0, &[&["map", recording, "-o", &text(folder), "--resume"], more].concat());
    assert!(!folder.join(JOURNAL).exists());
    (results(folder), run.stderr)
}

fn results(folder: &Path) -> [Vec<u8>; 2] {
    ["map.pbstream", "trajectory.tum"].map(|name| std::fs::read(folder.join(name)).unwrap())
}

/// What is mapped without a cut.
fn whole(recording: &str, more: &[&str]) -> [Vec<u8>; 2] {
    let folder = tempfile::tempdir().unwrap();
    portolan_with_code(0, &[&["map", recording, "-q", "-o", &text(folder.path())], more].concat());
    results(folder.path())
}

/// Copies a journal into a folder of its own.
fn with_journal(bytes: &[u8]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(JOURNAL), bytes).unwrap();
    folder
}

fn corridors(seed: &str) -> String {
    simulated_once(&["corridors", "--seconds", "150", "--seed", seed]).0
}

#[test]
fn a_map_that_is_resumed_is_the_same_however_damaged_the_journal_is() {
    let recording = corridors("5");
    let (_folder, journal) = cut_off(&recording, &[]);
    let (expected, journal) = (whole(&recording, &[]), std::fs::read(journal).unwrap());
    let mut flipped = journal.clone();
    flipped[journal.len() / 2] ^= 4;
    let damaged = [("1", journal.clone()), ("4", journal[..journal.len() - 5].to_vec()), ("2", flipped)];
    for (threads, bytes) in damaged {
        let folder = with_journal(&bytes);
        let (same, output) = resumed(&recording, folder.path(), &["--threads", threads]);
        assert!(output.contains("results of an earlier run are used again"), "{output}");
        assert!(same == expected, "{threads} threads: {output}");
    }
}

#[test]
fn a_map_in_3d_that_is_resumed_is_the_same() {
    let (recording, _) = simulated_once(&["garage", "--seconds", "25", "--seed", "5", "--beams", "450"]);
    for more in [&["--no-xray", "--threads", "2"][..], &["--no-xray", "--threads", "1", "--no-imu"]] {
        let (folder, _) = cut_off(&recording, more);
        let (same, output) = resumed(&recording, folder.path(), more);
        assert!(same == whole(&recording, more), "{more:?}: {output}");
    }
}

#[test]
fn journals_of_other_jobs_are_refused_and_every_verb_recognises_journals() {
    let recording = corridors("5");
    let (folder, journal) = cut_off(&recording, &[]);
    let (output, file) = (text(folder.path()), text(&journal));
    let refused = |arguments: &[&str], words: &str| {
        let run = portolan_with_code(1, arguments);
        assert!(run.stderr.contains(words), "{}", run.stderr);
        assert!(journal.exists());
    };
    refused(&["map", &corridors("6"), "-o", &output, "--resume"], "another job: the recording");
    let finer = ["map", &recording, "-o", &output, "--resume", "--set", "submap_length=5"];
    refused(&finer, "another job: the options differ");
    let empty = tempfile::tempdir().unwrap();
    refused(&["map", &recording, "-o", &text(empty.path()), "--resume"], "there is no run to resume");
    for verb in ["info", "check"] {
        refused(&[verb, &file], "--resume continues it");
    }
    let repaired = text(&empty.path().join("x.pbstream"));
    refused(&["repair", &file, "-o", &repaired], "--resume continues it");
    let anew = portolan(&["map", &recording, "-o", &output, "--duration", "20"]);
    assert!(anew.stderr.contains("--resume would go on with it"), "{}", anew.stderr);
}
