//! Running a verb under limits, and judging how it ended.

use std::io::Read;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use crate::results;
use crate::samples::Sample;
use crate::settings::Settings;
use crate::verbs::Verb;

/// Seconds of processor time.
const PROCESSOR_SECONDS: u64 = 40;
/// A run of which no thread wants a processor for so long waits for what never comes. The clock alone would say more of
/// the machine than of the program.
const WAITING: Duration = Duration::from_secs(60);
/// Whether it does is looked at so often.
const LOOK: Duration = Duration::from_millis(500);
/// Memory, KiB of address space: the stacks of threads count.
const MEMORY_KIB: u64 = 4 << 20;

/// How it went.
pub enum Verdict {
    Right,
    /// What was wrong, and how to see it again.
    Wrong(String),
}

/// A case.
pub struct Execution<'a> {
    pub number: u64,
    pub sample: &'a Sample,
    pub bytes: &'a [u8],
    pub verb: &'a Verb,
}

impl Execution<'_> {
    /// Runs it in a folder of its own.
    pub fn judge(&self, settings: &Settings) -> Verdict {
        let folder = tempfile::tempdir().unwrap();
        let (file, temporary) = (folder.path().join(&self.sample.name), folder.path().join("temporary"));
        std::fs::write(&file, self.bytes).unwrap();
        std::fs::create_dir(&temporary).unwrap();
        let mut child = self.spawn(&settings.program, folder.path(), &temporary);
        let mut stderr = child.stderr.take().unwrap();
        let output = std::thread::spawn(move || {
            let mut output = Vec::new();
            let _ = stderr.by_ref().take(1 << 20).read_to_end(&mut output);
            String::from_utf8_lossy(&output).into_owned()
        });
        let status = wait(&mut child);
        let output = output.join().unwrap();
        let is_done = status.and_then(|status| status.code()) == Some(0);
        let fault = self.fault(status, &output, folder.path(), &temporary);
        match fault.or_else(|| results::fault(&settings.program, folder.path(), is_done)) {
            None => Verdict::Right,
            Some(fault) => Verdict::Wrong(self.describe(&fault, &output, settings)),
        }
    }

    fn spawn(&self, program: &Path, folder: &Path, temporary: &Path) -> Child {
        let place = |word: &&str| match *word {
            "FILE" => self.sample.name.clone(),
            "BAG" => self.sample.recording.clone(),
            "TUM" => self.sample.trajectory.clone(),
            word => word.replace("OUT", "out"),
        };
        let limits =
            format!("ulimit -v {MEMORY_KIB}; ulimit -t {PROCESSOR_SECONDS}; ulimit -c 0; exec \"$@\"");
        let mut command = Command::new("sh");
        command.args(["-c", &limits, "sh", &program.to_string_lossy()]).args(self.verb.iter().map(place));
        command.args(["--threads", "2"]).current_dir(folder).env("TMPDIR", temporary);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    }

    /// What is wrong with the end of a run.
    fn fault(
        &self,
        status: Option<ExitStatus>,
        output: &str,
        folder: &Path,
        temporary: &Path,
    ) -> Option<String> {
        let Some(status) = status else { return Some(format!("waits for {} s and more", WAITING.as_secs())) };
        let Some(code) = status.code() else { return Some(format!("ended by {status}")) };
        if output.contains("panicked") {
            return Some("a panic".to_owned());
        }
        if !(0..=4).contains(&code) {
            return Some(format!("exit code {code}"));
        }
        if code == 1 && !output.lines().any(|line| line.starts_with("error: ")) {
            return Some("it failed without a word".to_owned());
        }
        let is_temporary = |name: &str| name.starts_with(".portolan") || name.ends_with(".part");
        let left =
            names(temporary).into_iter().chain(names(folder).into_iter().filter(|name| is_temporary(name)));
        let left: Vec<String> = left.collect();
        (!left.is_empty()).then(|| format!("left behind: {}", left.join(", ")))
    }

    fn describe(&self, fault: &str, output: &str, settings: &Settings) -> String {
        let end: String = output.lines().rev().take(3).collect::<Vec<_>>().join(" | ");
        if let Some(keep) = &settings.keep {
            std::fs::create_dir_all(keep).unwrap();
            std::fs::write(keep.join(format!("{}-{}", self.number, self.sample.name)), self.bytes).unwrap();
        }
        format!(
            "{fault}: portolan {} ({}), see it again with PORTOLAN_TORTURE=only={},seed={}; {end}",
            self.verb.join(" "),
            self.sample.name,
            self.number,
            settings.seed
        )
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

/// Whether a thread of a process runs, wants to, or waits for the disk; false where that cannot be seen.
fn is_busy(process: u32) -> bool {
    let threads = std::fs::read_dir(format!("/proc/{process}/task")).into_iter().flatten().flatten();
    let mut states = threads.filter_map(|thread| {
        let stat = std::fs::read_to_string(thread.path().join("stat")).ok()?;
        // Behind the name, which is in parentheses and may contain some.
        stat.rsplit_once(") ").and_then(|(_, behind)| behind.chars().next())
    });
    states.any(|state| matches!(state, 'R' | 'D'))
}

/// None if it had to be ended.
fn wait(child: &mut Child) -> Option<ExitStatus> {
    let (mut busy, mut looked) = (Instant::now(), Instant::now());
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return Some(status);
        }
        if looked.elapsed() > LOOK {
            looked = Instant::now();
            if is_busy(child.id()) {
                busy = looked;
            }
        }
        if busy.elapsed() > WAITING {
            let _ = child.kill();
            let _ = child.wait();
            return None;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}
