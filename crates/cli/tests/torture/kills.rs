//! Verbs that write, ended by SIGKILL at random moments: what has a final name is whole.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use portolan::job::JOURNAL;
use portolan_testing::damage::Random;

use crate::common::{portolan_with_code, text};
use crate::settings::Settings;

/// Command lines; `OUT` is a folder.
const VERBS: [&[&str]; 6] = [
    &["map", "BAG", "-o", "OUT"],
    &["map", "SPACE", "-o", "OUT", "--cloud", "cloud.ply"],
    &["simulate", "corridors", "--seconds", "5", "--seed", "5", "-o", "OUT/walk.bag"],
    &["edit", "MAP", "-o", "OUT/map.pbstream", "--rotate", "7", "--optimize"],
    &["render", "MAP", "-o", "OUT/map.pgm"],
    &["refine", "--recording", "SPACE", "--trajectory", "TUM", "-o", "OUT"],
];

/// Files by their names in the folder, but temporary ones.
type Files = BTreeMap<String, Vec<u8>>;

fn files(folder: &Path) -> Files {
    let entries = std::fs::read_dir(folder).unwrap().map(Result::unwrap);
    let named = entries.map(|e| (e.file_name().to_string_lossy().into_owned(), e.path()));
    named
        .filter(|(name, path)| !name.starts_with(".portolan-") && name != JOURNAL && path.is_file())
        .map(|(name, path)| (name, std::fs::read(path).unwrap()))
        .collect()
}

/// Whether a file equals that of an uninterrupted run. Reports contain the time it took.
fn is_whole(name: &str, bytes: &[u8], expected: &Files) -> bool {
    match name.rsplit('.').next() {
        Some("json") => serde_json::from_slice::<serde_json::Value>(bytes).is_ok(),
        Some("html") => bytes.trim_ascii_end().ends_with(b"</html>"),
        _ => expected.get(name).is_some_and(|whole| whole == bytes),
    }
}

/// A verb with its words in their places.
struct Victim {
    words: Vec<String>,
    expected: Files,
    takes: Duration,
}

impl Victim {
    fn new(verb: &[&str], inputs: &Path, settings: &Settings) -> Self {
        let input = |name: &str| text(&inputs.join(name));
        let place = |word: &&str| match *word {
            "BAG" => input("walk.bag"),
            "SPACE" => input("space.bag"),
            "TUM" => input("space.truth.tum"),
            "MAP" => input("map/map.pbstream"),
            word => word.to_owned(),
        };
        let mut victim =
            Self { words: verb.iter().map(place).collect(), expected: Files::new(), takes: Duration::ZERO };
        let folder = tempfile::tempdir().unwrap();
        let start = Instant::now();
        let status = victim.spawn(folder.path(), settings).wait().unwrap();
        assert!(status.code().is_some_and(|code| code != 2), "{:?}: {status}", victim.words);
        victim.takes = start.elapsed();
        victim.expected = files(folder.path());
        assert!(!victim.expected.is_empty(), "{:?} leaves nothing", victim.words);
        victim
    }

    fn spawn(&self, folder: &Path, settings: &Settings) -> std::process::Child {
        let words = self.words.iter().map(|word| word.replace("OUT", &text(folder)));
        let mut command = Command::new(&settings.program);
        command.args(words).args(["-q", "--threads", "2"]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    }

    /// Ends a run after this fraction of its time; what is wrong then.
    fn kill(&self, share: f64, settings: &Settings) -> Option<String> {
        let folder = tempfile::tempdir().unwrap();
        let mut child = self.spawn(folder.path(), settings);
        std::thread::sleep(self.takes.mul_f64(share));
        let _ = child.kill();
        child.wait().unwrap();
        for (name, bytes) in files(folder.path()) {
            if !is_whole(&name, &bytes, &self.expected) {
                return Some(format!("{:?} killed at {share:.3}: {name} is damaged", self.words));
            }
            if name.ends_with(".pbstream") || name.ends_with(".bag") {
                portolan_with_code(0, &["info", &text(&folder.path().join(&name))]);
            }
        }
        // Its leftovers do not block the next run.
        self.spawn(folder.path(), settings).wait().unwrap();
        let again = files(folder.path());
        let missing = self.expected.keys().find(|name| !again.contains_key(*name));
        let damaged = again.iter().find(|(name, bytes)| !is_whole(name, bytes, &self.expected));
        let wrong = missing.or(damaged.map(|(name, _)| name));
        wrong.map(|name| format!("{:?} again after a kill at {share:.3}: {name}", self.words))
    }
}

/// Kills as many runs as the settings say; what went wrong.
pub fn kill_runs(settings: &Settings) -> Vec<String> {
    let inputs = tempfile::tempdir().unwrap();
    let at = |name: &str| text(&inputs.path().join(name));
    let walk = ["simulate", "corridors", "--seconds", "8", "--seed", "5", "--beams", "90", "-q"];
    portolan_with_code(0, &[&walk[..], &["-o", &at("walk.bag")]].concat());
    let space = ["simulate", "garage", "--seconds", "2", "--seed", "5", "--beams", "300", "-q"];
    portolan_with_code(0, &[&space[..], &["-o", &at("space.bag")]].concat());
    portolan_with_code(0, &["map", &at("walk.bag"), "-o", &at("map"), "-q"]);
    let victims: Vec<Victim> = VERBS.iter().map(|verb| Victim::new(verb, inputs.path(), settings)).collect();
    let kill = |number: u64| {
        let mut random = Random::new(settings.seed, number);
        let victim = random.choose(&victims);
        victim.kill(random.below(1000) as f64 / 1000.0, settings)
    };
    (0..settings.kills).filter_map(kill).collect()
}
