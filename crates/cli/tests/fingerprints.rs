//! Results byte for byte: a change that is not meant to change any shows here.
//!
//! After a wanted change `PORTOLAN_BLESS=1 cargo test -p portolan-cli --test all fingerprints::` writes the new table. Rows
//! of recordings that are not at hand stay as they are.
#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common;

use std::path::Path;

use common::{PORTOLAN, portolan_with_code, real, simulated, text};
use portolan_testing::{Fingerprints, is_fast};

const TABLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fingerprints.txt");

const MAPPED: &[&str] = &["map.pbstream", "trajectory.tum"];

/// Maps a recording into `folder/case`.
fn map(table: &mut Fingerprints, case: &str, folder: &Path, recording: &str, more: &[&str]) {
    let results = folder.join(case);
    let results_text = text(&results);
    let arguments = [&["map", recording, "-o", &results_text, "-q", "--no-xray"][..], more].concat();
    portolan_with_code(0, &arguments);
    table.add(case, &results, MAPPED);
}

/// The defaults of Cartographer as a file.
fn configuration(folder: &Path, dimension: &[&str]) -> String {
    let path = text(&folder.join(format!("robot{}.lua", dimension.concat())));
    let shown = portolan_with_code(0, &[&["config", "show", "--lua"][..], dimension].concat());
    std::fs::write(&path, shown.stdout).unwrap();
    path
}

fn real_recordings(table: &mut Fingerprints, folder: &Path) {
    if let Some(aces) = real("lidar2d/aces/aces.clf.bz2") {
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
    if let Some(csail) = real("lidar2d/mit-csail/mit-csail.clf.bz2") {
        map(table, "2d-stalling-wheels", folder, &csail, &["--duration", "100"]);
    }
    if let Some(corridor) = real("lidar3d/corridor_imu.bag") {
        map(table, "3d-imu", folder, &corridor, &["--duration", "15"]);
        let lua = configuration(folder, &["--3d"]);
        let of_lua = ["--duration", "6", "--config", &lua, "--tracking-frame", "imu_link"];
        map(table, "3d-lua-planes", folder, &corridor, &of_lua);
        map(table, "3d-lua-grids", folder, &corridor, &[&of_lua[..], &["--engine", "grids"]].concat());
    }
    if let Some(drive) = real("lidar3d/kitti_0001.bag") {
        map(table, "3d-drive", folder, &drive, &["--duration", "2"]);
    }
}

fn simulated_recordings(table: &mut Fingerprints, folder: &Path) {
    let two = ["museum", "--seconds", "6", "--lidars", "2", "--seed", "3", "--beams", "450"];
    let museum = text(&PORTOLAN.simulated("bag", &two));
    map(table, "3d-two-lidars", folder, &museum, &[]);
    let trajectory = text(&folder.join("3d-two-lidars/trajectory.tum"));
    let refined = folder.join("refined");
    let output = text(&refined);
    let arguments = ["refine", "--recording", &museum, "--trajectory", &trajectory, "-o", &output, "-q"];
    // Six exact seconds cannot be bettered: the input is refused to be changed.
    portolan_with_code(4, &[&arguments[..], &["--no-cloud", "--no-report", "--force"]].concat());
    table.add("refine", &refined, &["refined.tum"]);
    let robot = simulated(folder, "robot.bag", &[]);
    map(table, "2d-robot", folder, &robot, &[]);
    let known = text(&folder.join("2d-robot/map.pbstream"));
    map(table, "2d-known-map", folder, &robot, &["--from", &known, "--frozen", "--skip", "3"]);
}

#[test]
fn results_are_those_of_the_table() {
    if is_fast() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut table = Fingerprints::of_table(TABLE);
    simulated_recordings(&mut table, folder.path());
    real_recordings(&mut table, folder.path());
    table.check();
}
