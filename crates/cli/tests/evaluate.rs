//! `portolan evaluate`.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{portolan, portolan_with_code, real, simulated};

const ACES: &str = "Result:\n\
    Abs translational error 0.19379 +/- 0.67244 m\n\
    Sqr translational error 0.48938 +/- 2.55957 m^2\n\
    Abs rotational error 0.64133 +/- 1.01573 deg\n\
    Sqr rotational error 1.44220 +/- 6.91273 deg^2\n";

#[test]
fn relations_give_the_figures_of_the_reference() {
    let Some(map) = real("maps/reference/aces.pbstream") else { return };
    let relations = real("maps/reference/aces.relations.txt").unwrap();
    let run = portolan_with_code(0, &["evaluate", "relations", &map, &relations]);
    assert_eq!(run.stdout, ACES);
    assert!(run.stderr.contains("% within 0.2 m, median"), "{}", run.stderr);
    // Times of the CARMEN log are brought to those of the recording.
    let carmen = real("lidar2d/aces/aces.relations").unwrap();
    let run = portolan_with_code(0, &["evaluate", "relations", &map, &carmen]);
    assert!(run.stdout.starts_with("Result:\nAbs translational error 0.19"), "{}", run.stdout);
    assert!(run.stderr.contains("shifted by +1000000000 s"), "{}", run.stderr);
    assert!(portolan(&["evaluate", "relations", "--quiet", &map, &carmen]).stderr.is_empty());
    let run = portolan_with_code(0, &["evaluate", "relations", "--json", &map, &relations]);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert!((json["absolute_translation"]["mean"].as_f64().unwrap() - 0.19379).abs() < 1e-5, "{json}");
}

fn assert_same_relations(a: &str, b: &str) {
    let read = |path| portolan_evaluation::read_relations(&std::fs::read(path).unwrap()).unwrap();
    let (a, b) = (read(a), read(b));
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(&b) {
        assert_eq!((a.time1, a.time2), (b.time1, b.time2));
        let difference = a.expected_1_from_2.to_homogeneous() - b.expected_1_from_2.to_homogeneous();
        assert!(difference.amax() < 1e-9 && (a.covered_distance - b.covered_distance).abs() < 1e-9);
    }
}

#[test]
fn generated_relations_are_those_of_the_reference() {
    let folder = tempfile::tempdir().unwrap();
    let expected = [
        (
            "aces",
            "Generated 28 relations and ignored 88 outliers.\n",
            "Abs translational error 0.06951 +/- 0.03896 m",
        ),
        (
            "corridor_imu",
            "Generated 24 relations and ignored 0 outliers.\n",
            "Abs translational error 0.00195 +/- 0.00124 m",
        ),
    ];
    for (name, summary, figures) in expected {
        let Some(map) = real(&format!("maps/reference/{name}.pbstream")) else { return };
        let output = common::text(&folder.path().join(name));
        let run = portolan_with_code(
            0,
            &["evaluate", "generate", &map, "-o", &output, "--min-covered-distance", "5"],
        );
        assert_eq!(run.stdout, summary);
        let reference = real(&format!("maps/reference/{name}.generated_5m.pb")).unwrap();
        assert_same_relations(&output, &reference);
        let csv = common::text(&folder.path().join("errors.csv"));
        let run = portolan_with_code(0, &["evaluate", "relations", &map, &output, "--csv", &csv]);
        assert!(run.stdout.contains(figures), "{}", run.stdout);
        let rows = std::fs::read_to_string(&csv).unwrap();
        assert!(rows.starts_with("translational_error,squared_translational_error,"), "{rows}");
        let run = portolan_with_code(1, &["evaluate", "relations", &map, &map]);
        assert!(run.stderr.contains("this is a map (pbstream), and no relations"), "{}", run.stderr);
    }
}

#[test]
fn a_trajectory_is_compared_with_the_truth() {
    let Some(map) = real("maps/reference/corridor_imu.pbstream") else { return };
    let truth = real("lidar3d/corridor_imu.truth.tum").unwrap();
    let run = portolan_with_code(0, &["evaluate", "trajectory", &map, &truth, "--rpe-distance", "5"]);
    assert!(run.stdout.contains("(aligned in 3D)") && run.stdout.contains("over 5 m"), "{}", run.stdout);
    let run = portolan_with_code(0, &["evaluate", "trajectory", &truth, &truth, "--align", "none", "--json"]);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert!(json["absolute"]["translation"]["max"].as_f64().unwrap() < 1e-9, "{json}");
    assert_eq!(json["relative"][0]["step"]["Time"], 1.0);
}

#[test]
fn kitti_poses_and_simulated_truth() {
    let folder = tempfile::tempdir().unwrap();
    let truth = simulated(folder.path(), "a.bag", &[]).replace("a.bag", "a.truth.tum");
    let run = portolan_with_code(0, &["evaluate", "trajectory", &truth, &truth]);
    assert!(run.stdout.contains("(aligned in 2D)"), "{}", run.stdout);
    let kitti = common::text(&folder.path().join("00.txt"));
    let poses: String = (0..50).map(|i| format!("1 0 0 {i} 0 1 0 0 0 0 1 0\n")).collect();
    std::fs::write(&kitti, poses).unwrap();
    let run = portolan_with_code(0, &["evaluate", "trajectory", &kitti, &kitti, "--nearest", "0.01"]);
    assert!(run.stdout.contains("50 poses over 49.0 m") && run.stderr.contains("--times"), "{}", run.stdout);
}

#[test]
fn wrong_input_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let bad = common::text(&folder.path().join("bad.tum"));
    std::fs::write(&bad, "1 2 3\n").unwrap();
    let run = portolan_with_code(1, &["evaluate", "trajectory", &bad, &bad]);
    assert!(run.stderr.contains("bad.tum: line 1"), "{}", run.stderr);
    portolan_with_code(2, &["evaluate", "trajectory", &bad]);
    portolan_with_code(2, &["evaluate", "trajectory", &bad, &bad, "--align", "sim3"]);
}
