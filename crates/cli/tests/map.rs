//! `portolan map` and `portolan demo`, from recordings to files.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use std::path::Path;

use common::{Run, portolan_with_code, real, simulated, survives_damage, text};
use portolan_testing::is_fast;

/// Maps into a folder; gives map and trajectory.
#[track_caller]
fn map(recording: &str, folder: &Path, more: &[&str]) -> (Vec<u8>, Vec<u8>) {
    let output = text(folder);
    let mut arguments = vec!["map", recording, "-o", &output, "-q"];
    arguments.extend(more);
    portolan_with_code(0, &arguments);
    let read = |name: &str| std::fs::read(folder.join(name)).unwrap();
    (read("map.pbstream"), read("trajectory.tum"))
}

fn report(folder: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(folder.join("report.json")).unwrap()).unwrap()
}

#[test]
fn the_same_bytes_with_any_number_of_threads_and_from_any_form() {
    if is_fast() {
        return;
    }
    let Some(aces) = real("lidar2d/aces") else { return };
    let folder = tempfile::tempdir().unwrap();
    let run = |recording: &str, threads: &str| {
        map(&format!("{aces}/{recording}"), folder.path(), &["--duration", "150", "--threads", threads])
    };
    let one = run("aces.bag", "1");
    assert!(report(folder.path())["loop_closures"].as_u64().unwrap() > 10);
    // What is the same in all three depends neither on threads nor on the form.
    for (recording, threads) in [("aces.clf.bz2", "2"), ("aces_ros2", "4")] {
        let other = run(recording, threads);
        assert!(one.0 == other.0, "the map of {recording} with {threads} threads differs");
        assert!(one.1 == other.1, "the trajectory of {recording} with {threads} threads differs");
    }
}

#[test]
fn all_documented_files_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let output = folder.path().join("results");
    let run = portolan_with_code(0, &["map", &recording, "-o", &text(&output), "--all-poses"]);
    for name in
        ["map.pbstream", "trajectory.tum", "all_poses.tum", "map.png", "map.pgm", "map.yaml", "report.json"]
    {
        assert!(output.join(name).metadata().unwrap().len() > 0, "{name}");
        assert!(run.stdout.contains(name), "{name} is not named in {}", run.stdout);
    }
    let written = std::fs::read_to_string(output.join("report.json")).unwrap();
    assert!(!written.contains(": -0.0,"), "{written}");
    let report = report(&output);
    let info = portolan_with_code(0, &["info", &text(&output.join("map.pbstream"))]).stdout;
    let engine = report["engine"].as_str().unwrap();
    assert!(info.contains(&format!("Engine: {engine}\n")), "{engine} is not in {info}");
    assert_eq!(report["interrupted"], false);
    assert_eq!(report["local_slam"]["scans"], report["scans"]);
    assert_eq!(report["options_fingerprint"].as_str().unwrap().len(), 32);
    assert!(report["memory_bytes"]["peak"].as_u64().is_none_or(|bytes| bytes > 1 << 20));
    portolan_with_code(0, &["check", &text(&output.join("map.pbstream"))]);
}

#[test]
fn settings_are_checked_before_anything_is_mapped() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let output = text(&folder.path().join("results"));
    let wrong = |set: &str| portolan_with_code(2, &["map", &recording, "-o", &output, "--set", set]);
    assert!(wrong("min_scroe=0.5").stderr.contains("min_score"));
    assert!(wrong("portolan.search_penalty_limit=7").stderr.contains("search_penalty_limit"));
    let config = format!("{}/no.lua", folder.path().display());
    let missing = portolan_with_code(1, &["map", &recording, "-o", &output, "--config", &config]);
    assert!(missing.stderr.contains("no.lua"));
}

#[test]
fn settings_change_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let nodes = |set: &str| {
        map(&recording, folder.path(), &["--set", set]);
        report(folder.path())["nodes"].as_u64().unwrap()
    };
    let local = "trajectory_builder.trajectory_builder_2d";
    let all = nodes(&format!("{local}.motion_filter.max_time_seconds=0"));
    let few = nodes(&format!("{local}.motion_filter.max_distance_meters=1.5"));
    assert!(all > 100 && few < all / 2, "{all} {few}");
}

/// Every kind of damaged recording ends in a map or a named error, and never half a file.
#[test]
fn damaged_recordings_end_in_a_map_or_an_error() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    survives_damage(&recording, folder.path(), &[0.0, 0.001, 0.3, 0.7, 0.999], 6, 200);
}

#[test]
fn an_impossible_output_folder_is_an_error_before_mapping() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let file = folder.path().join("file");
    std::fs::write(&file, "in the way").unwrap();
    let run = portolan_with_code(1, &["map", &recording, "-o", &text(&file.join("results"))]);
    assert!(run.stderr.contains("file"), "{}", run.stderr);
    assert!(run.stdout.is_empty());
}

#[test]
fn an_unwritable_cloud_is_an_error_before_mapping() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let (file, output) = (folder.path().join("file"), text(&folder.path().join("results")));
    std::fs::write(&file, "in the way").unwrap();
    for cloud in [file.join("walk.ply"), file.join("more/walk.ply")] {
        let run = portolan_with_code(1, &["map", &recording, "-o", &output, "--cloud", &text(&cloud)]);
        assert!(run.stderr.contains("file") && run.stdout.is_empty(), "{}", run.stderr);
    }
    assert!(!Path::new(&output).exists());
    let cloud = folder.path().join("new/folder/walk.ply");
    portolan_with_code(0, &["map", &recording, "-o", &output, "--cloud", &text(&cloud)]);
    assert!(cloud.exists());
}

/// What waits for the cloud to be complete does so beside it: the folder for temporary files may be small.
#[cfg(unix)]
#[test]
fn clouds_need_no_folder_for_temporary_files() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let run = std::process::Command::new(env!("CARGO_BIN_EXE_portolan"))
        .args(["map", &recording, "-o", &text(&folder.path().join("results")), "--cloud", "walk.e57"])
        .env("TMPDIR", folder.path().join("nowhere"))
        .output()
        .unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
}

#[test]
fn the_reason_for_no_usable_scan_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let output = text(&folder.path().join("results"));
    let stderr =
        |cut: &[&str]| portolan_with_code(1, &[&["map", &recording, "-o", &output], cut].concat()).stderr;
    assert!(stderr(&["--skip", "100"]).contains("--skip 100 leaves no usable scan"));
    let both = stderr(&["--skip", "100", "--duration", "2"]);
    assert!(both.contains("--skip 100 with --duration 2") && both.contains("12.0 s"), "{both}");
}

#[test]
fn a_missing_recording_is_named() {
    let run = portolan_with_code(1, &["map", "nowhere.bag", "-o", "unused"]);
    assert!(run.stderr.contains("nowhere.bag"), "{}", run.stderr);
}

#[cfg(unix)]
#[test]
fn an_interrupt_saves_the_partial_map() {
    let Some(aces) = real("lidar2d/aces/aces.bag") else { return };
    let folder = tempfile::tempdir().unwrap();
    let output = text(folder.path());
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_portolan"))
        .args(["map", &aces, "-o", &output, "--threads", "1"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    // The journal appears once something was mapped.
    while !folder.path().join("map.journal").exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let finished = child.wait_with_output().unwrap();
    assert_eq!(finished.status.code(), Some(130), "{}", String::from_utf8_lossy(&finished.stderr));
    portolan_with_code(0, &["info", &text(&folder.path().join("map.pbstream"))]);
    let report = report(folder.path());
    if report["interrupted"] == true {
        assert!(
            String::from_utf8_lossy(&finished.stdout)
                .contains("interrupted: stopped before the map was finished")
        );
    }
}

#[track_caller]
fn demo_errors(folder: &Path, more: &[&str]) -> (Run, f64) {
    let run = portolan_with_code(0, &[&["demo", "-q", "-o", &text(folder)], more].concat());
    let line = run.stdout.lines().find_map(|line| line.strip_prefix("against the truth: ")).unwrap();
    let metres = line.split_whitespace().next().unwrap().parse().unwrap();
    (run, metres)
}

#[test]
fn the_demo_in_2d_is_accurate() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (run, metres) = demo_errors(folder.path(), &["--planar", "--seconds", "60"]);
    // Measured: 0.021 m.
    assert!(metres <= 0.027, "{}", run.stdout);
    assert!(folder.path().join("map.png").exists());
}

#[test]
fn the_demo_writes_a_recording_its_map_and_pictures() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (run, metres) = demo_errors(folder.path(), &["--seconds", "20"]);
    // Measured: 0.003 m, printed to the millimetre.
    assert!(metres <= 0.004, "{}", run.stdout);
    for name in ["museum.mcap", "museum.truth.tum", "map.pbstream", "trajectory.tum", "map_section.png"] {
        assert!(folder.path().join(name).metadata().unwrap().len() > 2_000, "{name}");
    }
    for side in ["top", "front", "side"] {
        assert!(run.stdout.contains(&format!("map_xray_{side}.png")), "{}", run.stdout);
    }
    // From what mapping kept: the recording is not read again.
    let report = report(folder.path());
    assert_eq!(report["cloud"], serde_json::json!({ "xrays_from": "scans kept while mapping" }));
}
