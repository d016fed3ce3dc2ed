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
        (vec!["map", &cloud, "-o", &out("m")], "it is a point cloud (E57)"),
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
fn wrong_text_is_named_by_its_kind_too() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| text(&folder.path().join(name));
    let out = |name: &str| at(name);
    for (content, kind) in [
        ("", "an empty file"),
        ("<?xml version=\"1.0\"?><robot name=\"a\"/>", "a robot description (URDF) is given with --urdf"),
        ("-- Copyright\nreturn {}\n", "a configuration is given with --config"),
        ("{\"a\": 1}\n", "JSON"),
        ("image: map.pgm\nresolution: 0.05\n", "the description of an image map (YAML)"),
        (std::str::from_utf8(&[0; 4096]).unwrap(), "a file that begins with zeros"),
    ] {
        std::fs::write(at("wrong"), content).unwrap();
        for verb in [
            vec!["map", &at("wrong"), "-o", &out("m")],
            vec!["info", &at("wrong")],
            vec!["render", &at("wrong"), "-o", &out("a.png")],
            vec!["edit", &at("wrong"), "-o", &out("a.pbstream"), "--move", "1,2"],
            vec!["evaluate", "trajectory", &at("wrong"), &at("wrong")],
            vec!["register", &at("wrong"), &at("wrong")],
            vec!["optimize", &at("wrong"), "-o", &out("a.g2o")],
        ] {
            let run = portolan_with_code(1, &verb);
            assert!(run.stderr.contains(kind), "{verb:?}: {}", run.stderr);
            assert_eq!(
                (run.stderr.lines().count(), run.stderr.matches("wrong").count()),
                (1, 1),
                "{}",
                run.stderr
            );
        }
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left");
}

#[test]
fn number_files_are_named_by_their_kind() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| text(&folder.path().join(name));
    let relations = "1.0 2.0 0.5 0.1 0.0 0.0 0.0 1.2\n";
    for (content, kind) in [
        ("1305031102.1 0 0 0 0 0 0 1\n", "a text of poses"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "a text of poses"),
        ("0.5 1.5 2.5\n0.6 1.6 2.6\n", "a text of points"),
    ] {
        std::fs::write(at("numbers"), content).unwrap();
        for verb in [vec!["map", &at("numbers"), "-o", &at("m")], vec!["check", &at("numbers")]] {
            let run = portolan_with_code(1, &verb);
            assert!(run.stderr.contains(kind), "{verb:?}: {}", run.stderr);
        }
    }
    std::fs::write(at("numbers"), relations).unwrap();
    let run = portolan_with_code(1, &["evaluate", "trajectory", &at("numbers"), &at("numbers")]);
    assert!(run.stderr.contains("are these relations"), "{}", run.stderr);
}

#[test]
fn unusable_scans_are_reported_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, out) = (simulated(folder.path(), "walk.bag", &[]), text(&folder.path().join("m")));
    let blind = ["map", &bag, "-o", &out, "--set", "trajectory_builder_2d.min_range=11"];
    let run =
        portolan_with_code(1, &[&blind[..], &["--set", "trajectory_builder_2d.max_range=11.001"]].concat());
    assert!(run.stderr.contains("half of their returns are farther than"), "{}", run.stderr);
}

#[test]
fn quotes_of_files_are_short_and_control_no_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let path = text(&folder.path().join("a.tum"));
    std::fs::write(&path, format!("\u{1b}[2J{} 1 2\n", "x".repeat(1000))).unwrap();
    let run = portolan_with_code(1, &["evaluate", "trajectory", &path, &path]);
    assert!(run.stderr.contains("is not a time in seconds"), "{}", run.stderr);
    assert!(run.stderr.len() < 300 && !run.stderr.contains('\u{1b}'), "{:?}", run.stderr);
}

#[test]
fn files_that_cannot_be_written_are_named_once() {
    use portolan_pbstream::proto::mapping::serialized_data::Data;
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| text(&folder.path().join(name));
    let (map, nowhere) = (at("map.pbstream"), at("none/out.pbstream"));
    let mut writer = portolan_pbstream::PbstreamWriter::create(&map).unwrap();
    writer.write_header(2).unwrap();
    let trajectory = Default::default();
    let graph =
        portolan_pbstream::proto::mapping::PoseGraph { trajectory: vec![trajectory], ..Default::default() };
    writer.write(Data::PoseGraph(graph)).unwrap();
    let options = portolan_pbstream::proto::mapping::AllTrajectoryBuilderOptions {
        options_with_sensor_ids: vec![Default::default()],
        ..Default::default()
    };
    writer.write(Data::AllTrajectoryBuilderOptions(options)).unwrap();
    writer.finish().unwrap();
    for verb in [vec!["edit", &map, "-o", &nowhere, "--rename", "0=1"], vec!["migrate", &map, &nowhere]] {
        let run = portolan_with_code(1, &verb);
        assert_eq!(run.stderr.matches("out.pbstream").count(), 1, "{}", run.stderr);
        assert!(!run.stderr.contains("map.pbstream"), "{}", run.stderr);
    }
    let run = portolan_with_code(1, &["edit", &at("none.pbstream"), "-o", &map]);
    assert_eq!(run.stderr.matches("none.pbstream").count(), 1, "{}", run.stderr);
}

#[test]
fn negative_numbers_are_refused_by_options_that_take_none() {
    for (arguments, reason) in [
        (vec!["map", "a.bag", "--range-noise", "-1"], "expected auto or metres"),
        (vec!["render", "a.pbstream", "-o", "a.png", "--resolution", "-1"], "expected metres, more than 0"),
        (vec!["render", "a.pbstream", "-o", "a.png", "--resolution", "0"], "expected metres, more than 0"),
        (vec!["edit", "a.pbstream", "-o", "b.pbstream", "--drop-loops-beyond", "-1"], "more than 0"),
        (vec!["optimize", "a.g2o", "-o", "b.g2o", "--iterations", "-1"], "-1 is not in 0"),
        (vec!["simulate", "office", "--seconds", "-3", "-o", "/none/a.bag"], "duration must be from 0.1"),
        (vec!["evaluate", "trajectory", "a.tum", "b.tum", "--rpe", "-1"], "expected seconds, more than 0"),
        (
            vec!["evaluate", "generate", "a.pbstream", "-o", "b", "--min-covered-distance", "nan"],
            "expected a number, 0 or more",
        ),
    ] {
        let run = portolan_with_code(2, &arguments);
        assert!(
            run.stderr.contains(reason) && !run.stderr.contains("'-- -"),
            "{arguments:?}: {}",
            run.stderr
        );
    }
    // A name that begins like a number is none.
    let run = portolan_with_code(2, &["map", "-1"]);
    assert!(run.stderr.contains("'-1'"), "{}", run.stderr);
}

#[test]
fn misspelt_words_get_a_suggestion() {
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
fn damage_is_always_reported() {
    let folder = tempfile::tempdir().unwrap();
    let bag = simulated(folder.path(), "walk.bag", &[]);
    let at = |name: &str| text(&folder.path().join(name));
    portolan_with_code(0, &["map", &bag, "-o", &at("m"), "-q"]);
    let map = std::fs::read(at("m/map.pbstream")).unwrap();
    std::fs::write(at("cut.pbstream"), &map[..map.len() - 10]).unwrap();
    let run = portolan_with_code(3, &["convert", &at("cut.pbstream"), "-o", &at("cut.tum")]);
    assert!(run.stderr.contains("damaged after its poses"), "{}", run.stderr);
    let relations = at("cut.relations");
    let run = portolan_with_code(0, &["evaluate", "generate", &at("cut.pbstream"), "-o", &relations]);
    assert!(run.stderr.contains("damaged after its poses"), "{}", run.stderr);
    let run = portolan_with_code(0, &["evaluate", "trajectory", &at("cut.pbstream"), &at("cut.tum")]);
    assert!(run.stderr.contains("damaged after its poses"), "{}", run.stderr);
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
