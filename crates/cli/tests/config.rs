//! `portolan config`.
#![allow(clippy::unwrap_used)]

use crate::common;

use common::{portolan_with_code, real};

#[test]
fn a_typo_names_the_closest_option() {
    let run = portolan_with_code(2, &["config", "explain", "constraint_builder.min_scor"]);
    assert!(run.stderr.contains("did you mean"), "{}", run.stderr);
    assert!(run.stderr.contains("constraint_builder.min_score"), "{}", run.stderr);
    let run = portolan_with_code(2, &["config", "show", "--set", "constraint_builder.min_scor=0.6"]);
    assert!(run.stderr.contains("constraint_builder.min_score"), "{}", run.stderr);
}

#[test]
fn options_are_explained() {
    let run = portolan_with_code(0, &["config", "explain", "constraint_builder.min_score"]);
    assert!(
        run.stdout.starts_with("map_builder.pose_graph.constraint_builder.min_score\n"),
        "{}",
        run.stdout
    );
    assert!(run.stdout.contains("default 0.55"), "{}", run.stdout);
    let run = portolan_with_code(0, &["config", "explain", "--json", "motion_filter"]);
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert!(json.as_array().unwrap().len() >= 2 && json[0]["type"] == "table", "{}", run.stdout);
}

#[test]
fn shown_files_load_again() {
    let folder = tempfile::tempdir().unwrap();
    let run =
        portolan_with_code(0, &["config", "show", "--set", "constraint_builder.min_score=0.6", "--changed"]);
    assert!(run.stdout.contains("constraint_builder.min_score = 0.6\n"), "{}", run.stdout);
    let whole = portolan_with_code(0, &["config", "show", "--3d", "--lua"]).stdout;
    let path = common::text(&folder.path().join("whole.lua"));
    std::fs::write(&path, &whole).unwrap();
    assert_eq!(portolan_with_code(0, &["config", "show", "--config", &path, "--lua"]).stdout, whole);
    let checked = portolan_with_code(0, &["config", "check", &path]);
    assert!(checked.stdout.contains("mapping in 3D, no errors"), "{}", checked.stdout);
    let json = portolan_with_code(0, &["config", "show", "--json"]).stdout;
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["map_builder"]["use_trajectory_builder_2d"], true);
}

#[test]
fn faulty_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = common::text(&folder.path().join("bad.lua"));
    let text = "include \"backpack_2d.lua\"\noptions.trajectory_builder.trajectory_builder_2d.min_rnge = 3\n\
                options.map_builder.num_background_threads = -1\nreturn options\n";
    std::fs::write(&path, text).unwrap();
    let run = portolan_with_code(1, &["config", "check", &path]);
    assert!(run.stdout.contains("min_range"), "{}", run.stdout);
    assert!(run.stderr.contains("in the configuration"), "{}", run.stderr);
    portolan_with_code(1, &["config", "show", "--config", &path]);
    portolan_with_code(1, &["config", "check", "there_is_no_such.lua"]);
}

#[test]
fn files_of_robots_are_accepted() {
    for name in ["jetbot.lua", "haicheng12_revo_lds.lua"] {
        let Some(path) = real(&format!("configs/{name}")) else { return };
        portolan_with_code(0, &["config", "show", "--config", &path]);
    }
}

#[test]
fn the_reference_page_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = common::text(&folder.path().join("options.md"));
    portolan_with_code(0, &["config", "reference", "-o", &path]);
    assert_eq!(
        std::fs::read_to_string(&path).unwrap(),
        portolan_with_code(0, &["config", "reference"]).stdout
    );
}
