//! Folders of results: what no earlier run wrote is not lost, and what an earlier run left does not look like a result of
//! this one.
#![allow(clippy::unwrap_used)]

use crate::common;

use std::fs;
use std::path::{Path, PathBuf};

use common::{portolan, portolan_with_code, simulated, text};
use portolan::job::MANIFEST;

/// A folder with a recording of 12 s.
struct Place {
    folder: tempfile::TempDir,
    recording: String,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let recording = simulated(folder.path(), "walk.mcap", &[]);
        Self { folder, recording }
    }

    fn output(&self) -> PathBuf {
        self.folder.path().join("results")
    }

    fn map(&self, code: i32, more: &[&str]) -> common::Run {
        let output = text(&self.output());
        portolan_with_code(code, &[&["map", &self.recording, "-o", &output][..], more].concat())
    }
}

/// Puts a foreign file into the folder of a verb: it must refuse at once, change nothing, and continue with
/// --force.
fn refuses(folder: &Path, name: &str, arguments: &[&str]) {
    let path = folder.join(name);
    fs::create_dir_all(folder).unwrap();
    fs::write(&path, "holiday").unwrap();
    let before = fs::read_dir(folder).unwrap().count();
    let run = portolan_with_code(1, arguments);
    assert!(run.stderr.contains(name) && run.stderr.contains("--force"), "{}", run.stderr);
    assert_eq!(fs::read_to_string(&path).unwrap(), "holiday");
    assert_eq!(fs::read_dir(folder).unwrap().count(), before, "{arguments:?}");
    let run = portolan(&[arguments, &["--force"]].concat());
    assert!(matches!(run.code, Some(0 | 3 | 4)), "{:?} {}", run.code, run.stderr);
    assert_ne!(fs::read(&path).unwrap(), b"holiday");
    // Now it is a result of an earlier run.
    let run = portolan(arguments);
    assert!(matches!(run.code, Some(0 | 3 | 4)), "{:?} {}", run.code, run.stderr);
}

#[test]
fn mapping_localising_and_rendering_keep_foreign_files() {
    let place = Place::new();
    let output = text(&place.output());
    refuses(&place.output(), "map.png", &["map", &place.recording, "-o", &output, "-q"]);
    let map = text(&place.output().join("map.pbstream"));
    let localized = place.folder.path().join("localized");
    let arguments = ["localize", &map, &place.recording, "-o", &text(&localized), "-q"];
    refuses(&localized, "poses.csv", &arguments);
    let drawn = place.folder.path().join("drawn");
    fs::create_dir(&drawn).unwrap();
    fs::write(drawn.join("house.pgm"), "named by the user, who wants it replaced").unwrap();
    refuses(&drawn, "house.yaml", &["render", &map, "-o", &text(&drawn.join("house.pgm"))]);
    assert!(fs::read(drawn.join("house.pgm")).unwrap().starts_with(b"P5"));
}

#[test]
fn refining_and_registering_keep_foreign_files() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| text(&folder.path().join(name));
    let garage = ["garage", "--seconds", "3", "--seed", "5", "--beams", "300"];
    let (recording, truth) = common::simulated_once(&garage);
    let refine = [
        "refine",
        "--recording",
        &recording,
        "--trajectory",
        &truth,
        "-o",
        &at("sharp"),
        "--no-report",
        "-q",
    ];
    refuses(&folder.path().join("sharp"), "refined.ply", &refine);
    let scan = at("sharp/refined.ply");
    let register = ["register", &scan, &scan, "--reduce", "0.2", "-o", &at("together"), "-q"];
    refuses(&folder.path().join("together"), "scan001.pose", &register);
}

#[test]
fn input_files_are_not_replaced() {
    let place = Place::new();
    place.map(0, &[]);
    let map = text(&place.output().join("map.pbstream"));
    let trajectory = text(&place.output().join("trajectory.tum"));
    for (input, arguments) in [
        (&map, vec!["evaluate", "generate", &map, "-o", &map]),
        (&trajectory, vec!["evaluate", "loops", &map, &trajectory, "--csv", &trajectory]),
        (&place.recording, vec!["check", &place.recording, "--picture", &place.recording]),
        (&map, vec!["convert", &map, "-o", &map]),
    ] {
        let before = fs::read(input).unwrap();
        let run = common::portolan_with_code(2, &arguments);
        assert!(run.stderr.contains("is an input, and would be replaced"), "{arguments:?}: {}", run.stderr);
        assert!(fs::read(input).unwrap() == before, "{arguments:?}");
    }
    // A map may become a better one in its place.
    common::portolan_with_code(0, &["edit", &map, "-o", &map, "--move", "1,0"]);
}

#[test]
fn files_of_an_earlier_run_are_removed_and_reported() {
    let place = Place::new();
    let at = |name: &str| place.output().join(name);
    place.map(0, &["--cloud", "cloud.ply", "--all-poses"]);
    fs::write(at("notes.txt"), "mine").unwrap();
    fs::write(at(".portolan-killed.tmp"), "half").unwrap();
    let run = place.map(0, &[]);
    assert!(run.stderr.contains("all_poses.tum, cloud.ply: of an earlier run, removed"), "{}", run.stderr);
    assert!(run.stderr.contains("1 temporary file of a run that was killed"), "{}", run.stderr);
    let left = [at("cloud.ply"), at("all_poses.tum"), at(".portolan-killed.tmp")].map(|path| path.exists());
    assert_eq!(left, [false; 3]);
    assert!(at("notes.txt").exists() && at("map.png").exists() && at(MANIFEST).exists());
    // What somebody drew on is no result any more.
    fs::write(at("map.png"), "drawn on").unwrap();
    let run = place.map(1, &[]);
    assert!(run.stderr.contains("map.png") && !run.stderr.contains("map.pgm"), "{}", run.stderr);
    // A cloud that is named is replaced, as any file that is named.
    fs::remove_file(at("map.png")).unwrap();
    fs::write(at("cloud.ply"), "old").unwrap();
    place.map(0, &["--cloud", "cloud.ply"]);
    assert!(fs::read(at("cloud.ply")).unwrap().starts_with(b"ply"));
}

#[test]
fn a_map_is_not_saved_under_the_name_of_another_result() {
    let place = Place::new();
    place.map(0, &["-q"]);
    let map = text(&place.output().join("map.pbstream"));
    let found = place.folder.path().join("found");
    fs::create_dir(&found).unwrap();
    let (output, poses) = (text(&found), text(&found.join("poses.csv")));
    let run = portolan_with_code(2, &["localize", &map, &place.recording, "-o", &output, "--update", &poses]);
    assert!(run.stderr.contains("another result has this name"), "{}", run.stderr);
    assert_eq!(fs::read_dir(&found).unwrap().count(), 0);
}

#[test]
fn edits_that_leave_an_empty_map_name_the_option() {
    let place = Place::new();
    place.map(0, &["-q"]);
    let (map, out) =
        (text(&place.output().join("map.pbstream")), text(&place.folder.path().join("out.pbstream")));
    for (option, value) in [("--delete", "0"), ("--move", "1e300,0"), ("--origin", "-1e308,0")] {
        let run = portolan_with_code(1, &["edit", &map, "-o", &out, &format!("{option}={value}")]);
        let is_named = run.stderr.ends_with("nothing would be left of the map after --delete\n");
        assert!(is_named == (option == "--delete"), "{}", run.stderr);
        assert!(!Path::new(&out).exists());
    }
}

#[test]
fn failed_runs_leave_no_empty_folder() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| text(&folder.path().join(name));
    fs::write(at("t.tum"), "1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n").unwrap();
    fs::write(at("prose.txt"), "nothing of use\n").unwrap();
    fs::create_dir(at("mine")).unwrap();
    let (out, deep, mine, cloud) = (at("out"), at("a/b/out"), at("mine"), at("clouds/c.ply"));
    for arguments in [
        vec!["map", &at("prose.txt"), "-o", &out],
        vec!["map", &at("none"), "-o", &deep, "--cloud", &cloud],
        vec!["map", &at("none"), "-o", &mine],
        vec!["refine", "--recording", &at("prose.txt"), "--trajectory", &at("t.tum"), "-o", &out],
        vec!["localize", &at("prose.txt"), &at("none"), "-o", &out],
    ] {
        portolan_with_code(1, &arguments);
        let mut names: Vec<_> =
            fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        names.sort();
        assert_eq!(names, ["mine", "prose.txt", "t.tum"], "{arguments:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_takes_no_files_is_refused_before_the_work() {
    let place = Place::new();
    place.map(0, &["-q"]);
    let map = text(&place.output().join("map.pbstream"));
    // A folder in which no user can create a file.
    for output in ["/proc/sys", "/proc/sys/results"] {
        for verb in [vec!["map", &place.recording], vec!["localize", &map, &place.recording]] {
            let run = portolan_with_code(1, &[&verb[..], &["-o", output]].concat());
            assert!(run.stderr.starts_with(&format!("error: {output}: ")), "{}", run.stderr);
            assert_eq!(run.stderr.lines().count(), 1, "{}", run.stderr);
        }
    }
}
