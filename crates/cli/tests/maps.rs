//! Maps as documents: `repair`, `migrate`, `render`, `edit`, `convert`, `optimize`, `compat`.
#![allow(clippy::unwrap_used)]

use crate::common;

use std::path::Path;

use common::{portolan, portolan_with_code, real, text};
use portolan_pbstream::MessageKind;

/// A map of Cartographer in a folder of its own.
fn map(folder: &Path, name: &str) -> Option<String> {
    let path = real(&format!("maps/reference/{name}.pbstream"))?;
    let copy = text(&folder.join(format!("{name}.pbstream")));
    std::fs::copy(path, &copy).unwrap();
    Some(copy)
}

fn json(stdout: &str) -> serde_json::Value {
    serde_json::from_str(stdout).unwrap()
}

#[test]
fn damaged_maps_are_repaired() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "small_2d") else { return };
    let out = text(&folder.path().join("mended.pbstream"));
    let run = portolan_with_code(0, &["repair", &path, "-o", &out]);
    assert!(run.stdout.contains("nothing had to be repaired") && run.stderr.is_empty(), "{}", run.stdout);
    let mut bytes = std::fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 40].fill(0xa5);
    std::fs::write(&path, &bytes).unwrap();
    portolan_with_code(1, &["check", &path]);
    let run = portolan_with_code(3, &["repair", &path, "-o", &out, "--json"]);
    let report = json(&run.stdout);
    assert!(
        report["lost_data"] == true && report["repairs"]["damaged_records"].as_u64() >= Some(1),
        "{report}"
    );
    portolan_with_code(0, &["check", &out]);
    std::fs::write(&path, &bytes[..20]).unwrap();
    let run = portolan_with_code(1, &["repair", &path, "-o", &out]);
    assert!(run.stderr.contains("nothing can be saved"), "{}", run.stderr);
    portolan_with_code(2, &["repair", &path]);
}

/// Copies a map; of its last node seven bytes in the middle are missing.
fn with_a_damaged_node(map: &str, output: &Path) {
    let reader = portolan_pbstream::PbstreamReader::open(map).unwrap();
    let mut messages: Vec<_> = reader.map(Result::unwrap).collect();
    let node = messages.iter().rposition(|message| message.kind() == MessageKind::Node).unwrap();
    let middle = messages[node].bytes.len() / 2;
    messages[node].bytes.drain(middle..middle + 7);
    let mut writer = portolan_pbstream::PbstreamWriter::create(output).unwrap();
    writer.write_header(2).unwrap();
    messages.into_iter().skip(1).for_each(|message| writer.write_bytes(message.bytes).unwrap());
    writer.finish().unwrap();
}

#[test]
fn copied_damage_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "small_2d") else { return };
    let at = |name: &str| text(&folder.path().join(name));
    let (damaged, out) = (at("damaged.pbstream"), at("out.pbstream"));
    with_a_damaged_node(&path, Path::new(&damaged));
    portolan_with_code(0, &["edit", &path, "-o", &out, "--rotate", "1"]);
    let run = portolan_with_code(3, &["edit", &damaged, "-o", &out, "--rotate", "1"]);
    assert!(
        run.stderr.contains("has the same damage as the map it was made from: error: message"),
        "{}",
        run.stderr
    );
    portolan_with_code(1, &["check", &out]);
    portolan_with_code(3, &["repair", &out, "-o", &at("mended.pbstream")]);
    portolan_with_code(0, &["check", &at("mended.pbstream")]);
    portolan_with_code(1, &["migrate", &damaged, &out]);
}

#[test]
fn maps_are_migrated() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "small_3d") else { return };
    let out = text(&folder.path().join("new.pbstream"));
    let run = portolan_with_code(0, &["migrate", &path, &out, "--json"]);
    assert_eq!(json(&run.stdout)["from_version"], 2);
    let run = portolan_with_code(0, &["compat", "cartographer_pbstream", "migrate", &path, &out]);
    assert!(run.stdout.is_empty(), "{}", run.stdout);
    assert!(run.stderr.contains("Migrating serialization format 1 in"), "{}", run.stderr);
    portolan_with_code(1, &["migrate", &text(&folder.path().join("none")), &out]);
}

#[test]
fn pictures_of_maps() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["small_tsdf", "small_3d"] {
        let Some(path) = map(folder.path(), name) else { return };
        let png = text(&folder.path().join("a.png"));
        let run = portolan_with_code(0, &["render", &path, "-o", &png, "--constraints", "--json"]);
        let report = json(&run.stdout);
        assert!(report["width"].as_u64() > Some(100) && report["submaps"].as_u64() >= Some(3), "{report}");
        assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
        let run =
            portolan_with_code(0, &["render", &path, "-o", &png, "--submap", "0,1", "--grey", "--json"]);
        assert_eq!(json(&run.stdout)["submaps"], 1);
        let run = portolan_with_code(1, &["render", &path, "-o", &png, "--submap", "0,99"]);
        assert!(run.stderr.contains("no submap 0,99"), "{}", run.stderr);
        let cropped = ["render", &path, "-o", &png, "--crop=-1,-1,1,1", "--resolution", "0.05", "--json"];
        assert_eq!(json(&portolan_with_code(0, &cropped).stdout)["height"], 40);
        portolan_with_code(2, &["render", &path, "-o", "map.jpg"]);
        let run = portolan_with_code(2, &["render", &path, "-o", &png, "--crop=5000,5000,5010,5010"]);
        assert!(run.stderr.contains("nothing of the map lies in the rectangle"), "{}", run.stderr);
        portolan_with_code(2, &["render", &path, "-o", &png, "--crop", "1,1,1,1"]);
    }
}

#[test]
fn ros_maps_have_the_origin_of_those_of_cartographer_and_sum_the_submaps() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "small_2d") else { return };
    let (ours, theirs) = (folder.path().join("ours.pgm"), folder.path().join("theirs"));
    portolan_with_code(0, &["render", &path, "-o", &text(&ours)]);
    let arguments =
        ["compat", "cartographer_pbstream_to_ros_map", "-pbstream_filename", &path, "-map_filestem"];
    portolan_with_code(0, &[&arguments[..], &[&text(&theirs)]].concat());
    let [summed, painted] = [&ours, &theirs.with_extension("pgm")].map(|path| std::fs::read(path).unwrap());
    assert_eq!(summed.len(), painted.len());
    // Occupied, not known, free.
    let kind = |grey: u8| (u8::from(grey > 89)) + u8::from(grey > 205);
    let differ = summed.iter().zip(&painted).filter(|(a, b)| kind(**a) != kind(**b)).count();
    assert!((1..summed.len() / 50).contains(&differ), "{differ} of {} cells", summed.len());
    let yaml = std::fs::read_to_string(ours.with_extension("yaml")).unwrap();
    assert!(yaml.starts_with("image: ours.pgm\nresolution: 0.05\norigin: [-10.8641, -8, 0.0]\n"), "{yaml}");
    let yaml = std::fs::read_to_string(theirs.with_extension("yaml")).unwrap();
    assert!(yaml.starts_with(&format!("image: {}.pgm\n", theirs.display())), "{yaml}");
}

#[test]
fn maps_are_edited() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "aces") else { return };
    let out = text(&folder.path().join("out.pbstream"));
    let trajectories = |path: &str| {
        let run = portolan_with_code(0, &["info", "--json", path]);
        json(&run.stdout)[0]["trajectories"].as_array().unwrap().clone()
    };
    let merge = ["edit", &path, "-o", &out, "--merge", &path, "--place=40,-3,90", "--rename", "0=4"];
    let run = portolan_with_code(0, &merge);
    assert!(run.stderr.contains("trajectory 0 is 1"), "{}", run.stderr);
    let found = trajectories(&out);
    assert_eq!((found.len(), found[0]["id"].as_i64(), found[1]["id"].as_i64()), (2, Some(1), Some(4)));
    portolan_with_code(
        0,
        &["edit", &out, "-o", &out, "--delete", "1", "--after", "+100", "--before", "+400"],
    );
    let found = trajectories(&out);
    assert_eq!((found.len(), found[0]["id"].as_i64()), (1, Some(4)));
    assert!(found[0]["duration"].as_f64().unwrap() <= 300.0, "{found:?}");
    let more =
        ["--rotate", "walls", "--origin", "1,2", "--move=-1,0", "--drop-loops-beyond", "2", "--optimize"];
    let run =
        portolan_with_code(0, &[&["edit", &path, "-o", &out, "--json", "--worst", "2"][..], &more].concat());
    let report = json(&run.stdout);
    assert!((report["rotated_degrees"].as_f64().unwrap().abs() - 1.6).abs() < 0.6, "{report}");
    assert!(report["optimization"]["largest_move"].as_f64() > Some(0.0), "{report}");
    assert_eq!(report["worst_loops"].as_array().unwrap().len(), 2);
    portolan_with_code(0, &["check", &out]);
    for (wrong, code, reason) in [
        (&["--keep", "7"][..], 1, "there is no trajectory 7"),
        (&["--inside=900,900,901,901"], 1, "nothing would be left of the map after --inside"),
        (&["--before", "+-5"], 1, "left of the map after --before (the map is of 13"),
        (&["--drop-loop", "0,0:0,1"], 1, "no loop closure"),
        (&["--rename", "0=x"], 2, "expected OLD=NEW"),
        (&["--after", "noon"], 2, "Unix seconds"),
        (&["--move", "1,2,3"], 1, "in its plane"),
    ] {
        let run = portolan_with_code(code, &[&["edit", &path, "-o", &out][..], wrong].concat());
        assert!(run.stderr.contains(reason) && run.stdout.is_empty(), "{reason}: {}", run.stderr);
    }
}

#[test]
fn trajectories_and_graphs_are_converted() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "corridor_imu") else { return };
    let file = |name: &str| text(&folder.path().join(name));
    let convert = |from: &str, to: &str, more: &[&str]| {
        portolan_with_code(0, &[&["convert", from, "-o", to, "-q"][..], more].concat())
    };
    let [tum, kitti, csv, geojson, back] = ["a.tum", "a.kitti", "a.csv", "a.geojson", "b.tum"].map(&file);
    convert(&path, &tum, &[]);
    convert(&tum, &kitti, &[]);
    convert(&kitti, &csv, &["--times", &file("a.times.txt")]);
    convert(&csv, &geojson, &["--origin=-33.9,151.2,20"]);
    convert(&geojson, &back, &["--origin=-33.9,151.2,20"]);
    let run = portolan_with_code(0, &["evaluate", "trajectory", &back, &tum, "--align", "none", "--json"]);
    assert!(json(&run.stdout)["absolute"]["translation"]["max"].as_f64().unwrap() < 1e-4, "{}", run.stdout);
    let (g2o, best, new) = (file("a.g2o"), file("b.g2o"), file("new.pbstream"));
    convert(&path, &g2o, &[]);
    let run = portolan_with_code(0, &["optimize", &g2o, "-o", &best, "--json", "--init", "file"]);
    let report = json(&run.stdout);
    assert_eq!(report["vertices"], 737);
    assert!(report["chi2_after"].as_f64() < report["chi2_before"].as_f64(), "{report}");
    convert(&best, &new, &["--into", &path]);
    portolan_with_code(0, &["check", &new]);
    convert(&tum, &new, &["--into", &path]);
    portolan_with_code(0, &["check", &new]);
    portolan_with_code(2, &["convert", &g2o, "-o", &tum]);
    portolan_with_code(2, &["convert", &tum, "-o", &new]);
    portolan_with_code(2, &["convert", &tum, "-o", &file("what")]);
    portolan_with_code(1, &["convert", &path, "-o", &tum, "--trajectory", "3"]);
}

#[test]
fn a_map_without_poses_is_not_converted() {
    use portolan_pbstream::proto::mapping::serialized_data::Data;
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| text(&folder.path().join(name));
    let empty = file("empty.pbstream");
    let mut writer = portolan_pbstream::PbstreamWriter::create(&empty).unwrap();
    writer.write_header(2).unwrap();
    writer.write(Data::PoseGraph(Default::default())).unwrap();
    writer.write(Data::AllTrajectoryBuilderOptions(Default::default())).unwrap();
    writer.finish().unwrap();
    for name in ["a.tum", "a.kitti", "a.csv", "a.geojson", "a.g2o"] {
        let run = portolan_with_code(1, &["convert", &empty, "-o", &file(name)]);
        assert!(run.stderr.contains("there are no poses"), "{name}: {}", run.stderr);
        assert!(!Path::new(&file(name)).exists(), "{name}");
    }
}

#[test]
fn parts_left_out_of_a_conversion_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "small_2d") else { return };
    let file = |name: &str| text(&folder.path().join(name));
    let [tum, g2o] = ["a.tum", "a.g2o"].map(&file);
    portolan_with_code(2, &["convert", &path, "-o", &g2o, "--trajectory", "0"]);
    portolan_with_code(2, &["convert", &path, "-o", &tum, "--into", &path]);
    portolan_with_code(0, &["convert", &path, "-o", &g2o]);
    portolan_with_code(
        2,
        &["convert", &g2o, "-o", &file("b.pbstream"), "--into", &path, "--trajectory", "0"],
    );
}

#[test]
fn graphs_and_maps_are_optimised() {
    let folder = tempfile::tempdir().unwrap();
    let out = text(&folder.path().join("out.g2o"));
    let Some(graph) = real("posegraphs/smallgrid3d.g2o") else { return };
    for init in ["auto", "rotations", "spanning-tree"] {
        let run = portolan_with_code(0, &["optimize", &graph, "-o", &out, "--init", init, "--json"]);
        let chi2 = json(&run.stdout)["chi2_after"].as_f64().unwrap();
        assert!((chi2 / 1035.85 - 1.0).abs() < 1e-4 || init == "spanning-tree", "{init}: {chi2}");
    }
    let run = portolan_with_code(
        0,
        &["optimize", &graph, "-o", &out, "--loss", "huber:2", "--worst", "3", "--condition"],
    );
    assert_eq!(run.stdout.matches(" -> ").count(), 3, "{}", run.stdout);
    assert!(run.stdout.contains("condition "), "{}", run.stdout);
    portolan_with_code(2, &["optimize", &graph, "-o", &out, "--loss", "huber:-1"]);
    let odd = text(&folder.path().join("odd.g2o"));
    let lines = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_SE2 7 5 5 0\nVERTEX_SE2 8 6 5 0\nSTRANGE 1\n\
        EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1\nEDGE_SE2 1 3 1 0 0 1 0 0 1 0 1\nEDGE_SE2 7 8 1 0 0 1 0 0 1 0 1\n";
    std::fs::write(&odd, lines).unwrap();
    let run = portolan_with_code(3, &["optimize", &odd, "-o", &out, "--init", "file"]);
    for part in ["1 line with the unknown tag STRANGE", "1 vertices that only edges name"] {
        assert!(run.stderr.contains(part), "{part}: {}", run.stderr);
    }
    for part in ["2 parts", "1 information matrix was indefinite", "not connected; held in its parts: 0, 7"] {
        assert!(run.stdout.contains(part), "{part}: {}", run.stdout);
    }
    let Some(path) = map(folder.path(), "small_2d") else { return };
    let best = text(&folder.path().join("best.pbstream"));
    let run = portolan_with_code(0, &["optimize", &path, "-o", &best, "--json"]);
    let report = json(&run.stdout);
    assert!(report["final_cost"].as_f64() <= report["initial_cost"].as_f64(), "{report}");
    portolan_with_code(2, &["optimize", &path, "-o", &best, "--loss", "huber:1"]);
    portolan_with_code(2, &["optimize", &path, "-o", &best, "--set", "no_such_option=1"]);
}

#[test]
fn the_reference_program_by_its_names() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "aces") else { return };
    let run = portolan_with_code(0, &["compat", "cartographer_pbstream", "info", &path]);
    assert!(run.stdout.is_empty());
    for line in [
        &format!("] Reading pbstream file from '{path}'...\n"),
        "] Header: format_version: 2\n",
        "] Trajectory id: 0 has #nodes 2786 has #submaps 70\n",
        "] SerializedData package contains #submap_3d: 0\n",
    ] {
        assert!(run.stderr.contains(line), "{line}: {}", run.stderr);
    }
    portolan_with_code(1, &["compat", "cartographer_pbstream"]);
    portolan_with_code(1, &["compat", "cartographer_pbstream", "polish", &path]);
    let relations = text(&folder.path().join("r.pb"));
    let generate = [
        "compat",
        "cartographer_autogenerate_ground_truth",
        &format!("--pose_graph_filename={path}"),
        "-output_filename",
        &relations,
        "-min_covered_distance",
        "20",
    ];
    let run = portolan_with_code(0, &generate);
    assert!(run.stderr.contains("Generated 10 relations and ignored 43 outliers."), "{}", run.stderr);
    let given = real("maps/reference/aces.relations.txt").unwrap();
    let metrics = [
        "compat",
        "cartographer_compute_relations_metrics",
        "-pose_graph_filename",
        &path,
        "-relations_filename",
        &given,
        "-read_text_file_with_unix_timestamps",
        "-write_relation_metrics",
    ];
    let run = portolan_with_code(0, &metrics);
    assert!(
        run.stderr.contains("Result:\nAbs translational error 0.19379 +/- 0.67244 m\n"),
        "{}",
        run.stderr
    );
    assert!(Path::new(&format!("{path}.relation_metrics.csv")).exists());
    let run = portolan_with_code(2, &["compat", "cartographer_compute_relations_metrics"]);
    assert!(run.stderr.contains("usage: "), "{}", run.stderr);
    let run = portolan_with_code(2, &["compat", "cartographer_node"]);
    assert!(run.stderr.contains("portolan map"), "{}", run.stderr);
    assert!(portolan(&["compat", "--list"]).stdout.contains("cartographer_offline_node"));
}

#[cfg(unix)]
#[test]
fn links_run_the_program_of_their_name() {
    let folder = tempfile::tempdir().unwrap();
    let Some(path) = map(folder.path(), "small_2d") else { return };
    let links = text(folder.path());
    portolan_with_code(0, &["compat", "--links", &links]);
    portolan_with_code(0, &["compat", "--links", &links]);
    let output = std::process::Command::new(folder.path().join("cartographer_pbstream"))
        .args(["info", &path])
        .output()
        .unwrap();
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("#nodes 27 has #submaps 3"));
}
