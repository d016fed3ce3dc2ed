//! `portolan map --from`: going on with a map that was saved.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use std::path::{Path, PathBuf};

use common::{PORTOLAN, portolan_with_code, simulated_once, text, trajectory_errors};
use portolan_testing::is_fast;

/// Seconds of the walk that the known map holds, and from which the continuation begins.
const KNOWN: &str = "100";
const CONTINUED: &str = "70";

/// A recording, a map of it, and a folder for what goes on from there. Recording and map are made once for all tests.
struct Walk {
    folder: tempfile::TempDir,
    recording: String,
    truth: String,
    known: PathBuf,
    known_map: String,
    continued: &'static str,
}

fn office(seconds: &str) -> String {
    let arguments = ["office", "--seconds", seconds, "--seed", "5", "--beams", "180"];
    text(&PORTOLAN.simulated("bag", &arguments))
}

fn map_info(map: &str) -> serde_json::Value {
    let run = portolan_with_code(0, &["info", "--json", map]);
    serde_json::from_str::<serde_json::Value>(&run.stdout).unwrap()[0].take()
}

fn walk_in(recording: String, truth: String, continued: &'static str, more: &[&str]) -> Walk {
    let known = PORTOLAN.made_once(&[&["known", &recording], more].concat(), |folder| {
        portolan_with_code(0, &[&["map", &recording, "-o", &text(folder), "-q"], more].concat());
    });
    let known_map = text(&known.join("map.pbstream"));
    Walk { folder: tempfile::tempdir().unwrap(), recording, truth, known, known_map, continued }
}

fn walk() -> Walk {
    let recording = office("160");
    let truth = recording.replace("walk.bag", "walk.truth.tum");
    walk_in(recording, truth, CONTINUED, &["--duration", KNOWN])
}

/// Through one storey of a museum in 3D.
fn museum_walk() -> Walk {
    let building = ["--no-gnss", "--size", "24x20", "--storeys", "1", "--people", "2", "--beams", "300"];
    let (recording, truth) = simulated_once(&[&["museum", "--seconds", "20"], &building[..]].concat());
    walk_in(recording, truth, "0", &["--no-xray"])
}

impl Walk {
    fn continue_map(&self, name: &str, more: &[&str]) -> std::path::PathBuf {
        let output = self.folder.path().join(name);
        let out = text(&output);
        let mut arguments = vec!["map", &self.recording, "-o", &out, "-q", "--skip", self.continued];
        arguments.extend(["--from", &self.known_map]);
        arguments.extend(more);
        portolan_with_code(0, &arguments);
        output
    }

    /// How far the poses of the same walk are from those of the known map at the same times, metres at most.
    fn farthest_from_known(&self, output: &Path) -> f64 {
        let read = |folder: &Path| -> Vec<Vec<f64>> {
            let poses = std::fs::read_to_string(folder.join("trajectory.tum")).unwrap();
            let lines = poses.lines().filter(|l| !l.starts_with('#'));
            lines.map(|l| l.split(' ').map(|n| n.parse().unwrap()).collect()).collect()
        };
        let known = read(&self.known);
        let off = |new: &Vec<f64>| {
            let old = known.iter().find(|old| (old[0] - new[0]).abs() < 1e-4)?;
            Some((1..4).map(|i| (new[i] - old[i]).powi(2)).sum::<f64>().sqrt())
        };
        let offsets: Vec<f64> = read(output).iter().filter_map(off).collect();
        assert!(offsets.len() > 20, "{}", offsets.len());
        offsets.into_iter().fold(0.0, f64::max)
    }

    /// Largest error of both trajectories together, metres: large if the second is elsewhere in the map
    /// than the first.
    fn error_of_both(&self, output: &Path) -> f64 {
        let read = |path: &Path| std::fs::read_to_string(path).unwrap();
        let known = self.known.join("trajectory.tum");
        let both = self.folder.path().join("both.tum");
        let new = read(&output.join("trajectory.tum"));
        let start: f64 = stamp(new.lines().find(|l| !l.starts_with('#')).unwrap());
        let old = read(&known);
        let old: String = old
            .lines()
            .filter(|l| !l.starts_with('#') && stamp(l) < start)
            .map(|l| format!("{l}\n"))
            .collect();
        std::fs::write(&both, old + &new).unwrap();
        let errors = trajectory_errors(&text(&both), &self.truth);
        errors["absolute"]["translation"]["max"].as_f64().unwrap()
    }
}

fn stamp(line: &str) -> f64 {
    line.split(' ').next().unwrap().parse().unwrap()
}

fn report(output: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(output.join("report.json")).unwrap()).unwrap()
}

#[test]
fn a_recording_is_found_in_a_frozen_map_without_changing_it() {
    if is_fast() {
        return;
    }
    let walk = walk();
    let output = walk.continue_map("frozen", &["--frozen"]);
    let known = &report(&output)["known_map"];
    assert!(known["loop_closures"].as_u64().unwrap() > 3, "{known}");
    assert!(walk.error_of_both(&output) < 0.3, "{}", walk.error_of_both(&output));
    let before = map_info(&walk.known_map);
    let after = map_info(&text(&output.join("map.pbstream")));
    for figure in ["nodes", "submaps", "path_length", "start_time", "duration"] {
        assert_eq!(before["trajectories"][0][figure], after["trajectories"][0][figure], "{figure}");
    }
    assert_eq!(after["trajectories"].as_array().unwrap().len(), 2);
}

#[test]
fn a_map_in_3d_is_continued_on_its_surfaces() {
    if is_fast() {
        return;
    }
    let walk = museum_walk();
    let output = walk.continue_map("frozen", &["--frozen", "--no-xray", "--duration", "10"]);
    let known = &report(&output)["known_map"];
    assert!(known["loop_closures"].as_u64().unwrap() > 3, "{known}");
    assert!(walk.farthest_from_known(&output) < 0.1);
    // Once more from where somebody is already walking and no IMU is at rest.
    let walking = Walk { continued: "9", ..walk };
    let output = walking.continue_map("walking", &["--frozen", "--no-xray", "--duration", "8"]);
    let known = &report(&output)["known_map"];
    assert!(known["placed_after_seconds"].as_f64().unwrap() < 5.0, "{known}");
    assert!(walking.farthest_from_known(&output) < 0.1, "{}", walking.farthest_from_known(&output));
}

#[test]
fn a_trajectory_outlives_the_submaps_that_localisation_trims() {
    if is_fast() {
        return;
    }
    let walk = walk();
    let keep_two = ["--frozen", "--set", "pure_localization_trimmer.max_submaps_to_keep=2"];
    let output = walk.continue_map("trimmed", &[&keep_two[..], &["--all-poses"]].concat());
    let known = &report(&output)["known_map"];
    assert!(known["loop_closures"].as_u64().unwrap() > 3, "{known}");
    assert!(known["first_found_after_seconds"].as_f64().unwrap() < 10.0, "{known}");
    assert!(walk.error_of_both(&output) < 0.3, "{}", walk.error_of_both(&output));
    let poses = |folder: &str, file: &str| {
        let poses = std::fs::read_to_string(walk.folder.path().join(folder).join(file)).unwrap();
        poses.lines().filter(|l| !l.starts_with('#')).count()
    };
    walk.continue_map("kept", &["--frozen", "--all-poses"]);
    for file in ["trajectory.tum", "all_poses.tum"] {
        assert_eq!(poses("trimmed", file), poses("kept", file), "{file}");
    }
    // The map is the known one again.
    let map = text(&output.join("map.pbstream"));
    assert_eq!(map_info(&map)["trajectories"].as_array().unwrap().len(), 1);
}

#[test]
fn optimising_a_map_in_3d_again_changes_it_little() {
    if is_fast() {
        return;
    }
    let walk = museum_walk();
    let again = text(&walk.folder.path().join("again.pbstream"));
    let run = portolan_with_code(0, &["optimize", &walk.known_map, "-o", &again, "--json"]);
    let done: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    // With the weights of Cartographer instead of those that the map was made with it is several centimetres.
    assert!(done["largest_move"].as_f64().unwrap() < 0.005, "{done}");
    // The written file also contains the settings it was made with.
    let run = portolan_with_code(0, &["optimize", &again, "-o", &again, "--json"]);
    let done: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert!(done["largest_move"].as_f64().unwrap() < 0.005, "{done}");
}

#[test]
fn a_map_is_extended_and_optimised_as_a_whole() {
    if is_fast() {
        return;
    }
    let walk = walk();
    let output = walk.continue_map("extended", &[]);
    assert!(walk.error_of_both(&output) < 0.3, "{}", walk.error_of_both(&output));
    let map = text(&output.join("map.pbstream"));
    portolan_with_code(0, &["check", &map]);
    // And once more: the recording is the third trajectory now.
    let again = walk.folder.path().join("again");
    let more = ["--from", &map, "--frozen", "--skip", "140", "--force", "-q", "-o"];
    let out = text(&again);
    portolan_with_code(0, &[&["map", walk.recording.as_str()][..], &more[..], &[out.as_str()][..]].concat());
    let known = &report(&again)["known_map"];
    assert!(known["loop_closures"].as_u64().unwrap() > 3, "{known}");
    let info = map_info(&text(&again.join("map.pbstream")));
    assert_eq!(info["trajectories"].as_array().unwrap().len(), 3);
}

#[test]
fn a_given_start_needs_no_search() {
    if is_fast() {
        return;
    }
    let walk = walk();
    // Wherever it starts, the map knows it best.
    let poses = std::fs::read_to_string(walk.known.join("trajectory.tum")).unwrap();
    let first: Vec<f64> = poses
        .lines()
        .filter(|l| !l.starts_with('#'))
        .map(|l| l.split(' ').map(|n| n.parse().unwrap()).collect::<Vec<f64>>())
        .next()
        .unwrap();
    let yaw = 2.0 * first[6].atan2(first[7]).to_degrees();
    let start = format!("{},{},{yaw}", first[1] + 0.3, first[2] - 0.2);
    let output = walk.folder.path().join("started");
    let none = "pose_graph.global_sampling_ratio=0";
    let arguments = [
        "map",
        &walk.recording,
        "-o",
        &text(&output),
        "-q",
        "--duration",
        "60",
        "--from",
        &walk.known_map,
        "--frozen",
        "--start",
        &start,
        "--set",
        none,
    ];
    portolan_with_code(0, &arguments);
    let known = &report(&output)["known_map"];
    assert!(known["loop_closures"].as_u64().unwrap() > 3, "{known}");
}

#[test]
fn maps_that_cannot_be_continued_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let recording = office("20");
    let output = text(&folder.path().join("out"));
    let map = |more: &[&str], code| {
        portolan_with_code(code, &[&["map", &recording, "-o", &output, "-q"], more].concat())
    };
    let no_map = text(&folder.path().join("no.pbstream"));
    assert!(map(&["--from", &no_map], 1).stderr.contains("no.pbstream"));
    assert!(map(&["--from", &recording], 1).stderr.contains("walk.bag"));
    map(&["--frozen"], 2);
    if let Some(map_3d) = common::real("maps/reference/small_3d.pbstream") {
        assert!(map(&["--from", &map_3d], 1).stderr.contains("3D"));
    }
}
