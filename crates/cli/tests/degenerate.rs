//! Where scans do not constrain the motion: what is used instead, and how it is reported.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{portolan_with_code, simulated_once, text, trajectory_errors};
use portolan_testing::is_fast;

/// A mapped simulation.
struct Mapped {
    /// What `map` printed.
    summary: String,
    report: serde_json::Value,
    /// The largest error against the truth, metres.
    largest_error: f64,
    trajectory: String,
}

/// Simulates with few beams and maps.
fn mapped(scene: &[&str], settings: &[&str]) -> Mapped {
    mapped_of(&[scene, &["--beams", "180", "--seed", "3"]].concat(), settings)
}

/// The same with beams and seed that the scene names.
fn mapped_of(scene: &[&str], settings: &[&str]) -> Mapped {
    let (recording, truth) = simulated_once(scene);
    let folder = tempfile::tempdir().unwrap();
    let map = ["map", &recording, "-o", &text(folder.path()), "-q", "--no-xray"];
    let summary = portolan_with_code(0, &[&map, settings].concat()).stdout;
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let errors = trajectory_errors(&text(&folder.path().join("trajectory.tum")), &truth);
    Mapped {
        summary,
        report: serde_json::from_str(&read("report.json")).unwrap(),
        largest_error: errors["absolute"]["translation"]["max"].as_f64().unwrap(),
        trajectory: read("trajectory.tum"),
    }
}

/// Seconds in which scans did not constrain a component of motion.
fn seconds(report: &serde_json::Value, motion: &str) -> f64 {
    report["degenerate_seconds"][motion].as_f64().unwrap()
}

/// Asserts that an error is at most 1.3 times what was measured.
#[track_caller]
fn assert_as_measured(mapped: &Mapped, measured: f64) {
    assert!(mapped.largest_error <= 1.3 * measured, "{} m, measured {measured} m", mapped.largest_error);
}

#[test]
fn along_a_tunnel_odometry_is_used_and_reported() {
    if is_fast() {
        return;
    }
    let map = mapped(&["tunnel", "--seconds", "16"], &[]);
    let (summary, report) = (&map.summary, &map.report);
    assert!(seconds(report, "along_travel") > 10.0, "{report}");
    assert!(seconds(report, "vertical") < 1.0, "{report}");
    assert!(seconds(report, "heading") < 1.0, "{report}");
    assert!(summary.contains("do not constrain motion along the direction of travel;"), "{summary}");
    assert!(summary.contains("odometry was used"), "{summary}");
    assert_as_measured(&map, 0.224);
}

#[test]
fn in_a_field_heading_is_degenerate_too_and_satellites_help() {
    if is_fast() {
        return;
    }
    let map = mapped(&["field", "--seconds", "16"], &["--set", "use_nav_sat=true"]);
    let (summary, report) = (&map.summary, &map.report);
    for (key, motion) in [
        ("along_travel", "motion along the direction of travel"),
        ("across_travel", "motion across the direction of travel"),
        ("heading", "heading"),
    ] {
        assert!(seconds(report, key) > 10.0, "{motion}: {report}");
        assert!(summary.contains(&format!("do not constrain {motion};")), "{summary}");
    }
    assert!(seconds(report, "vertical") < 1.0 && seconds(report, "roll_pitch") < 4.0, "{report}");
    assert!(summary.contains("the gyroscope was used"), "{summary}");
    assert_as_measured(&map, 0.0302);
}

#[test]
fn rings_on_the_grass_do_not_stop_the_estimate_of_a_moving_scanner() {
    if is_fast() {
        return;
    }
    // With so many beams the hits in a voxel make planes that look down: they seemed to show that it stands.
    let scene = ["field", "--seconds", "30", "--beams", "450", "--seed", "1"];
    let report = mapped_of(&scene, &["--no-odometry", "--duration", "10"]).report;
    for motion in ["along_travel", "across_travel", "heading"] {
        assert!(seconds(&report, motion) > 8.0, "{motion}: {report}");
    }
}

/// Two sparse sweeps show few surfaces, and grids of a few sweeps hold the scanner where its beams drew them: walks
/// that are recorded from their middle on are followed mostly, not always.
#[test]
fn most_recordings_from_the_middle_of_a_walk_among_trees_are_tracked() {
    if is_fast() {
        return;
    }
    let error = |seed: u32| {
        let scene = ["park", "--seconds", "16", "--beams", "450", "--seed", &seed.to_string()];
        mapped_of(&scene, &["--no-odometry", "--skip", "9", "--duration", "7"]).largest_error
    };
    let mut errors: Vec<f64> = (1..=8).map(error).collect();
    errors.sort_by(f64::total_cmp);
    // Measured: 0.018 to 0.036 m for five of eight, and 0.11, 0.26 and 0.36 m.
    assert!(errors[4] <= 1.3 * 0.036, "{errors:?}");
    assert!(errors[5] <= 1.3 * 0.106 && errors[7] <= 1.3 * 0.363, "{errors:?}");
}

#[test]
fn a_walk_among_trees_without_imu_and_wheels_is_tracked() {
    if is_fast() {
        return;
    }
    // Rings on the ground held this scanner where it was, to a tenth of its path; trunks show its motion.
    // Seeds 1 to 8 gave 0.013 to 0.057 m.
    let map = mapped_of(&["park", "--seconds", "10", "--seed", "4"], &["--no-imu", "--no-odometry"]);
    assert_as_measured(&map, 0.0436);
}

#[test]
fn wheels_do_not_flatten_ramps() {
    if is_fast() {
        return;
    }
    assert_as_measured(&mapped(&["garage", "--seconds", "16"], &["--no-imu"]), 0.0147);
}

#[test]
fn among_cars_no_direction_is_degenerate_and_the_first_pose_is_level() {
    if is_fast() {
        return;
    }
    let Mapped { summary, report, trajectory, .. } = mapped(&["garage", "--seconds", "10"], &[]);
    assert!(!summary.contains("do not constrain"), "{summary}");
    let total: f64 =
        report["degenerate_seconds"].as_object().unwrap().values().filter_map(|v| v.as_f64()).sum();
    assert!(total < 1.0, "{report}");
    // The first pose of the truth is level: x and y of the quaternion are half of what the map is tilted.
    let first = trajectory.lines().find(|line| !line.starts_with('#')).unwrap();
    let numbers: Vec<f64> = first.split_whitespace().map(|word| word.parse().unwrap()).collect();
    let tilt = 2.0 * numbers[4].hypot(numbers[5]).to_degrees();
    assert!(tilt < 2.0, "{tilt}: {first}");
}

#[test]
fn lidars_whose_sweeps_never_repeat_are_followed_without_an_imu() {
    if is_fast() {
        return;
    }
    // Two such sweeps hardly show the same things; taken at their word, these drives began at 30 m/s.
    let settings = ["--no-imu", "--no-odometry"];
    for (scene, beams, measured) in [("garage", "2500", 0.0472), ("park", "5000", 0.0713)] {
        let scene = [scene, "--seconds", "8", "--lidar", "mid360", "--beams", beams];
        assert_as_measured(&mapped_of(&scene, &settings), measured);
    }
}

/// Maps a recording of a planar lidar: what `map` printed, and the report.
fn map_2d(code: i32, recording: &str, more: &[&str]) -> (String, serde_json::Value) {
    let folder = tempfile::tempdir().unwrap();
    let map = ["map", recording, "-o", &text(folder.path()), "-q", "--no-xray"];
    let summary = portolan_with_code(code, &[&map, more].concat()).stdout;
    let report = std::fs::read_to_string(folder.path().join("report.json")).unwrap();
    (summary, serde_json::from_str(&report).unwrap())
}

/// What was used where scans did not constrain the motion.
fn substitutes(report: &serde_json::Value) -> Vec<&str> {
    let intervals = report["degenerate_intervals"].as_array().unwrap().iter();
    intervals.map(|i| i["substitute"].as_str().unwrap()).collect()
}

/// How far places may be off, metres.
fn drift(report: &serde_json::Value) -> f64 {
    report["drift"]["sigma_m"].as_f64().unwrap()
}

#[test]
fn along_a_bare_corridor_odometry_or_constant_velocity_is_used_and_its_error_reported() {
    let (recording, truth) = simulated_once(&["corridors", "--seconds", "60", "--seed", "5"]);
    for (more, substitute, measured, sigma) in
        [(&[][..], "odometry", 0.0707, 0.0415), (&["--no-odometry"], "constant_velocity", 0.844, 0.461)]
    {
        let folder = tempfile::tempdir().unwrap();
        let map = ["map", &recording, "-o", &text(folder.path()), "-q", "--no-xray"];
        let summary = portolan_with_code(0, &[&map, more].concat()).stdout;
        assert!(summary.contains("do not constrain motion along the direction of travel"), "{summary}");
        let report = std::fs::read_to_string(folder.path().join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_str(&report).unwrap();
        assert!((2.0..6.0).contains(&seconds(&report, "along_travel")), "{report}");
        assert!(substitutes(&report).iter().all(|taken| *taken == substitute), "{report}");
        let errors = trajectory_errors(&text(&folder.path().join("trajectory.tum")), &truth);
        let largest = errors["absolute"]["translation"]["max"].as_f64().unwrap();
        assert!(largest <= 1.3 * measured, "{largest}");
        assert!((sigma / 1.3..1.3 * sigma).contains(&drift(&report)), "{report}");
    }
}

#[test]
fn a_map_with_unconstrained_relative_poses_is_reported() {
    let (recording, _) = simulated_once(&["corridors", "--seconds", "60", "--seed", "7"]);
    let (_, measured) = map_2d(0, &recording, &[]);
    assert!(drift(&measured) < 0.3, "{measured}");
    // It is 14 m off.
    let (summary, guessed) = map_2d(3, &recording, &["--no-odometry"]);
    assert!(summary.contains("neither scans nor loop closures constrain their relative pose"), "{summary}");
    assert!(drift(&guessed) > 3.0, "{guessed}");
}

#[test]
fn a_room_has_no_degenerate_direction_with_odometry_or_without() {
    let (recording, _) = simulated_once(&["office", "--seconds", "40", "--seed", "5"]);
    for more in [&[][..], &["--no-odometry"]] {
        let (_, report) = map_2d(0, &recording, more);
        assert!(report["degenerate_intervals"].as_array().unwrap().is_empty(), "{report}");
    }
}
