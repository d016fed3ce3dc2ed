//! Running the built program.
#![allow(dead_code, clippy::unwrap_used, clippy::panic)]

use std::path::Path;

use portolan_testing::{Program, real_data};

pub use portolan_testing::Run;

/// The program.
pub static PORTOLAN: Program = Program::at(env!("CARGO_BIN_EXE_portolan"));

/// Runs the program.
pub fn portolan<S: AsRef<std::ffi::OsStr>>(arguments: &[S]) -> Run {
    PORTOLAN.run(arguments)
}

/// Runs the program, which must end with this code.
#[track_caller]
pub fn portolan_with_code<S: AsRef<std::ffi::OsStr>>(code: i32, arguments: &[S]) -> Run {
    PORTOLAN.run_with_code(code, arguments)
}

/// Path of a file of the real data, if it is there.
pub fn real(path: &str) -> Option<String> {
    real_data(path).map(|file| text(&file))
}

/// A path as text.
pub fn text(path: &Path) -> String {
    path.to_str().unwrap().to_owned()
}

/// A recording of a 2D robot in corridors, 12 s, as `name` in a folder of its own with its truth beside it.
pub fn simulated(folder: &Path, name: &str, more: &[&str]) -> String {
    let path = folder.join(name);
    let extension = path.extension().unwrap().to_str().unwrap();
    let corridors = ["corridors", "--seconds", "12", "--seed", "5", "--beams", "90"];
    let made = PORTOLAN.simulated(extension, &[&corridors, more].concat());
    for file in std::fs::read_dir(made.parent().unwrap()).unwrap() {
        let file = file.unwrap();
        let ending = file.file_name().into_string().unwrap().split_once('.').unwrap().1.to_owned();
        std::fs::copy(file.path(), path.with_extension(ending)).unwrap();
    }
    text(&path)
}

/// The recording of [`portolan_testing::Program::simulated`] as text, and its truth.
#[track_caller]
pub fn simulated_once(arguments: &[&str]) -> (String, String) {
    let recording = PORTOLAN.simulated("mcap", arguments);
    (text(&recording), text(&recording.with_extension("truth.tum")))
}

/// Errors of a trajectory against the true one, as `evaluate trajectory` gives them.
#[track_caller]
pub fn trajectory_errors(estimate: &str, truth: &str) -> serde_json::Value {
    let run = portolan_with_code(0, &["evaluate", "trajectory", estimate, truth, "--json"]);
    serde_json::from_str(&run.stdout).unwrap()
}

/// Maps a recording cut off after these shares of its bytes, and with `flips` bits flipped at several sets of
/// positions. Every run must end in a map or a named error, and never in half a file.
pub fn survives_damage(recording: &str, folder: &Path, shares: &[f64], seeds: usize, flips: usize) {
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
    for seed in 0..seeds {
        let mut bytes = whole.clone();
        for i in 0..flips {
            let at = (seed * 7919 + i * 104_729) * 31 % bytes.len();
            bytes[at] ^= 1 << (i % 8);
        }
        map(&bytes, &format!("flipped in way {seed}"));
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
