//! What is said: kinds of wrong files, spelling, each error once; damage is never quiet.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{portolan_with_code, simulated, text};

#[test]
fn wrong_files_are_named_by_their_kind() {
    let folder = tempfile::tempdir().unwrap();
    let bag = simulated(folder.path(), "walk.bag", &[]);
    let out = |name: &str| text(&folder.path().join(name));
    let cloud = out("cloud.e57");
    std::fs::write(&cloud, "ASTM-E57 and more").unwrap();
    for (arguments, kind) in [
        (vec!["convert", &bag, "-o", &out("a.tum")], "this is a ROS 1 bag: map it first"),
        (vec!["optimize", &bag, "-o", &out("a.g2o")], "this is a ROS 1 bag: map it first"),
        (vec!["render", &bag, "-o", &out("a.png")], "no map (pbstream) but a ROS 1 bag"),
        (vec!["repair", &cloud, "-o", &out("a.pbstream")], "nothing can be saved"),
        (vec!["map", &cloud, "-o", &out("m")], "it is a point cloud (E57), not a recording"),
        (vec!["register", &bag, &bag], "it is a ROS 1 bag"),
        (vec!["info", "/none"], "No such file"),
    ] {
        let run = portolan_with_code(1, &arguments);
        assert!(run.stderr.contains(kind), "{arguments:?}: {}", run.stderr);
        assert_eq!(run.stderr.matches(kind).count(), 1, "{}", run.stderr);
        assert!(!run.stderr.contains("because"), "{}", run.stderr);
    }
}

#[test]
fn what_was_meant_is_found() {
    let run = portolan_with_code(2, &["config", "show", "--set", "constraint_builder.min_score=2"]);
    assert!(run.stderr.contains("0 to 1"), "{}", run.stderr);
    let run = portolan_with_code(2, &["mpa", "walk.bag"]);
    assert!(run.stderr.contains("'map'") && !run.stderr.contains("'compat'"), "{}", run.stderr);
    let run = portolan_with_code(2, &["simualte"]);
    assert!(run.stderr.contains("'simulate'"), "{}", run.stderr);
    let run = portolan_with_code(0, &["config", "explain", "gravity"]);
    assert!(run.stdout.lines().count() > 4, "{}", run.stdout);
    portolan_with_code(2, &["config", "explain", "nonsenseword"]);
}

#[test]
fn damage_is_never_quiet() {
    let folder = tempfile::tempdir().unwrap();
    let bag = simulated(folder.path(), "walk.bag", &[]);
    let at = |name: &str| text(&folder.path().join(name));
    portolan_with_code(0, &["map", &bag, "-o", &at("m"), "-q"]);
    let map = std::fs::read(at("m/map.pbstream")).unwrap();
    std::fs::write(at("cut.pbstream"), &map[..map.len() - 10]).unwrap();
    let run = portolan_with_code(3, &["convert", &at("cut.pbstream"), "-o", &at("cut.tum")]);
    assert!(run.stderr.contains("damaged behind its poses"), "{}", run.stderr);
    let relations = at("cut.relations");
    let run = portolan_with_code(0, &["evaluate", "generate", &at("cut.pbstream"), "-o", &relations]);
    assert!(run.stderr.contains("damaged behind its poses"), "{}", run.stderr);
    let run = portolan_with_code(0, &["evaluate", "trajectory", &at("cut.pbstream"), &at("cut.tum")]);
    assert!(run.stderr.contains("damaged behind its poses"), "{}", run.stderr);
    let run = portolan_with_code(3, &["info", &at("cut.pbstream")]);
    assert!(run.stdout.contains("1 trajectory") || run.stdout.contains("Trajectory"), "{}", run.stdout);
    assert!(run.stdout.contains("lost: "), "{}", run.stdout);
    portolan_with_code(0, &["convert", &at("m/map.pbstream"), "-o", &at("whole.tum")]);
    assert_eq!(std::fs::read(at("cut.tum")).unwrap(), std::fs::read(at("whole.tum")).unwrap());
    let rows = |count: usize| -> String {
        (0..count).map(|i| format!("{} {} {}\n", i % 40, i / 40, (i * 7) % 3)).collect()
    };
    let header = "ply\nformat ascii 1.0\nelement vertex 800\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    std::fs::write(at("whole.ply"), format!("{header}{}", rows(800))).unwrap();
    std::fs::write(at("cut.ply"), format!("{header}{}", rows(700))).unwrap();
    portolan_with_code(0, &["evaluate", "cloud", &at("whole.ply"), "--reference", &at("whole.ply")]);
    portolan_with_code(3, &["evaluate", "cloud", &at("whole.ply"), "--reference", &at("cut.ply")]);
}
