//! `portolan simulate`.
#![allow(clippy::unwrap_used)]

use crate::common;

use std::path::Path;

use common::{portolan, portolan_with_code, text};

/// Simulates, whatever was simulated before.
fn simulated(folder: &Path, name: &str, more: &[&str]) -> String {
    let path = text(&folder.join(name));
    let usual = ["simulate", "corridors", "-o", &path, "--seconds", "12", "--seed", "5", "--beams", "90"];
    portolan_with_code(0, &[&usual, more].concat());
    path
}

#[test]
fn the_same_options_give_the_same_bytes() {
    let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    for name in ["x.bag", "x.mcap"] {
        let first = std::fs::read(simulated(a.path(), name, &["--threads", "1"])).unwrap();
        assert!(first.len() > 10_000 && first == std::fs::read(simulated(b.path(), name, &[])).unwrap());
    }
    let truth = std::fs::read_to_string(a.path().join("x.truth.tum")).unwrap();
    assert_eq!(truth.lines().count(), 1201);
    assert!(
        std::fs::read_to_string(a.path().join("x.walls.csv")).unwrap().starts_with("x0,y0,x1,y1,material\n")
    );
    let mut names: Vec<_> = std::fs::read_dir(a.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["x.bag", "x.mcap", "x.truth.tum", "x.walls.csv"]);
}

#[test]
fn wrong_usage_is_refused_and_leaves_no_files() {
    let folder = tempfile::tempdir().unwrap();
    let output = common::text(&folder.path().join("x.bag"));
    let wrong: [&[&str]; 6] = [
        &["mall"],
        &["--seconds", "-1"],
        &["--fault", "nonsense"],
        &["--size", "40"],
        &["--speed", "1000"],
        &["--truth-rate", "0"],
    ];
    for arguments in wrong {
        let mut all = vec!["simulate", "-o", &output];
        all.extend(arguments);
        let run = portolan_with_code(2, &all);
        assert!(!run.stderr.is_empty(), "{arguments:?}");
    }
    portolan_with_code(2, &["simulate", "-o", "walk.xyz", "--seconds", "5"]);
    let dotted = common::text(&folder.path().join(".").join("x.bag"));
    let other = common::text(&folder.path().join("y"));
    for same in [
        vec!["--truth", &output],
        vec!["--walls", &dotted],
        vec!["--truth", &other, "--walls", &other],
        vec!["museum", "--storeys", "1", "--truth", &other, "--surfaces", &other],
    ] {
        let run = portolan_with_code(2, &[vec!["simulate", "-o", &output, "--seconds", "2"], same].concat());
        assert!(run.stderr.contains("twice"), "{}", run.stderr);
    }
    let nowhere = common::text(&folder.path().join("no/such/folder/x.bag"));
    assert_eq!(portolan(&["simulate", "-o", &nowhere, "--seconds", "2"]).code, Some(1));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn faults_without_their_sensor_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output = common::text(&folder.path().join("x.bag"));
    let wrong: [(&[&str], &str); 5] = [
        (&["museum", "--fault", "jump:5:1:0:0"], "no odometry is recorded"),
        (&["museum", "--fault", "clock:odom:0.1"], "no odometry is recorded"),
        (&["museum", "--no-imu", "--fault", "swap-axes"], "no IMU is recorded"),
        (&["office", "--no-odometry", "--fault", "jump:5:1:0:0"], "no odometry is recorded"),
        (&["office", "--no-imu", "--fault", "no-gravity"], "no IMU is recorded"),
    ];
    for (arguments, why) in wrong {
        let run =
            portolan_with_code(2, &[&["simulate", "-o", &output, "--seconds", "5"], arguments].concat());
        assert!(run.stderr.contains(why), "{arguments:?}: {}", run.stderr);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn worlds_in_3d_have_surfaces_and_the_same_bytes_for_any_thread_count() {
    let folder = tempfile::tempdir().unwrap();
    let simulate = |name: &str, threads: &str| {
        let output = common::text(&folder.path().join(name));
        let arguments = ["museum", "--seconds", "5", "--beams", "90", "--lidars", "2", "--threads", threads];
        portolan_with_code(0, &[&["simulate", "-o", &output, "-q"], &arguments[..]].concat());
        std::fs::read(output).unwrap()
    };
    assert!(simulate("one.bag", "1") == simulate("three.bag", "3"));
    for ending in ["truth.tum", "surfaces.json", "surfaces.ply"] {
        let [one, three] =
            ["one", "three"].map(|n| std::fs::read(folder.path().join(format!("{n}.{ending}"))).unwrap());
        assert!(one == three && one.len() > 1000, "{ending}");
    }
    let output = common::text(&folder.path().join("x.bag"));
    let wrong: [&[&str]; 7] = [
        &["park", "--mounting", "0,0,1,0,0,0", "--mounting", "0,0,1,0,0,90"],
        &["park", "--mounting", "0,0,1"],
        &["office", "--mounting", "0,0,1,0,0,0"],
        &["museum", "--closed-doors", "0.5"],
        &["office", "--lidars", "2"],
        &["park", "--lidars", "9"],
        &["garage", "--lidar", "vlp17"],
    ];
    for arguments in wrong {
        let run = portolan_with_code(2, &[&["simulate", "-o", &output], arguments].concat());
        assert!(!run.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn lidars_have_beams_and_mountings_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    // A lidar with beams of its own, upright and hanging upside down.
    let hanging = |pose: &str| {
        let output = common::text(&folder.path().join("own.bag"));
        let own = ["--lidar", "-20,-5,0,5:120", "--mounting", pose, "-q"];
        portolan_with_code(0, &[&["simulate", "park", "--seconds", "1", "-o", &output], &own[..]].concat());
        std::fs::read(&output).unwrap()
    };
    assert!(hanging("0.5,0,2,180,0,0") != hanging("0.5,0,2,0,0,0"));
}

#[cfg(target_os = "linux")]
#[test]
fn disks_without_room_are_refused_before_anything_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "walk.bag", &[]);
    let truth = text(&Path::new(&recording).with_extension("truth.tum"));
    let (full, closed) = ("/proc: only 0 bytes are free", "/proc: no file can be written there");
    let cases = [
        (full, vec!["simulate", "corridors", "--seconds", "2", "-o", "/proc/walk.bag"]),
        (full, vec!["convert", &truth, "-o", "/proc/walk.csv"]),
        (closed, vec!["refine", "--recording", &recording, "--trajectory", &truth, "-o", "/proc"]),
    ];
    for (reason, arguments) in cases {
        let run = portolan_with_code(1, &arguments);
        assert!(run.stderr.contains(reason), "{arguments:?}: {}", run.stderr);
    }
}
