//! `portolan info`.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{portolan_with_code, real, simulated};

#[test]
fn info_lists_the_topics_of_a_simulated_recording() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.bag", "a.mcap"] {
        let path = simulated(folder.path(), name, &[]);
        let run = portolan_with_code(0, &["info", &path]);
        for part in ["/scan", "sensor_msgs/LaserScan", "9.9 Hz", "90 readings", "base_link", "└─ laser"] {
            assert!(run.stdout.contains(part), "{part} in {}", run.stdout);
        }
        let run = portolan_with_code(0, &["info", "--json", &path]);
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        assert_eq!(json[0]["kind"], "recording");
        let topics = json[0]["topics"].as_array().unwrap();
        let imu = topics.iter().find(|topic| topic["topic"] == "/imu").unwrap();
        assert_eq!((&imu["type"], imu["frame"].as_str()), (&"sensor_msgs/Imu".into(), Some("imu_link")));
        assert!(imu["count"].as_u64().unwrap() >= 1199);
    }
}

#[test]
fn a_recording_of_the_world() {
    let Some(path) = real("lidar2d/aces/aces.bag") else { return };
    let run = portolan_with_code(0, &["info", "--json", &path]);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    let total: u64 = json[0]["topics"].as_array().unwrap().iter().map(|t| t["count"].as_u64().unwrap()).sum();
    assert_eq!(json[0]["messages"].as_u64().unwrap(), total);
    assert!(total > 7000);
}

#[test]
fn info_of_maps_is_that_of_the_reference() {
    let expected = [
        ("aces", "Trajectory id: 0 has #nodes 2786 has #submaps 70", "#odometry_data: 7374"),
        ("corridor_imu", "Trajectory id: 0 has #nodes 727 has #submaps 10", "#imu_data: 14980"),
        ("small_tsdf", "Trajectory id: 0 has #nodes 27 has #submaps 3", "#submap_2d_grid: 3"),
    ];
    for (name, trajectory, counter) in expected {
        let Some(path) = real(&format!("maps/reference/{name}.pbstream")) else { return };
        let run = portolan_with_code(0, &["info", &path]);
        assert!(run.stdout.contains("Header: format_version: 2\n"), "{}", run.stdout);
        assert!(run.stdout.contains(&format!("{trajectory}\n")), "{}", run.stdout);
        assert!(
            run.stdout.contains(&format!("SerializedData package contains {counter}\n")),
            "{}",
            run.stdout
        );
    }
    let Some(path) = real("maps/reference/small_2d.pbstream") else { return };
    let run = portolan_with_code(0, &["info", "--json", &path, &path]);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert_eq!((json.as_array().unwrap().len(), &json[1]["kind"]), (2, &"map".into()));
    assert_eq!(json[0]["trajectories"][0]["nodes"], 27);
    let run = portolan_with_code(0, &["info", "--all", &path]);
    assert_eq!(run.stdout.matches("\n# message ").count(), 3 + 27 + 3 + 129 + 1);
}

#[test]
fn files_that_are_neither_recording_nor_map_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = common::text(&folder.path().join("notes.txt"));
    std::fs::write(&path, "nothing of interest\n").unwrap();
    let run = portolan_with_code(1, &["info", &path]);
    assert!(run.stderr.contains("notes.txt") && run.stdout.is_empty(), "{}", run.stderr);
    let missing = common::text(&folder.path().join("missing.bag"));
    assert!(portolan_with_code(1, &["info", &missing]).stderr.contains("missing.bag"));
    portolan_with_code(2, &["info"]);
}

#[test]
fn damage_within_a_recording_is_found() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.bag", "a.mcap"] {
        let path = simulated(folder.path(), name, &[]);
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        let run = portolan_with_code(3, &["info", &path]);
        assert!(run.stdout.contains("lost:"), "{name}: {}", run.stdout);
    }
    let Some(log) = real("lidar2d/aces/aces.clf.bz2") else { return };
    let whole = std::fs::read(log).unwrap();
    let cut = common::text(&folder.path().join("cut.clf.bz2"));
    std::fs::write(&cut, &whole[..whole.len() / 2]).unwrap();
    portolan_with_code(3, &["info", &cut]);
    // Its first block is damaged: nothing comes out.
    std::fs::write(&cut, [&whole[..3000], &[0xff; 3], &whole[3003..]].concat()).unwrap();
    let run = portolan_with_code(1, &["info", &cut]);
    assert!(run.stderr.contains("damaged from its beginning"), "{}", run.stderr);
}

#[test]
fn names_in_recordings_control_no_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let path = simulated(folder.path(), "a.bag", &[]);
    let bytes = std::fs::read(&path).unwrap();
    let frame = b"imu_link";
    let mut wrong = bytes.clone();
    for at in 0..bytes.len() - frame.len() {
        if bytes[at..].starts_with(frame) {
            wrong[at] = 0x1b;
        }
    }
    assert!(wrong != bytes);
    std::fs::write(&path, wrong).unwrap();
    let run = common::portolan(&["info", &path]);
    assert!(run.stdout.contains("mu_link") && !run.stdout.contains('\u{1b}'), "{}", run.stdout);
}
