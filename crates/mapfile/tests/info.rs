//! Summaries of maps against what Cartographer printed.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::collections::BTreeMap;

use portolan_mapfile::info;
use portolan_pbstream::{MapReader, PbstreamReader, ReadLimits};
use portolan_testing::{real_data, real_maps};

#[test]
fn counts_agree_with_the_reference() {
    let Some(notes) = real_data("maps/reference/NOTES.md") else { return };
    let notes = std::fs::read_to_string(notes).unwrap();
    let mut expected: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    let mut map = "";
    for line in notes.lines() {
        if let Some(name) = line.strip_prefix("## ") {
            map = name;
        }
        if ["Header:", "Trajectory id:", "SerializedData"].iter().any(|p| line.starts_with(p)) {
            expected.entry(map).or_default().push(line);
        }
    }
    assert_eq!(expected.len(), 6);
    for (name, lines) in expected {
        let path = real_data(&format!("maps/reference/{name}")).unwrap();
        let info = info(&mut MapReader::open(path).unwrap()).unwrap();
        let printed = info.lines(name);
        assert_eq!(printed[0], format!("Reading pbstream file from '{name}'..."));
        assert!(printed[2].starts_with("Trajectory options: sensor_id {\n  "), "{}", printed[2]);
        let printed: Vec<&str> = printed
            .iter()
            .map(String::as_str)
            .filter(|l| !l.starts_with("Traj") || l.contains('#'))
            .collect();
        assert_eq!(printed[1..], lines, "{name}");
    }
}

#[test]
fn figures_are_sensible() {
    for path in real_maps() {
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let info = info(&mut MapReader::open(&path).unwrap()).unwrap();
        for trajectory in &info.trajectories {
            assert!(trajectory.path_length > 0.1 && trajectory.duration > 0.0, "{name}");
        }
        let (nodes, mapped) = (info.bounding_box.unwrap(), info.mapped_extent.unwrap());
        assert!(nodes.max[0] > nodes.min[0] && mapped.max[0] > mapped.min[0], "{name}");
        assert!(info.constraints.intra_submap > 0 && !info.grids.resolutions.is_empty(), "{name}");
        assert!(serde_json::to_string(&info).unwrap().contains("\"path_length\""));
    }
}

#[test]
fn the_schema_knows_every_field_of_real_maps() {
    for path in real_maps() {
        for raw in PbstreamReader::open(&path).unwrap() {
            let raw = raw.unwrap();
            if raw.bytes.len() > 100_000 {
                continue;
            }
            let text = raw.to_text();
            let unknown = text.lines().find(|l| l.trim_start().starts_with(|c: char| c.is_ascii_digit()));
            assert_eq!(unknown, None, "{} message {}", path.display(), raw.index);
        }
    }
}

#[test]
fn summaries_do_not_need_the_cells() {
    for path in real_maps() {
        let with = info(&mut MapReader::open(&path).unwrap()).unwrap();
        let mut reader = MapReader::open_for_summary(&path, ReadLimits::default()).unwrap();
        assert!(info(&mut reader).unwrap() == with, "{}", path.display());
    }
}
