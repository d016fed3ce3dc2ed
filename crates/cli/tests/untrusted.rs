//! What failed does not look done: exit code 4, plain words, and no result that looks like one.
#![allow(clippy::unwrap_used)]

use crate::common;

use std::path::Path;

use common::{Run, portolan, portolan_with_code, simulated_once, text};

const OFFICE: [&str; 7] = ["office", "--seconds", "25", "--beams", "180", "--people", "0"];

/// A recording of an office, and where its truth is; another seed is another building.
fn office(seed: &str) -> (String, String) {
    simulated_once(&[&OFFICE[..], &["--seed", seed]].concat())
}

fn mapped(recording: &str, folder: &Path, more: &[&str]) -> (Run, std::path::PathBuf) {
    let output = folder.join("results");
    let run = portolan(&[&["map", recording, "-o", &text(&output)], more].concat());
    (run, output)
}

#[test]
fn another_building_is_not_placed_in_the_known_map() {
    let folder = tempfile::tempdir().unwrap();
    let (here, _) = office("1");
    let (elsewhere, _) = office("2");
    let known = text(&folder.path().join("known/map.pbstream"));
    portolan_with_code(0, &["map", &here, "-o", &text(&folder.path().join("known")), "-q"]);
    let from = ["--from", &known];
    let (run, output) = mapped(&elsewhere, folder.path(), &from);
    assert_eq!(run.code, Some(4), "{} {}", run.stdout, run.stderr);
    assert!(run.stdout.contains("NOT found in the known map"), "{}", run.stdout);
    assert!(run.stderr.contains("no map was written"), "{}", run.stderr);
    let left = std::fs::read_dir(&output).unwrap().map(|e| e.unwrap().file_name());
    let left: Vec<_> = left.filter(|name| name != portolan::job::MANIFEST).collect();
    assert!(output.join("trajectory.tum").exists() && output.join("report.json").exists(), "{left:?}");
    assert_eq!(left.len(), 2, "{left:?}");
    // With --force the result is written, with a warning.
    let (run, output) = mapped(&elsewhere, folder.path(), &[&from[..], &["--force"]].concat());
    assert_eq!(run.code, Some(4), "{} {}", run.stdout, run.stderr);
    assert!(output.join("map.pbstream").exists());
    // A start in the middle of the known map says nothing better.
    for other in ["2", "3"] {
        let start = [&from[..], &["--start", "0,0,0"]].concat();
        let (run, _) = mapped(&office(other).0, folder.path(), &start);
        assert_eq!(run.code, Some(4), "{} {}", run.stdout, run.stderr);
        assert!(run.stdout.contains("NOT found in the known map: at --start"), "{}", run.stdout);
        assert!(run.stderr.contains("map.pbstream there is of an earlier run"), "{}", run.stderr);
    }
    // Far away nothing speaks for or against it.
    let (run, output) = mapped(&elsewhere, folder.path(), &[&from[..], &["--start", "500,0,0"]].concat());
    assert_eq!(run.code, Some(3), "{} {}", run.stdout, run.stderr);
    assert!(run.stdout.contains("nothing confirms") && output.join("map.pbstream").exists());
}

/// Of a walk through a building, seen by a lidar that sees less far than the rooms are wide.
fn poor_walk(seed: &str, seconds: &str, range: &str) -> (String, String) {
    let walk = ["--building-seed", "12", "--seed", seed, "--seconds", seconds];
    simulated_once(&[&["office", "--beams", "60", "--range", range][..], &walk].concat())
}

#[test]
fn a_wrong_start_in_an_office_with_few_returns_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let known = text(&folder.path().join("known/map.pbstream"));
    portolan_with_code(
        0,
        &["map", &poor_walk("121", "120", "12").0, "-o", &text(&folder.path().join("known")), "-q"],
    );
    let (again, _) = poor_walk("125", "40", "4");
    let start_of = |more: &[&str]| {
        let (run, output) = mapped(&again, folder.path(), &[&["--from", &known, "--frozen"], more].concat());
        let poses = std::fs::read_to_string(output.join("trajectory.tum")).unwrap();
        let first: Vec<f64> =
            poses.lines().next().unwrap().split(' ').map(|field| field.parse().unwrap()).collect();
        (run, [first[1], first[2]])
    };
    let (run, right) = start_of(&[]);
    assert_eq!(run.code, Some(0), "{} {}", run.stdout, run.stderr);
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    for (x, y) in [(2.0, 0.6), (-4.8, -1.3), (9.6, 3.0)] {
        let wrong = format!("--start={},{},0", right[0] + x, right[1] + y);
        let (run, found) = start_of(&[&wrong]);
        assert_eq!(run.code, Some(0), "{} {}", run.stdout, run.stderr);
        assert!(run.stdout.contains("from --start, where scans do not fit"), "{}", run.stdout);
        assert!(apart(found, right) < 0.3, "{found:?} {right:?}");
    }
}

#[test]
fn a_merged_map_is_found_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let maps = ["1", "2"].map(|seed| {
        let output = folder.path().join(seed);
        portolan_with_code(0, &["map", &office(seed).0, "-o", &text(&output), "-q"]);
        text(&output.join("map.pbstream"))
    });
    let both = text(&folder.path().join("both.pbstream"));
    let merge = |other: &str, more: &[&str], code| {
        portolan_with_code(code, &[&["edit", &maps[0], "-o", &both, "--merge", other], more].concat())
    };
    let run = merge(&maps[1], &[], 4);
    assert!(run.stderr.contains("was not found") && run.stderr.contains("--place X,Y,YAW"), "{}", run.stderr);
    assert!(!Path::new(&both).exists());
    // Moved, so that its place is another one.
    let moved = text(&folder.path().join("moved.pbstream"));
    portolan_with_code(0, &["edit", &maps[0], "-o", &moved, "--rotate", "30", "--move=5,-3"]);
    let run = merge(&moved, &["--json"], 0);
    assert!(run.stderr.contains("trajectory 0 is 1; found at"), "{}", run.stderr);
    let report: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    let merged = &report["merged"][0];
    assert!(merged["loop_closures"].as_u64() > Some(3), "{merged}");
    // A loop closure that somebody adds is looked at, too.
    let add = |pose: &str, code| {
        let added = format!("--add-loop=0,0:0,3={pose}");
        portolan_with_code(code, &["edit", &maps[0], "-o", &both, &added])
    };
    assert!(add("50,0,0", 3).stderr.contains("does NOT fit"));
    merge(&maps[1], &["--place", "0,0,0"], 0);
    merge(&maps[1], &["--place", "0,0,0", "--place", "0,0,0"], 2);
}

/// The walls of a room with a corner cut off, so that it fits itself in one pose only, metres.
fn room(width: f64, depth: f64, height: f64) -> Vec<[f64; 3]> {
    let random = |i: u32, k: f64| (f64::from(i) * k).fract();
    (0..12_000)
        .map(|i| {
            let (u, v) = (random(i, 0.754_877_666), random(i, 0.569_840_291));
            match i % 6 {
                0 => [u * width, v * depth, 0.0],
                1 => [u * width, 0.0, v * height],
                2 => [u * width, depth - 0.4 * u * u * width, v * height],
                3 => [0.0, u * depth, v * height],
                4 => [width, u * depth, v * height],
                _ => [width * 0.3 + u, depth * 0.3, v * height * 0.6],
            }
        })
        .collect()
}

fn write(path: &Path, points: &[[f64; 3]]) -> String {
    let lines: String = points.iter().map(|[x, y, z]| format!("{x:.4} {y:.4} {z:.4}\n")).collect();
    std::fs::write(path, lines).unwrap();
    text(path)
}

#[test]
fn scans_that_do_not_overlap_are_not_registered() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let here = write(&at("here.xyz"), &room(6.0, 5.0, 2.5));
    let shifted: Vec<_> = room(6.0, 5.0, 2.5).iter().map(|[x, y, z]| [x + 0.1, y - 0.05, z + 0.02]).collect();
    let again = write(&at("again.xyz"), &shifted);
    let beyond: Vec<_> = room(3.0, 9.0, 4.0).iter().map(|[x, y, z]| [x + 4.5, z + 2.0, y - 3.0]).collect();
    let elsewhere = write(&at("elsewhere.xyz"), &beyond);
    let output = text(&at("together"));
    let run = portolan_with_code(0, &["register", &here, &again, "-o", &output]);
    assert!(run.stdout.contains(", sigma "), "{}", run.stdout);
    std::fs::remove_dir_all(&output).unwrap();
    let run = portolan_with_code(4, &["register", &here, &elsewhere, "-o", &output]);
    assert!(run.stderr.contains("NOT registered") && run.stderr.contains("--force"), "{}", run.stderr);
    assert!(!run.stdout.contains(", sigma ") && !Path::new(&output).exists(), "{}", run.stdout);
    let run = portolan_with_code(4, &["register", &here, &elsewhere, "-o", &output, "--force", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert!(
        report["scans"][1]["doubt"].is_string() && report["scans"][1]["deviations"].is_null(),
        "{report}"
    );
    assert!(Path::new(&output).join("poses.tum").exists());
    let far: Vec<_> = room(6.0, 5.0, 2.5).iter().map(|[x, y, z]| [x + 500.0, *y, *z]).collect();
    let run = portolan_with_code(4, &["register", &here, &write(&at("far.xyz"), &far)]);
    assert!(run.stderr.contains("points have a partner within"), "{}", run.stderr);
    // Of several scans the others are good.
    let run = portolan_with_code(3, &["register", &here, &again, &elsewhere, "--metascan"]);
    assert!(run.stderr.contains("elsewhere.xyz: NOT registered"), "{}", run.stderr);
}
