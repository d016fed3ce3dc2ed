//! Inputs through pipes, and outputs that are closed or full.
#![cfg(unix)]
#![allow(clippy::unwrap_used)]

use crate::common;

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use common::{portolan_with_code, simulated, text};

const PROGRAM: &str = env!("CARGO_BIN_EXE_portolan");

/// Runs the program with the bytes of a file coming through a pipe, in small pieces.
fn piped(file: &str, arguments: &[&str]) -> Output {
    let bytes = std::fs::read(file).unwrap();
    let mut child = Command::new(PROGRAM)
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut pipe = child.stdin.take().unwrap();
    let writer = std::thread::spawn(move || {
        // Whoever cannot use a pipe closes it early.
        let _ = bytes.chunks(1000).try_for_each(|piece| pipe.write_all(piece));
    });
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    output
}

#[track_caller]
fn expect(output: &Output, code: i32) {
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
}

/// A graph, a trajectory in three formats, relations and a map.
struct Samples {
    folder: tempfile::TempDir,
    recording: String,
    truth: String,
    map: String,
}

impl Samples {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let recording = simulated(folder.path(), "walk.bag", &[]);
        let truth = recording.replace(".bag", ".truth.tum");
        let results = folder.path().join("results");
        portolan_with_code(0, &["map", &recording, "-o", &text(&results), "-q"]);
        let map = text(&results.join("map.pbstream"));
        Self { recording, truth, map, folder }
    }

    fn path(&self, name: &str) -> String {
        text(&self.folder.path().join(name))
    }
}

#[test]
fn formats_read_in_one_pass_come_through_pipes() {
    let samples = Samples::new();
    let (from_file, from_pipe) = (samples.path("file"), samples.path("pipe"));
    let graph = samples.path("walk.g2o");
    portolan_with_code(0, &["convert", &samples.map, "-o", &graph]);
    let kitti = samples.path("walk.kitti");
    portolan_with_code(0, &["convert", &samples.truth, "-o", &kitti]);
    let table = samples.path("walk.csv");
    portolan_with_code(0, &["convert", &samples.truth, "-o", &table]);
    let lines = samples.path("walk.geojson");
    portolan_with_code(0, &["convert", &samples.map, "-o", &lines]);
    for (input, verb, to) in [
        (&graph, "optimize", ".g2o"),
        (&samples.truth, "convert", ".csv"),
        (&kitti, "convert", ".tum"),
        (&table, "convert", ".tum"),
        (&lines, "convert", ".tum"),
        (&samples.map, "convert", ".tum"),
        (&samples.map, "render", ".png"),
    ] {
        let (whole, piece) = (format!("{from_file}{to}"), format!("{from_pipe}{to}"));
        let code = portolan_with_code_of(&[verb, input, "-o", &whole, "-q"]);
        for name in ["-", "/dev/stdin"] {
            expect(&piped(input, &[verb, name, "-o", &piece, "-q"]), code);
            assert!(std::fs::read(&whole).unwrap() == std::fs::read(&piece).unwrap(), "{verb} {input}");
        }
    }
    for verb in ["info", "check"] {
        let whole = Command::new(PROGRAM).args([verb, &samples.map]).output().unwrap();
        let output = piped(&samples.map, &[verb, "-"]);
        expect(&output, whole.status.code().unwrap());
        let stdout = String::from_utf8(output.stdout).unwrap();
        let expected = String::from_utf8(whole.stdout).unwrap().replace(&samples.map, "-");
        assert_eq!(stdout.lines().count(), expected.lines().count(), "{stdout}");
    }
    let output = piped(&samples.truth, &["evaluate", "trajectory", "-", &samples.truth, "--json"]);
    expect(&output, 0);
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["absolute"]["translation"]["max"].as_f64().map(|m| m < 1e-9), Some(true), "{report}");
}

fn portolan_with_code_of(arguments: &[&str]) -> i32 {
    Command::new(PROGRAM).args(arguments).output().unwrap().status.code().unwrap()
}

#[test]
fn formats_read_more_than_once_refuse_pipes() {
    let samples = Samples::new();
    let (map, recording) = (&samples.map, &samples.recording);
    let output = samples.path("output");
    let mapped = samples.path("output.pbstream");
    for (input, arguments) in [
        (recording, vec!["info", "-"]),
        (recording, vec!["check", "/dev/stdin"]),
        (recording, vec!["map", "-", "-o", &output]),
        (recording, vec!["refine", "--recording", "-", "--trajectory", &samples.truth, "-o", &output]),
        (map, vec!["edit", "-", "-o", &mapped, "--optimize"]),
        (map, vec!["optimize", "-", "-o", &mapped]),
        (map, vec!["repair", "-", "-o", &mapped]),
        (map, vec!["migrate", "-", &mapped]),
        (map, vec!["map", recording, "--from", "-", "-o", &output]),
        (map, vec!["info", "--all", "-"]),
    ] {
        let run = piped(input, &arguments);
        expect(&run, 1);
        let stderr = String::from_utf8_lossy(&run.stderr);
        assert!(stderr.contains("save it as a file first"), "{arguments:?}: {stderr}");
        assert!(!stderr.contains("Illegal seek"), "{stderr}");
        // Said once.
        assert_eq!(stderr.matches("save it as a file").count(), 1, "{stderr}");
    }
}

/// Runs the program with outputs that take nothing: closed pipes, or a device that is full.
fn with_outputs(arguments: &[&str], stdout: Stdio, stderr: Stdio) -> Option<i32> {
    let mut command = Command::new(PROGRAM);
    command.args(arguments).stdin(Stdio::null()).stdout(stdout).stderr(stderr);
    command.spawn().unwrap().wait().unwrap().code()
}

fn closed() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
}

fn full() -> Stdio {
    File::options().write(true).open("/dev/full").unwrap().into()
}

#[test]
fn closed_and_full_outputs_do_not_end_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let results = folder.path().join("results");
    let output = text(&results);
    let map = text(&results.join("map.pbstream"));
    let map_it = ["map", &recording, "-o", &output, "-vv"];
    for (stdout, stderr) in [(closed(), closed()), (full(), full())] {
        assert_eq!(with_outputs(&map_it, stdout, stderr), Some(0));
        assert!(std::fs::metadata(&map).unwrap().len() > 1000);
        std::fs::remove_dir_all(&results).unwrap();
    }
    let info = ["info", &recording];
    assert_eq!(with_outputs(&info, full(), Stdio::null()), Some(1));
    assert_eq!(with_outputs(&info, full(), full()), Some(1));
    assert_eq!(with_outputs(&info, closed(), Stdio::null()), Some(141));
    assert_eq!(with_outputs(&["--help"], full(), Stdio::null()), Some(1));
    assert_eq!(with_outputs(&["--help"], closed(), Stdio::null()), Some(141));
    assert_eq!(with_outputs(&["man"], closed(), Stdio::null()), Some(141));
    assert_eq!(with_outputs(&["nonsense"], closed(), closed()), Some(2));
    assert_eq!(with_outputs(&["info", "/none"], full(), full()), Some(1));
    let run = Command::new(PROGRAM).args(info).stdout(full()).output().unwrap();
    let stderr = String::from_utf8(run.stderr).unwrap();
    assert!(
        stderr.contains("cannot write to the standard output") && !stderr.contains("because"),
        "{stderr}"
    );
}

/// Temporary files that are left in a folder, at any depth.
fn left_in(folder: &Path) -> Vec<String> {
    let mut left = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if name.starts_with('.') || name.ends_with(".part") {
            left.push(name);
        } else if path.is_dir() {
            left.extend(left_in(&path));
        }
    }
    left
}

/// Runs the program and interrupts it after some milliseconds. It must end with 130, or be done before;
/// nothing temporary may be left.
fn stopped(folder: &Path, arguments: &[&str], milliseconds: u64, signals: usize) -> Option<i32> {
    let temporary = folder.join("temporary");
    std::fs::create_dir_all(&temporary).unwrap();
    let mut command = Command::new(PROGRAM);
    command.args(arguments).env("TMPDIR", &temporary).current_dir(folder);
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut stderr = child.stderr.take().unwrap();
    let stderr = std::thread::spawn(move || {
        let mut text = String::new();
        let _ = stderr.read_to_string(&mut text);
        text
    });
    std::thread::sleep(std::time::Duration::from_millis(milliseconds));
    for _ in 0..signals {
        let _ = Command::new("kill").args(["-TERM", &child.id().to_string()]).stderr(Stdio::null()).status();
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let code = child.wait().unwrap().code();
    let stderr = stderr.join().unwrap();
    assert!(!stderr.contains("panicked"), "{arguments:?}: {stderr}");
    assert_eq!(left_in(folder), Vec::<String>::new(), "{arguments:?} after {milliseconds} ms");
    assert_eq!(std::fs::read_dir(&temporary).unwrap().count(), 0, "{arguments:?} after {milliseconds} ms");
    code
}

#[test]
fn interrupted_runs_leave_no_files() {
    let samples = Samples::new();
    let folder = samples.folder.path();
    let (recording, map, truth) = (samples.recording.as_str(), samples.map.as_str(), samples.truth.as_str());
    let packed = samples.path("walk.bag.gz");
    let gzip = Command::new("gzip").args(["-kc", recording]).output().unwrap();
    std::fs::write(&packed, gzip.stdout).unwrap();
    let verbs: Vec<Vec<&str>> = vec![
        vec!["map", recording, "-o", "m"],
        vec!["map", &packed, "-o", "n"],
        vec!["info", &packed],
        vec!["simulate", "office", "-o", "s.bag", "--seconds", "60"],
        vec!["simulate", "museum", "-o", "s.mcap", "--seconds", "20"],
        vec!["demo", "-o", "d"],
        vec!["check", &packed],
        vec!["edit", map, "-o", "e.pbstream", "--rotate", "5"],
        vec!["optimize", map, "-o", "o.pbstream"],
        vec!["repair", map, "-o", "r.pbstream"],
        vec!["migrate", map, "g.pbstream"],
        vec!["render", map, "-o", "p.png"],
        vec!["convert", map, "-o", "c.tum"],
        vec!["evaluate", "generate", map, "-o", "x.relations"],
        vec!["refine", "--recording", recording, "--trajectory", truth, "-o", "f"],
        vec!["compat", "cartographer_pbstream_to_ros_map", "-pbstream_filename", map, "-map_filestem", "q"],
    ];
    for arguments in &verbs {
        // Whenever it happens, nothing may be left; that some runs are done before does not matter.
        for milliseconds in [5, 40, 120, 300] {
            let code = stopped(folder, arguments, milliseconds, 2);
            assert!(code.is_none_or(|code| [0, 1, 3, 130].contains(&code)), "{arguments:?}: {code:?}");
        }
    }
    // The handler is in place long before a long run ends.
    assert_eq!(
        stopped(folder, &["simulate", "museum", "-o", "s.mcap", "--seconds", "600"], 1500, 1),
        Some(130)
    );
    assert_eq!(stopped(folder, &["demo", "-o", "d"], 2500, 1), Some(130));
}

/// Runs the program under a limit of the shell.
fn limited(limit: &str, arguments: &[&str]) -> Output {
    let mut command = Command::new("sh");
    command.args(["-c", &format!("ulimit {limit}; exec \"$@\""), "sh", PROGRAM]).args(arguments);
    command.stdin(Stdio::null()).output().unwrap()
}

#[test]
fn a_limit_on_the_size_of_files_is_an_error_of_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let output = common::text(&folder.path().join("large.bag"));
    let run = limited("-f 64", &["simulate", "office", "--seconds", "10", "-o", &output, "-q"]);
    expect(&run, 1);
    assert!(!Path::new(&output).exists());
    assert_eq!(left_in(folder.path()), Vec::<String>::new());
}

#[test]
fn endless_input_is_no_pose_graph() {
    let folder = tempfile::tempdir().unwrap();
    let output = common::text(&folder.path().join("a.g2o"));
    expect(&limited("-t 60", &["optimize", "/dev/urandom", "-o", &output]), 1);
}
