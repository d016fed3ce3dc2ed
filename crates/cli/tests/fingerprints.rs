//! Results byte for byte: a change that is not meant to change any shows here.
//!
//! After a wanted change `PORTOLAN_BLESS=1 cargo test -p portolan-cli --test fingerprints` writes the new table. Rows
//! of recordings that are not at hand stay as they are.
#![allow(clippy::unwrap_used, clippy::panic)]

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::{portolan_with_code, shared, simulated, text};

/// Case and file, checksum and size.
type Table = BTreeMap<(String, String), String>;

const TABLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fingerprints.txt");

fn add(table: &mut Table, case: &str, folder: &Path, files: &[&str]) {
    for file in files {
        let bytes = std::fs::read(folder.join(file)).unwrap();
        let print = format!("{:08x} {}", crc32fast::hash(&bytes), bytes.len());
        table.insert((case.to_owned(), (*file).to_owned()), print);
    }
}

const MAPPED: &[&str] = &["map.pbstream", "trajectory.tum"];

/// Maps a recording into `folder/case`.
fn map(table: &mut Table, case: &str, folder: &Path, recording: &str, more: &[&str]) {
    let results = folder.join(case);
    let results_text = text(&results);
    let arguments = [&["map", recording, "-o", &results_text, "-q", "--no-xray"][..], more].concat();
    portolan_with_code(0, &arguments);
    add(table, case, &results, MAPPED);
}

/// The defaults of Cartographer as a file.
fn configuration(folder: &Path, dimension: &[&str]) -> String {
    let path = text(&folder.join(format!("robot{}.lua", dimension.concat())));
    let shown = portolan_with_code(0, &[&["config", "show", "--lua"][..], dimension].concat());
    std::fs::write(&path, shown.stdout).unwrap();
    path
}

fn real_recordings(table: &mut Table, folder: &Path) {
    if let Some(aces) = shared("data/lidar2d/aces/aces.clf.bz2") {
        map(table, "2d-log", folder, &aces, &["--duration", "150"]);
        let lua = configuration(folder, &[]);
        map(
            table,
            "2d-lua",
            folder,
            &aces,
            &["--duration", "110", "--config", &lua, "--set", "trajectory_builder_2d.use_imu_data=false"],
        );
    }
    if let Some(csail) = shared("data/lidar2d/mit-csail/mit-csail.clf.bz2") {
        map(table, "2d-stalling-wheels", folder, &csail, &["--duration", "100"]);
    }
    if let Some(corridor) = shared("data/lidar3d/corridor_imu.bag") {
        map(table, "3d-imu", folder, &corridor, &["--duration", "15"]);
        let lua = configuration(folder, &["--3d"]);
        map(
            table,
            "3d-lua-grids",
            folder,
            &corridor,
            &["--duration", "6", "--config", &lua, "--tracking-frame", "imu_link"],
        );
    }
    if let Some(drive) = shared("data/lidar3d/kitti_0001.bag") {
        map(table, "3d-drive", folder, &drive, &["--duration", "2"]);
    }
}

fn simulated_recordings(table: &mut Table, folder: &Path) {
    let museum = text(&folder.join("museum.bag"));
    let two = ["--seconds", "6", "--lidars", "2", "--seed", "3", "--beams", "450"];
    portolan_with_code(0, &[&["simulate", "museum", "-o", &museum][..], &two].concat());
    map(table, "3d-two-lidars", folder, &museum, &[]);
    let trajectory = text(&folder.join("3d-two-lidars/trajectory.tum"));
    let refined = folder.join("refined");
    let output = text(&refined);
    let arguments = ["refine", "--recording", &museum, "--trajectory", &trajectory, "-o", &output, "-q"];
    portolan_with_code(0, &[&arguments[..], &["--no-cloud", "--no-report"]].concat());
    add(table, "refine", &refined, &["refined.tum"]);
    let robot = simulated(folder, "robot.bag", &[]);
    map(table, "2d-robot", folder, &robot, &[]);
    let known = text(&folder.join("2d-robot/map.pbstream"));
    map(table, "2d-known-map", folder, &robot, &["--from", &known, "--frozen", "--skip", "3"]);
}

fn written() -> Table {
    let file = std::fs::read_to_string(TABLE).unwrap_or_default();
    let row = |line: &str| {
        let (case, rest) = line.split_once(' ')?;
        let (file, print) = rest.split_once(' ')?;
        Some(((case.to_owned(), file.to_owned()), print.to_owned()))
    };
    file.lines().filter(|line| !line.starts_with('#')).filter_map(row).collect()
}

#[test]
fn results_are_those_of_the_table() {
    let folder = tempfile::tempdir().unwrap();
    let mut found = Table::new();
    simulated_recordings(&mut found, folder.path());
    real_recordings(&mut found, folder.path());
    let mut expected = written();
    if std::env::var_os("PORTOLAN_BLESS").is_some() {
        expected.extend(found);
        let rows = expected.iter().map(|((case, file), print)| format!("{case} {file} {print}\n"));
        let head = "# case, file, CRC-32, bytes; written by fingerprints.rs\n";
        std::fs::write(TABLE, std::iter::once(head.to_owned()).chain(rows).collect::<String>()).unwrap();
        return;
    }
    let changed: Vec<String> = found
        .iter()
        .filter(|(key, print)| expected.get(*key) != Some(*print))
        .map(|((case, file), print)| format!("{case} {file}: {print}"))
        .collect();
    assert!(
        changed.is_empty(),
        "results changed; if that is wanted see the head of this file:\n{changed:#?}"
    );
}
