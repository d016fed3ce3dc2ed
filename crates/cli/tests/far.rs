//! Maps, trajectories and clouds far from the origin, as in UTM: everything gives what it gives near it.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use std::path::{Path, PathBuf};

use common::{PORTOLAN, portolan, portolan_with_code, simulated_once, text};

/// Where maps are moved to, metres: whole cells of grids, so that what is drawn in them is the same.
const FAR: [f64; 3] = [499_712.0, 5_400_576.0, 0.0];
/// Heights of 3D maps are moved, too, metres.
const HIGHER: f64 = 256.0;
/// As far as results differ, metres: single precision has steps of 0.06 mm a kilometre from the origin.
const SAME: f64 = 1e-3;

/// A recording, and its map where it was made and in UTM. Made once for all tests.
struct Place {
    folder: tempfile::TempDir,
    recording: String,
    near: String,
    far: String,
    shift: [f64; 3],
}

impl Place {
    fn new(recording: String, shift: [f64; 3], more: &[&str]) -> Self {
        let by = shift.map(|v| v.to_string()).join(",");
        let by = by.trim_end_matches(",0").to_owned();
        let made = PORTOLAN.made_once(&[&["far", &recording, &by], more].concat(), |folder| {
            portolan_with_code(0, &[&["map", &recording, "-o", &text(folder), "-q"], more].concat());
            let [near, far] = ["map.pbstream", "far.pbstream"].map(|name| text(&folder.join(name)));
            portolan_with_code(0, &["edit", &near, "-o", &far, "--move", &by, "--json"]);
        });
        let [near, far] = ["map.pbstream", "far.pbstream"].map(|name| text(&made.join(name)));
        Self { folder: tempfile::tempdir().unwrap(), recording, near, far, shift }
    }

    /// An office in 2D.
    fn office() -> Self {
        let arguments = ["office", "--seconds", "100", "--seed", "5", "--beams", "180"];
        Self::new(text(&PORTOLAN.simulated("bag", &arguments)), FAR, &["--duration", "70"])
    }

    /// One storey of a museum.
    fn museum() -> Self {
        let building = ["--no-gnss", "--size", "24x20", "--storeys", "1", "--people", "2", "--beams", "300"];
        let (recording, _) = simulated_once(&[&["museum", "--seconds", "18"], &building[..]].concat());
        Self::new(recording, [FAR[0], FAR[1], HIGHER], &["--no-xray"])
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs the same with the map near and far: `MAP` stands for it, `OUT` for a path of its own, `WHICH` for
    /// near or far. Exit codes must agree.
    fn run_both(&self, name: &str, arguments: &[&str]) -> [(PathBuf, common::Run); 2] {
        let runs = [("near", &self.near), ("far", &self.far)].map(|(which, map)| {
            let out = self.path(&format!("{name}_{which}"));
            let arguments: Vec<String> = arguments
                .iter()
                .map(|argument| {
                    argument.replace("MAP", map).replace("OUT", &text(&out)).replace("WHICH", which)
                })
                .collect();
            (out, portolan(&arguments))
        });
        let codes = runs.each_ref().map(|(_, run)| run.code);
        assert_eq!(codes[0], codes[1], "{}\n{}", runs[0].1.stderr, runs[1].1.stderr);
        runs
    }

    /// Asserts that trajectories are the same but for the shift.
    fn assert_moved(&self, near: &Path, far: &Path) {
        let (near, far) = (numbers(near), numbers(far));
        assert!(near.len() > 20 && near.len() == far.len(), "{} {}", near.len(), far.len());
        for (a, b) in near.iter().zip(&far) {
            assert!((a[0] - b[0]).abs() < 1e-6, "{a:?} {b:?}");
            assert!((0..3).all(|k| (b[k + 1] - a[k + 1] - self.shift[k]).abs() < SAME), "{a:?} {b:?}");
            assert!((4..8).all(|k| (b[k] - a[k]).abs() < 1e-4), "{a:?} {b:?}");
        }
    }
}

/// The numbers of a trajectory (.tum).
fn numbers(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    lines.map(|line| line.split(' ').map(|number| number.parse().unwrap()).collect()).collect()
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

/// The poses of the nodes of the last trajectory of a map, in a file beside it.
fn poses(output: &Path) -> PathBuf {
    let path = text(&output.with_extension("pbstream"));
    let poses = format!("{path}.tum");
    let convert = |id| portolan(&["convert", &path, "-o", &poses, "--trajectory", id]);
    assert!(["1", "0"].into_iter().any(|id| convert(id).code == Some(0)), "{}", convert("0").stderr);
    PathBuf::from(poses)
}

/// Width and height of a picture.
fn size(picture: &Path) -> [u32; 2] {
    let bytes = std::fs::read(picture).unwrap();
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()))
}

/// Whether pictures are of one size, but for a pixel at the edge, which rounding decides.
fn assert_alike(near: &Path, far: &Path) {
    let (a, b) = (size(near), size(far));
    assert!(a.iter().zip(&b).all(|(a, b)| a.abs_diff(*b) <= 1), "{a:?} {b:?}");
}

/// A report without what differs from run to run.
fn report(folder: &Path) -> serde_json::Value {
    let mut report = json(&folder.join("report.json"));
    for key in ["wall_seconds", "saved_map"] {
        report.as_object_mut().unwrap().remove(key);
    }
    report
}

/// Positions of all corners of what changed.
fn corners(folder: &Path) -> Vec<[f64; 2]> {
    let changes = json(&folder.join("changes.geojson"));
    let rings = changes["features"].as_array().unwrap().iter().flat_map(|feature| {
        feature["geometry"]["coordinates"]
            .as_array()
            .unwrap()
            .iter()
            .flat_map(|ring| ring.as_array().unwrap())
    });
    rings.map(|corner| [0, 1].map(|k| corner[k].as_f64().unwrap())).collect()
}

/// Localises near and far and compares everything.
fn assert_localised_alike(place: &Place, skip: &str, more: &[&str]) {
    let update = ["--skip", skip, "-q", "--update", "OUT.pbstream"];
    let arguments = [&["localize", "MAP", &place.recording, "-o", "OUT"], &update[..], more].concat();
    let [(near, run), (far, _)] = place.run_both("localized", &arguments);
    assert_eq!(run.code, Some(0), "{}", run.stderr);
    place.assert_moved(&near.join("poses.tum"), &far.join("poses.tum"));
    assert_eq!(report(&near), report(&far));
    let (a, b) = (corners(&near), corners(&far));
    assert_eq!(a.len(), b.len());
    let is_moved =
        |(a, b): (&[f64; 2], &[f64; 2])| (0..2).all(|k| (b[k] - a[k] - place.shift[k]).abs() < SAME);
    assert!(a.iter().zip(&b).all(is_moved));
    assert_alike(&near.join("path.png"), &far.join("path.png"));
    place.assert_moved(&poses(&near), &poses(&far));
}

#[test]
fn an_office_in_utm_is_localised_in_as_one_near_the_origin() {
    assert_localised_alike(&Place::office(), "65", &[]);
}

#[test]
fn a_museum_in_utm_is_localised_in_as_one_near_the_origin() {
    assert_localised_alike(&Place::museum(), "1", &[]);
}

#[test]
fn a_start_in_utm_is_used() {
    let place = Place::office();
    let localize = ["localize", "MAP", &place.recording, "-o", "OUT", "--skip", "65", "-q"];
    place.run_both("found", &localize);
    let start = text(&place.path("found_WHICH")) + "/poses.csv";
    let [(near, _), (far, _)] = place.run_both("told", &[&localize[..], &["--start-from", &start]].concat());
    place.assert_moved(&near.join("poses.tum"), &far.join("poses.tum"));
    let [a, b] = [near, far].map(|folder| report(&folder)["start"].take());
    assert!((b["y"].as_f64().unwrap() - a["y"].as_f64().unwrap() - FAR[1]).abs() < SAME, "{a} {b}");
    assert_eq!(a["agrees_with_the_place_at_the_end"], b["agrees_with_the_place_at_the_end"]);
}

#[test]
fn maps_in_utm_are_continued() {
    for (place, skip) in [(Place::office(), "50"), (Place::museum(), "0")] {
        for more in [&[][..], &["--frozen"]] {
            let arguments =
                ["map", &place.recording, "--from", "MAP", "-o", "OUT", "-q", "--skip", skip, "--no-xray"];
            let name = format!("on_{}", more.len());
            let [(near, run), (far, _)] = place.run_both(&name, &[&arguments, more].concat());
            assert_eq!(run.code, Some(0), "{}", run.stderr);
            place.assert_moved(&near.join("trajectory.tum"), &far.join("trajectory.tum"));
        }
    }
}

#[test]
fn pictures_of_maps_in_utm_are_those_of_maps_near_the_origin() {
    for place in [Place::office(), Place::museum()] {
        let [(near, _), (far, _)] =
            place.run_both("picture", &["render", "MAP", "-o", "OUT.png", "--grey", "-q"]);
        let [near, far] = [near, far].map(|path| path.with_extension("png"));
        assert_alike(&near, &far);
        let [near, far] = [near, far].map(|path| std::fs::metadata(path).unwrap().len());
        // Walls that are missing would make it much smaller.
        assert!(near.abs_diff(far) < near / 20, "{near} {far}");
    }
}

#[test]
fn maps_in_utm_are_optimised_merged_and_turned() {
    let place = Place::office();
    let [(near, a), (far, b)] =
        place.run_both("optimised", &["optimize", "MAP", "-o", "OUT.pbstream", "--json"]);
    let [a, b]: [serde_json::Value; 2] = [a, b].map(|run| serde_json::from_str(&run.stdout).unwrap());
    assert_eq!(a["iterations"], b["iterations"], "{a} {b}");
    place.assert_moved(&poses(&near), &poses(&far));
    let turned = ["edit", "MAP", "-o", "OUT.pbstream", "--rotate", "walls", "--json"];
    let [(_, a), (_, b)] = place.run_both("turned", &turned);
    let angle = |run: &common::Run| {
        serde_json::from_str::<serde_json::Value>(&run.stdout).unwrap()["rotated_degrees"].as_f64().unwrap()
    };
    assert!((angle(&a) - angle(&b)).abs() < 0.02, "{} {}", angle(&a), angle(&b));
    // The same map once more, not moved, finds its place in the one in UTM.
    let [(near, _), (far, _)] =
        place.run_both("merged", &["edit", "MAP", "--merge", &place.near, "-o", "OUT.pbstream", "--json"]);
    place.assert_moved(&poses(&near), &poses(&far));
}

#[test]
fn places_of_a_map_in_utm_are_examined() {
    let place = Place::office();
    let [(_, a), (_, b)] = place.run_both("places", &["check", "MAP", "--places", "--json"]);
    let kinds = |run: &common::Run| {
        let report: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        report[0]["places"]["kinds"].clone()
    };
    assert!(kinds(&a).is_array(), "{}", a.stdout);
    assert_eq!(kinds(&a), kinds(&b));
}

#[test]
fn moves_off_the_earth_are_refused() {
    let place = Place::office();
    for by in ["1e9,0", "0,-1e15"] {
        let out = text(&place.path("off.pbstream"));
        let run = portolan_with_code(1, &["edit", &place.near, "-o", &out, &format!("--move={by}")]);
        assert!(run.stderr.contains("100000 km at most"), "{}", run.stderr);
    }
}
