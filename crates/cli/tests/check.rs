//! `portolan check`.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{portolan, portolan_with_code, real, simulated};

#[test]
fn a_good_recording_has_no_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = simulated(folder.path(), "good.bag", &[]);
    let run = portolan_with_code(0, &["check", &path]);
    assert!(run.stdout.contains("nothing wrong was found"), "{}", run.stdout);
}

#[test]
fn faults_are_named_with_effect_and_advice() {
    let folder = tempfile::tempdir().unwrap();
    let faults = [
        ("no-gravity", "m/s^2", 1),
        ("gap:scan:4:7", "large gap, largest is 3.1", 1),
        ("duplicate:imu:100", "two messages of frame_id \"imu_link\"", 0),
        ("backward:scan:20:0.5", "jumps backwards", 1),
        ("no-tf:scan", "no transforms connect", 0),
        ("clock:scan:0.8", "serialization time and sensor time differ by -0.7", 1),
        ("clock:imu:0.2", "sensor time differ by -0.200 s", 0),
        ("empty:10", "without a single distance", 0),
    ];
    for (index, (fault, finding, code)) in faults.into_iter().enumerate() {
        let path = simulated(folder.path(), &format!("{index}.bag"), &["--fault", fault]);
        let run = portolan_with_code(code, &["check", &path]);
        assert!(run.stdout.contains(finding), "{fault}: {}", run.stdout);
        assert!(run.stdout.contains("to do:  "), "{}", run.stdout);
    }
}

#[test]
fn recordings_that_map_cannot_use_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let output = common::text(&folder.path().join("results"));
    let (path, mut ends) = (common::text(&folder.path().join("short.bag")), Vec::new());
    for scenario in ["corridors", "garage"] {
        for seconds in ["0.1", "0.2"] {
            portolan_with_code(0, &["simulate", scenario, "--seconds", seconds, "-o", &path, "-q"]);
            let (map, check) = (portolan(&["map", &path, "-o", &output]), portolan(&["check", &path]));
            assert_eq!(map.code, check.code, "{scenario} {seconds}: {} {}", map.stderr, check.stdout);
            ends.push(map.code.unwrap());
        }
    }
    assert_eq!(ends, [1, 0, 1, 0]);
    let Some(path) = real("ros_bags/ouster_512x10_raw.bag") else { return };
    let run = portolan_with_code(1, &["check", &path]);
    assert!(run.stdout.contains("the only scan begins before /os_node0/imu_packets does"), "{}", run.stdout);
    assert!(run.stdout.contains("harmless remarks [-v lists them]"), "{}", run.stdout);
    portolan_with_code(1, &["map", &path, "-o", &output]);
}

#[test]
fn a_damaged_bag_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = simulated(folder.path(), "whole.bag", &[]);
    let mut bytes = std::fs::read(&path).unwrap();
    bytes.truncate(bytes.len() / 2);
    let damaged = common::text(&folder.path().join("damaged.bag"));
    std::fs::write(&damaged, bytes).unwrap();
    let run = portolan_with_code(1, &["check", "--json", &damaged]);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert!(json[0]["errors"].as_u64().unwrap() > 0, "{}", run.stdout);
    assert_eq!(json[0]["findings"][0]["severity"], "error");
    let run = portolan(&["info", &damaged]);
    assert!(matches!(run.code, Some(0 | 3)), "{}", run.stderr);
    assert!(run.stdout.contains("lost: ") || run.stdout.contains("repaired: "), "{}", run.stdout);
}

#[test]
fn maps_are_checked() {
    let Some(path) = real("maps/reference/small_2d.pbstream") else { return };
    let run = portolan_with_code(0, &["check", &path]);
    assert!(run.stdout.contains("map"), "{}", run.stdout);
    let folder = tempfile::tempdir().unwrap();
    let damaged = common::text(&folder.path().join("damaged.pbstream"));
    let mut bytes = std::fs::read(&path).unwrap();
    bytes.truncate(bytes.len() - 100);
    std::fs::write(&damaged, bytes).unwrap();
    let run = portolan_with_code(1, &["check", &damaged]);
    assert!(run.stdout.contains("error: message") && run.stderr.contains("found"), "{}", run.stdout);
    assert!(run.stdout.contains("repair: keeps the complete records"), "{}", run.stdout);
    let run = portolan_with_code(3, &["info", &damaged]);
    assert!(run.stdout.contains("lost: message 1") && run.stdout.contains(" at byte "), "{}", run.stdout);
}

/// A map of a short drive in 2D.
fn small_map(folder: &std::path::Path) -> String {
    let recording = simulated(folder, "drive.bag", &[]);
    let output = common::text(&folder.join("map"));
    portolan_with_code(0, &["map", &recording, "-o", &output, "-q", "--no-xray"]);
    common::text(&folder.join("map/map.pbstream"))
}

#[test]
fn places_of_a_map_are_examined_only_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let map = small_map(folder.path());
    let json = |more: &[&str]| -> serde_json::Value {
        let run = portolan_with_code(0, &[&["check", &map, "--json", "-q"], more].concat());
        serde_json::from_str(&run.stdout).unwrap()
    };
    assert!(json(&[])[0].get("places").is_none());
    let run = portolan_with_code(0, &["check", &map]);
    assert!(!run.stdout.contains("places"), "{}", run.stdout);
    let examined = &json(&["--places"])[0]["places"];
    let places = examined["places"].as_array().unwrap();
    assert!(places.len() > 2 && places[0]["pose"]["yaw"].is_f64(), "{examined}");
    let sum = |key: &str| -> f64 {
        examined["kinds"].as_array().unwrap().iter().map(|kind| kind[key].as_f64().unwrap()).sum()
    };
    assert!((sum("fraction_of_trajectory") - 1.0).abs() < 1e-9, "{examined}");
    assert!((sum("places") - places.len() as f64).abs() < 1e-9, "{examined}");
    let picture = common::text(&folder.path().join("places.png"));
    let run = portolan_with_code(0, &["check", &map, "--picture", &picture]);
    assert!(run.stdout.contains("were examined"), "{}", run.stdout);
    assert!(std::fs::read(&picture).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn pictures_of_places_are_of_one_map() {
    let folder = tempfile::tempdir().unwrap();
    let recording = simulated(folder.path(), "drive.bag", &[]);
    let picture = common::text(&folder.path().join("places.png"));
    let run = portolan_with_code(2, &["check", &recording, "--picture", &picture]);
    assert!(run.stderr.contains("--picture needs a map"), "{}", run.stderr);
    let run = portolan_with_code(2, &["check", "a.pbstream", "b.pbstream", "--picture", &picture]);
    assert!(run.stderr.contains("--picture draws one map"), "{}", run.stderr);
    let run = portolan_with_code(2, &["check", "a.pbstream", "--picture", "places.jpg"]);
    assert!(run.stderr.contains("are .png"), "{}", run.stderr);
    portolan_with_code(1, &["check", "none.pbstream", "--picture", &picture]);
    portolan_with_code(0, &["check", &recording, "--places", "-q"]);
    assert!(!std::path::Path::new(&picture).exists());
}

#[test]
fn maps_whose_places_cannot_be_examined_are_reported() {
    let Some(space) = real("maps/reference/small_3d.pbstream") else { return };
    portolan_with_code(0, &["check", &space]);
    let folder = tempfile::tempdir().unwrap();
    let picture = common::text(&folder.path().join("places.png"));
    let run = portolan_with_code(1, &["check", &space, "--places"]);
    assert!(run.stdout.contains("places are examined in 2D only"), "{}", run.stdout);
    portolan_with_code(1, &["check", &space, "--picture", &picture]);
    assert!(!std::path::Path::new(&picture).exists());
}
