//! `portolan evaluate cloud`, `portolan register`, and the page that `portolan refine` writes.
#![allow(clippy::unwrap_used)]

use crate::common;

use std::fmt::Write as _;
use std::path::Path;

use common::{portolan_with_code, real, text};
use portolan_geometry::{Rigid3, Vector3, nalgebra as na};
use portolan_testing::is_fast;
use serde_json::Value;

/// Points of a room with a floor, walls and two columns, seen in two passes, with noise of `noise` metres.
fn room(count: u32, noise: f64) -> Vec<[f64; 4]> {
    let mut state = 9_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1_u32 << 24)
    };
    (0..count)
        .map(|i| {
            let (u, v, h) = (6.0 * random(), 5.0 * random(), 2.5 * random());
            let (turn, off) = (random() * std::f64::consts::TAU, noise * (random() - 0.5));
            let seconds = if random() > 0.5 { 60.0 } else { 0.0 };
            let [x, y, z] = match i % 6 {
                0 => [u, v, off],
                1 => [u, off, h],
                2 => [u, 5.0 + off, h],
                3 => [off, v, h],
                4 => [2.0 + (0.3 + off) * turn.cos(), 1.5 + (0.3 + off) * turn.sin(), h],
                _ => [4.2 + (0.2 + off) * turn.cos(), 3.1 + (0.2 + off) * turn.sin(), h],
            };
            [x, y, z, seconds]
        })
        .collect()
}

fn write_cloud(path: &Path, points: &[[f64; 4]], scan_from_world: &Rigid3) -> String {
    let mut lines = "x y z time\n".to_owned();
    for [x, y, z, seconds] in points {
        let p = scan_from_world * na::Point3::new(*x, *y, *z);
        writeln!(lines, "{} {} {} {seconds}", p.x, p.y, p.z).unwrap();
    }
    std::fs::write(path, lines).unwrap();
    text(path)
}

fn json(output: &str) -> Value {
    serde_json::from_str(output).unwrap()
}

#[test]
fn the_sharper_of_two_clouds_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let here = Rigid3::identity();
    let sharp = write_cloud(&file("sharp.xyz"), &room(40_000, 0.01), &here);
    let blurred = write_cloud(&file("blurred.xyz"), &room(40_000, 0.10), &here);
    let run = portolan_with_code(0, &["evaluate", "cloud", &blurred, &sharp, "--json"]);
    let report = json(&run.stdout);
    let clouds = report["clouds"].as_array().unwrap();
    for figure in [
        "/sharpness/mean_map_entropy",
        "/orthogonality/mean_plane_variance",
        "/walls/median",
        "/passes/median_across",
    ] {
        let [before, after] =
            [0, 1].map(|i: usize| clouds[i].pointer(figure).and_then(Value::as_f64).unwrap());
        assert!(after < before, "{figure}: {before} {after}");
    }
    assert_eq!(report["options"]["sharpness"]["radius"], 0.15);
    let changes = report["comparisons"][0]["changes"].as_array().unwrap();
    assert!(
        changes.len() == 3 && changes.iter().all(|c| c["probability_of_chance"].as_f64().unwrap() < 0.01)
    );
    let run = portolan_with_code(0, &["evaluate", "cloud", &sharp, &sharp, "--radius", "0.2"]);
    assert!(
        run.stdout.contains("within 0.2 m") && run.stdout.contains("no difference beyond chance"),
        "{}",
        run.stdout
    );
}

#[test]
fn distances_to_true_surfaces_of_every_kind() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    // Only floor and walls, which boxes and triangles can have, 4 cm too high.
    let flat: Vec<[f64; 4]> =
        room(30_000, 0.0).into_iter().enumerate().filter(|(i, _)| i % 6 < 4).map(|(_, p)| p).collect();
    let cloud = write_cloud(&file("cloud.xyz"), &flat, &Rigid3::translation(0.0, 0.0, 0.04));
    let truth = write_cloud(&file("truth.xyz"), &room(60_000, 0.0), &Rigid3::identity());
    std::fs::write(file("boxes.csv"), "0,0,-1,6,5,0\n0,-1,-1,6,0,4\n0,5,-1,6,6,4\n-1,-1,-1,0,6,4\n").unwrap();
    let quad = |corners: [[f64; 3]; 4]| corners;
    let mesh = [
        quad([[-1.0, -1.0, 0.0], [7.0, -1.0, 0.0], [7.0, 6.0, 0.0], [-1.0, 6.0, 0.0]]),
        quad([[-1.0, 0.0, -1.0], [7.0, 0.0, -1.0], [7.0, 0.0, 4.0], [-1.0, 0.0, 4.0]]),
        quad([[-1.0, 5.0, -1.0], [7.0, 5.0, -1.0], [7.0, 5.0, 4.0], [-1.0, 5.0, 4.0]]),
        quad([[0.0, -1.0, -1.0], [0.0, 6.0, -1.0], [0.0, 6.0, 4.0], [0.0, -1.0, 4.0]]),
    ];
    let mut obj = String::new();
    mesh.iter().flatten().for_each(|[x, y, z]| writeln!(obj, "v {x} {y} {z}").unwrap());
    (0..4).for_each(|i| writeln!(obj, "f {} {} {} {}", 4 * i + 1, 4 * i + 2, 4 * i + 3, 4 * i + 4).unwrap());
    std::fs::write(file("mesh.obj"), obj).unwrap();
    let errors = |more: &[&str]| {
        let mut arguments = vec!["evaluate", "cloud", &cloud, "--json"];
        arguments.extend(more);
        json(&portolan_with_code(0, &arguments).stdout)["clouds"][0]["surfaces"].clone()
    };
    let (boxes, obj) = (text(&file("boxes.csv")), text(&file("mesh.obj")));
    // A quarter of the points are on the floor and 4 cm off; walls do not notice.
    for truth in [["--surfaces", &boxes], ["--surfaces", &obj], ["--reference", &truth]] {
        let found = errors(&truth);
        let (mean, p95) = (found["mean"].as_f64().unwrap(), found["percentile_95"].as_f64().unwrap());
        assert!((mean - 0.01).abs() < 0.003 && (p95 - 0.04).abs() < 0.003, "{truth:?}: {found}");
        let near = errors(&[truth[0], truth[1], "--beyond", "0.03"]);
        assert!(near["beyond"].as_u64().unwrap() > 4000 && near["mean"].as_f64().unwrap() < 0.003, "{near}");
        let fitted = errors(&[truth[0], truth[1], "--fit"]);
        assert!(fitted["mean"].as_f64().unwrap() < 0.5 * mean, "{truth:?}: {fitted}");
    }
}

#[test]
fn clouds_that_cannot_be_judged_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, content: &str| {
        std::fs::write(folder.path().join(name), content).unwrap();
        text(&folder.path().join(name))
    };
    let empty = file("empty.xyz", "x y z\n");
    assert!(portolan_with_code(1, &["evaluate", "cloud", &empty]).stderr.contains("no points"));
    let one = file("one.xyz", "1 2 3\n");
    assert!(portolan_with_code(0, &["evaluate", "cloud", &one]).stdout.contains("Too few points"));
    let nan = file("nan.xyz", "nan nan nan\n1 2 3\ninf 0 0\n");
    let run = portolan_with_code(0, &["evaluate", "cloud", &nan]);
    assert!(
        run.stderr.contains("not numbers") && run.stdout.contains("1 of 1 points"),
        "{} {}",
        run.stderr,
        run.stdout
    );
    portolan_with_code(2, &["evaluate", "cloud", &one, "--radius", "0"]);
    portolan_with_code(2, &["evaluate", "cloud", &one, "--fit"]);
    let boxes = file("boxes.csv", "0,0,0,1,1,1\n");
    portolan_with_code(2, &["evaluate", "cloud", &one, "--surfaces", &boxes, "--truth", &boxes]);
    let log = common::simulated(folder.path(), "a.bag", &[]);
    assert!(portolan_with_code(2, &["evaluate", "cloud", &log]).stderr.contains("name the trajectory"));
}

/// Two scans of the room from different places; the pose of the second in the first.
fn two_scans(folder: &Path) -> ([String; 2], Rigid3) {
    let pose = Rigid3::new(Vector3::new(0.05, -0.04, 0.03), Vector3::new(0.01, -0.02, 0.03));
    let (first, second) = (room(9000, 0.0), room(12_000, 0.0).split_off(3000));
    let a = write_cloud(&folder.join("a.xyz"), &first, &Rigid3::identity());
    let b = write_cloud(&folder.join("b.xyz"), &second, &pose.inverse());
    ([a, b], pose)
}

fn pose_of(scan: &Value) -> Vec<f64> {
    scan["pose"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

fn assert_pose(scan: &Value, expected: &Rigid3, tolerance: f64, name: &str) {
    let found = pose_of(scan);
    let t = expected.translation;
    let q = expected.rotation.quaternion();
    for (a, b) in found.iter().zip([t.x, t.y, t.z, q.i, q.j, q.k, q.w]) {
        assert!((a - b).abs() < tolerance, "{name}: {found:?}");
    }
}

#[test]
fn every_method_registers_two_scans() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let ([a, b], pose) = two_scans(folder.path());
    let methods = [
        "quaternion",
        "svd",
        "orthonormal",
        "dual-quaternion",
        "helix",
        "small-angle",
        "point-to-plane",
        "generalized",
    ];
    for method in methods {
        let arguments = [
            "register",
            &a,
            &b,
            "--method",
            method,
            "--max-distance",
            "0.3",
            "--iterations",
            "200",
            "--json",
        ];
        let report = json(&portolan_with_code(0, &arguments).stdout);
        assert_pose(&report["scans"][1], &pose, 4e-3, method);
        assert!(report["scans"][1]["covariance"].is_array(), "{method}");
    }
    let pairs = |more: &[&str]| {
        let mut arguments =
            vec!["register", &a, &b, "--max-distance", "0.3", "--iterations", "200", "--json"];
        arguments.extend(more);
        let report = json(&portolan_with_code(0, &arguments).stdout);
        assert_pose(&report["scans"][1], &pose, 8e-3, &format!("{more:?}"));
        report["scans"][1]["pairs"].as_u64().unwrap()
    };
    let all = pairs(&[]);
    for more in [
        &["--reciprocal"][..],
        &["--keep", "0.8"],
        &["--every", "3"],
        &["--reduce", "0.1"],
        &["--normals-within", "20"],
    ] {
        assert!(pairs(more) < all, "{more:?}");
    }
    for kernel in ["huber", "cauchy", "geman-mcclure"] {
        pairs(&["--robust", "0.05", "--kernel", kernel]);
    }
}

#[test]
fn a_folder_of_scans_becomes_a_map() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let scans = folder.path().join("scans");
    std::fs::create_dir(&scans).unwrap();
    let truth: Vec<Rigid3> = (0..4)
        .map(f64::from)
        .map(|i| Rigid3::new(Vector3::new(0.3 * i, 0.2 * i, 0.0), Vector3::z() * (0.1 * i)))
        .collect();
    for (i, pose) in truth.iter().enumerate() {
        let mut lines = String::new();
        for [x, y, z, _] in room(8000 + 500 * i as u32, 0.0) {
            let p = pose.inverse() * na::Point3::new(x, y, z);
            // Centimetres, x to the right, y up, z ahead.
            writeln!(lines, "{} {} {}", -100.0 * p.y, 100.0 * p.z, 100.0 * p.x).unwrap();
        }
        std::fs::write(scans.join(format!("scan{i:03}.3d")), lines).unwrap();
        let guess =
            pose * Rigid3::new(Vector3::new(0.05, 0.0, 0.02) * f64::from(u8::from(i > 0)), Vector3::zeros());
        std::fs::write(scans.join(format!("scan{i:03}.pose")), portolan_pointcloud::uos_pose_text(&guess))
            .unwrap();
    }
    let out = folder.path().join("out");
    let (scans, out_name) = (text(&scans), text(&out));
    let base = ["register", &scans, "--max-distance", "0.3", "--global", "--json"];
    for method in ["se3", "euler", "quaternion", "helix", "small-angle"] {
        let arguments: Vec<&str> =
            base.iter().copied().chain(["--global-method", method, "--metascan"]).collect();
        let report = json(&portolan_with_code(0, &arguments).stdout);
        for (scan, pose) in report["scans"].as_array().unwrap().iter().zip(&truth) {
            assert_pose(scan, pose, 0.01, method);
        }
        assert_eq!(report["global"]["links"], 6, "{method}");
    }
    let links = folder.path().join("links.net");
    std::fs::write(&links, "4\n3\n0 1\n1 2\n2 3\n").unwrap();
    let arguments: Vec<&str> = base
        .iter()
        .copied()
        .chain(["--links-file", links.to_str().unwrap(), "-o", &out_name, "--threads", "1"])
        .collect();
    let first = portolan_with_code(0, &arguments).stdout;
    assert_eq!(json(&first)["global"]["links"], 3);
    let names = [
        "poses.tum",
        "scan003.pose",
        "scan003.frames",
        "registered.ply",
        "before.png",
        "after.png",
        "report.json",
    ];
    let bytes: Vec<Vec<u8>> = names.iter().map(|name| std::fs::read(out.join(name)).unwrap()).collect();
    assert_eq!(String::from_utf8_lossy(&bytes[2]).lines().count(), 3);
    // The same once more, and for other numbers of threads.
    for threads in ["1", "2", "4"] {
        let mut arguments = arguments.clone();
        *arguments.last_mut().unwrap() = threads;
        assert_eq!(portolan_with_code(0, &arguments).stdout, first);
        assert!(
            names.iter().zip(&bytes).all(|(name, bytes)| *bytes == std::fs::read(out.join(name)).unwrap())
        );
    }
    // What was written can be begun with.
    let poses = text(&out.join("poses.tum"));
    let arguments =
        ["register", &scans, "--poses", &poses, "--trust-poses", "--max-distance", "0.3", "--json"];
    let again = json(&portolan_with_code(0, &arguments).stdout);
    assert_pose(&again["scans"][3], &truth[3], 0.01, "again");
    // Poses of a national grid are as good.
    let far = Rigid3::translation(4_468_000.0, 5_333_000.0, 520.0);
    let moved: String = std::fs::read_to_string(&poses)
        .unwrap()
        .lines()
        .map(|line| {
            let v: Vec<&str> = line.split(' ').collect();
            let place: Vec<f64> =
                (0..3).map(|k| v[1 + k].parse::<f64>().unwrap() + far.translation.vector[k]).collect();
            format!("{} {} {} {} {}\n", v[0], place[0], place[1], place[2], v[4..].join(" "))
        })
        .collect();
    std::fs::write(out.join("far.tum"), moved).unwrap();
    let poses = text(&out.join("far.tum"));
    let arguments =
        ["register", &scans, "--poses", &poses, "--metascan", "--global", "--max-distance", "0.3", "--json"];
    let again = json(&portolan_with_code(0, &arguments).stdout);
    assert_pose(&again["scans"][3], &(far * truth[3]), 0.01, "far");
}

#[test]
fn scans_that_cannot_be_registered_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let ([a, b], _) = two_scans(folder.path());
    let file = |name: &str, content: &str| {
        std::fs::write(folder.path().join(name), content).unwrap();
        text(&folder.path().join(name))
    };
    let run = portolan_with_code(4, &["register", &a, &b, "--guess", "90,0,0,0,0,0"]);
    assert!(run.stderr.contains("b.xyz: only 0 of") && run.stderr.contains("m apart"), "{}", run.stderr);
    let empty = file("empty.xyz", "x y z\n");
    assert!(portolan_with_code(1, &["register", &a, &empty]).stderr.contains("no points"));
    let one = file("one.xyz", "1 2 3\n");
    assert!(portolan_with_code(1, &["register", &a, &one]).stderr.contains("1 point of 1"));
    let same = file("same.xyz", &"1 2 3\n".repeat(50));
    assert!(portolan_with_code(1, &["register", &a, &same]).stderr.contains("the same position"));
    let line: String = (0..60).map(|i| format!("{} 0.5 0.5\n", 0.05 * f64::from(i))).collect();
    let line = file("line.xyz", &line);
    portolan_with_code(4, &["register", &a, &line, "--method", "small-angle", "--max-distance", "0.0001"]);
    let millimetres: String =
        std::fs::read_to_string(&b).unwrap().lines().skip(1).fold(String::new(), |mut all, line| {
            let v: Vec<f64> = line.split(' ').map(|w| w.parse().unwrap()).collect();
            writeln!(all, "{} {} {}", 1000.0 * v[0], 1000.0 * v[1], 1000.0 * v[2]).unwrap();
            all
        });
    let millimetres = file("mm.xyz", &millimetres);
    let run = portolan_with_code(4, &["register", &a, &millimetres]);
    assert!(run.stderr.contains("of one unit?") && run.stderr.contains("--scale"), "{}", run.stderr);
    // One scan of elsewhere among others is a loss, and is reported.
    let elsewhere =
        write_cloud(&folder.path().join("far.xyz"), &room(500, 0.0), &Rigid3::translation(300.0, 0.0, 0.0));
    let run = portolan_with_code(3, &["register", &a, &elsewhere, &b, "--metascan", "--max-distance", "0.3"]);
    assert!(run.stderr.contains("far.xyz") && run.stdout.contains("not matched"), "{}", run.stdout);
    portolan_with_code(2, &["register", &a, &b, "--keep", "1.5"]);
    portolan_with_code(2, &["register", &a]);
}

#[test]
fn options_of_the_other_method_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = text(folder.path());
    let refused = |options: &[&str], expected: &str| {
        let base = ["refine", "--recording", "a.bag", "--trajectory", "a.tum", "-o", &out];
        let arguments: Vec<&str> = base.iter().chain(options).copied().collect();
        let run = portolan_with_code(2, &arguments);
        assert!(run.stderr.contains(expected), "{}", run.stderr);
    };
    refused(&["--coarse"], "--coarse is for --method semi-rigid only");
    refused(&["--time-window", "90"], "--time-window is for --method semi-rigid only");
    refused(&["--method", "semi-rigid", "--calibrate"], "--calibrate is for --method continuous only");
    refused(&["--trajectory-id", "1"], "--trajectory-id is for --map only");
}

#[test]
fn a_refinement_is_reported_on_one_page() {
    if is_fast() {
        return;
    }
    let Some(bag) = real("lidar3d/walk.bag") else { return };
    let input = std::fs::read_to_string(real("lidar3d/walk.input.tum").unwrap()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| text(&folder.path().join(name));
    // Eight seconds are enough for every part of the page.
    let short: String = input.lines().take(1600).map(|line| format!("{line}\n")).collect();
    std::fs::write(file("short.tum"), short).unwrap();
    let run = |out: &str, threads: &str| {
        let (out, short) = (file(out), file("short.tum"));
        let arguments = [
            "refine",
            "--recording",
            &bag,
            "--trajectory",
            &short,
            "-o",
            &out,
            "--cloud",
            "short.las,xyz",
            "--threads",
            threads,
        ];
        portolan_with_code(0, &arguments);
        let is_there = |name: &str| Path::new(&out).join(name).is_file();
        assert!(is_there("short.las") && is_there("refined.xyz") && !is_there("refined.ply"));
        std::fs::read_to_string(Path::new(&out).join("report.html")).unwrap()
    };
    let page = run("out", "1");
    assert!(page.len() < 5_000_000 && page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n"));
    // Nothing from outside, and every element is closed.
    let links: Vec<&str> = page.split("href=\"").skip(1).collect();
    assert!(
        links.iter().all(|link| link.starts_with("data:"))
            && !page.contains("src=")
            && !page.contains("<script")
    );
    for element in ["svg", "figure", "table", "div", "p", "h2", "td"] {
        let (opened, closed) =
            (page.matches(&format!("<{element}")).count(), page.matches(&format!("</{element}>")).count());
        // `<p` also begins `<path` and `<polyline`, which close themselves.
        assert!(
            opened >= closed && closed > 0 && (element == "p" || opened == closed),
            "{element}: {opened} {closed}"
        );
    }
    for part in [
        "Where walls changed most",
        "From above",
        "Upright cut",
        "Change of position",
        "Thickness of walls",
        "Fingerprint",
        "map entropy",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert_eq!(page.matches("data:image/png;base64,").count() % 2, 0);
    // Only the folder's name differs.
    assert_eq!(page, run("two", "2").replace(&file("two"), &file("out")));
}
