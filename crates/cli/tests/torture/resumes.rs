//! `map`, ended by SIGKILL at random moments, once or twice, and resumed with other numbers of threads: the same bytes as
//! without.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use portolan::job::JOURNAL;
use portolan_testing::damage::Random;

use crate::common::{portolan_with_code, text};
use crate::settings::Settings;

/// What is simulated, and what more is said to `map`. All take seconds: shorter runs leave no journal.
const RUNS: [(&[&str], &[&str]); 3] = [
    (&["corridors", "--seconds", "240", "--seed", "5"], &[]),
    (&["museum", "--seconds", "16", "--seed", "5", "--beams", "600"], &["--no-xray"]),
    (&["garage", "--seconds", "12", "--seed", "5", "--beams", "600"], &["--no-xray", "--no-imu"]),
];
const RESULTS: [&str; 2] = ["map.pbstream", "trajectory.tum"];

/// A run, and its uninterrupted result.
struct Run {
    recording: PathBuf,
    words: &'static [&'static str],
    results: [Vec<u8>; 2],
    takes: Duration,
}

/// What was seen.
#[derive(Debug, Default)]
pub struct Resumes {
    /// Runs that were ended.
    pub kills: u64,
    /// Of those: runs that left a journal.
    pub journals: u64,
    /// What went wrong.
    pub wrong: Vec<String>,
}

impl Run {
    fn new(
        (simulated, words): (&[&str], &'static [&'static str]),
        folder: &Path,
        settings: &Settings,
    ) -> Self {
        let recording = folder.join(format!("{}.bag", simulated.first().unwrap()));
        let path = text(&recording);
        portolan_with_code(0, &[&["simulate"], simulated, &["-q", "-o", &path]].concat());
        let mut run = Self { recording, words, results: Default::default(), takes: Duration::ZERO };
        let folder = tempfile::tempdir().unwrap();
        let start = Instant::now();
        let status = run.command(folder.path(), "2", settings).status().unwrap();
        assert!(status.success(), "{status}");
        assert!(!folder.path().join(JOURNAL).exists());
        (run.takes, run.results) = (start.elapsed(), results(folder.path()));
        run
    }

    fn command(&self, folder: &Path, threads: &str, settings: &Settings) -> Command {
        let mut command = Command::new(&settings.program);
        command.args(["map", &text(&self.recording), "-o", &text(folder), "-q", "--threads", threads]);
        command.args(self.words).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    }

    /// Ends it after a share of its time. Whether it left a journal instead of results.
    fn kill(&self, folder: &Path, share: f64, mut command: Command) -> bool {
        let mut child = command.spawn().unwrap();
        std::thread::sleep(self.takes.mul_f64(share));
        let _ = child.kill();
        child.wait().unwrap();
        folder.join(JOURNAL).exists()
    }

    fn check(&self, random: &mut Random, settings: &Settings, seen: &mut Resumes) {
        let folder = tempfile::tempdir().unwrap();
        let threads = |random: &mut Random| *random.choose(&["1", "2", "4"]);
        let mut shares = Vec::new();
        let mut has_journal = false;
        for _ in 0..=random.below(2) {
            // A second passes before there is a journal.
            shares.push(0.4 + 0.6 * random.below(1000) as f64 / 1000.0);
            let mut command = self.command(folder.path(), threads(random), settings);
            if has_journal {
                command.arg("--resume");
            }
            seen.kills += 1;
            has_journal = self.kill(folder.path(), *shares.last().unwrap(), command);
            seen.journals += u64::from(has_journal);
        }
        let mut command = self.command(folder.path(), threads(random), settings);
        if has_journal {
            command.arg("--resume");
        }
        let status = command.status().unwrap();
        let is_same = status.success() && results(folder.path()) == self.results;
        if !is_same || folder.path().join(JOURNAL).exists() {
            seen.wrong.push(format!("{} killed at {shares:?}: {status}", self.recording.display()));
        }
    }
}

fn results(folder: &Path) -> [Vec<u8>; 2] {
    RESULTS.map(|name| std::fs::read(folder.join(name)).unwrap_or_default())
}

/// Kills and resumes as often as the settings say.
pub fn resume_runs(settings: &Settings) -> Resumes {
    let folder = tempfile::tempdir().unwrap();
    let runs: Vec<Run> = RUNS.into_iter().map(|run| Run::new(run, folder.path(), settings)).collect();
    let mut seen = Resumes::default();
    for (number, run) in (0..settings.resumes).zip(runs.iter().cycle()) {
        run.check(&mut Random::new(settings.seed, number), settings, &mut seen);
    }
    seen
}
