//! From version 1 to 2.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use crate::common;

use common::small_map::SmallMap;
use portolan_mapfile::{MapDraft, MigrateError, MigrateOptions, load_textures, migrate};
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::{MapReader, PbstreamReader, PbstreamWriter, RawMessage, ReadLimits, validate};
use portolan_testing::{real_data, real_maps};
use prost::Message as _;
use std::path::Path;

fn old_3d_map() -> SmallMap {
    let mut map = SmallMap::new(true);
    map.version = 1;
    (0..2).for_each(|i| map.submap_3d(i).rotational_scan_matcher_histogram.clear());
    map
}

fn histograms(path: &Path) -> Vec<Vec<f32>> {
    let mut reader = MapReader::open(path).unwrap();
    assert_eq!(reader.header().format_version, 2);
    let mut histograms = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if let Data::Submap(submap) = message.data {
            histograms.push(submap.submap_3d.unwrap().rotational_scan_matcher_histogram);
        }
    }
    histograms
}

#[test]
fn histograms_come_from_the_nodes() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old.pbstream"), folder.path().join("new.pbstream"));
    let mut map = old_3d_map();
    map.graph.constraint.truncate(1);
    map.write(&old);
    let report = migrate(&old, &new, MigrateOptions::default()).unwrap();
    assert_eq!((report.from_version, report.histograms, report.messages), (1, 1, 11));
    assert_eq!(histograms(&new), [vec![1.0; 10], vec![]]);
}

#[test]
fn unfinished_submaps_can_be_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old.pbstream"), folder.path().join("new.pbstream"));
    old_3d_map().write(&old);
    let options = MigrateOptions { include_unfinished_submaps: false, ..MigrateOptions::default() };
    let report = migrate(&old, &new, options).unwrap();
    assert_eq!((report.histograms, report.unfinished_submaps, report.messages), (1, 1, 10));
    assert_eq!(histograms(&new), [vec![2.0; 10]]);
    assert_eq!(validate(&mut PbstreamReader::open(&new).unwrap()), []);
}

#[test]
fn the_configuration_moves_from_the_header_to_the_options() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old.pbstream"), folder.path().join("new.pbstream"));
    let map = old_3d_map();
    let mut writer = PbstreamWriter::create(&old).unwrap();
    let portolan_configuration = "{\"a\": 1}".to_owned();
    let header = m::SerializationHeader { format_version: 1, portolan_configuration };
    writer.write_bytes(header.encode_to_vec()).unwrap();
    writer.write(Data::PoseGraph(map.graph)).unwrap();
    writer.write(Data::AllTrajectoryBuilderOptions(map.options)).unwrap();
    map.rest.into_iter().for_each(|data| writer.write(data).unwrap());
    writer.finish().unwrap();
    migrate(&old, &new, MigrateOptions::default()).unwrap();
    for path in [&old, &new] {
        assert_eq!(MapReader::open(path).unwrap().configuration(), "{\"a\": 1}");
    }
    let reader = MapReader::open(&new).unwrap();
    assert_eq!(reader.header().portolan_configuration, "");
    assert_eq!(reader.options().options_with_sensor_ids.len(), 1);
    // `edit` moves it, too, and keeps it once.
    for from in [&old, &new] {
        let edited = folder.path().join("edited.pbstream");
        MapDraft::open(from, ReadLimits::default()).unwrap().write(&edited).unwrap();
        let reader = MapReader::open(&edited).unwrap();
        assert_eq!((reader.configuration(), &*reader.header().portolan_configuration), ("{\"a\": 1}", ""));
    }
}

#[test]
fn unknown_fields_survive() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old.pbstream"), folder.path().join("new.pbstream"));
    old_3d_map().write(&old);
    let mut all: Vec<RawMessage> = PbstreamReader::open(&old).unwrap().map(Result::unwrap).collect();
    // Field 100 of SerializedData, in a submap's message.
    let unknown = [0xa0, 6, 42];
    all[3].bytes.extend_from_slice(&unknown);
    let mut writer = portolan_pbstream::PbstreamWriter::create(&old).unwrap();
    all.into_iter().for_each(|m| writer.write_bytes(m.bytes).unwrap());
    writer.finish().unwrap();
    migrate(&old, &new, MigrateOptions::default()).unwrap();
    assert_eq!(histograms(&new)[0], vec![2.0; 10]);
    let raw = PbstreamReader::open(&new).unwrap().nth(3).unwrap().unwrap();
    assert!(raw.bytes.windows(3).any(|w| w == unknown));
}

#[test]
fn parts_that_cannot_be_migrated_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old.pbstream"), folder.path().join("new.pbstream"));
    let mut map = old_3d_map();
    map.graph.trajectory[0].trajectory_id = 3;
    map.write(&old);
    let error = migrate(&old, &new, MigrateOptions::default());
    assert!(matches!(error, Err(MigrateError::TrajectoryId { index: 0, id: 3 })));
    let mut map = old_3d_map();
    map.rest[1] = SmallMap::new(false).rest[1].clone();
    map.write(&old);
    let error = migrate(&old, &new, MigrateOptions::default()).unwrap_err();
    assert!(error.to_string().contains("only makes sense for 3D."), "{error}");
    assert!(!new.exists());
}

#[test]
fn real_2d_maps_keep_their_content() {
    let folder = tempfile::tempdir().unwrap();
    let new = folder.path().join("new.pbstream");
    for name in ["NHK_pr_108", "shannon112_ironfish_test"] {
        let Some(old) = real_data(&format!("maps/wild/{name}.pbstream")) else { return };
        let report = migrate(&old, &new, MigrateOptions::default()).unwrap();
        assert_eq!((report.from_version, report.histograms), (1, 0));
        let bytes = |p: &Path| -> Vec<_> {
            PbstreamReader::open(p).unwrap().skip(1).map(|m| m.unwrap().bytes).collect()
        };
        assert!(bytes(&old) == bytes(&new));
    }
}

/// The sum of turned node histograms is what Cartographer stored in its submaps.
#[test]
fn summed_histograms_are_those_of_the_reference() {
    let folder = tempfile::tempdir().unwrap();
    let (old, new) = (folder.path().join("old.pbstream"), folder.path().join("new.pbstream"));
    for path in real_maps().iter().filter(|p| p.to_string_lossy().contains("3d")) {
        let mut writer = portolan_pbstream::PbstreamWriter::create(&old).unwrap();
        let mut expected = Vec::new();
        for raw in PbstreamReader::open(path).unwrap() {
            let raw = raw.unwrap();
            match raw.decode().unwrap() {
                portolan_pbstream::Message::Header(_) => writer.write_header(1).unwrap(),
                portolan_pbstream::Message::Data(data) => match *data {
                    Data::Submap(mut submap) => {
                        let submap_3d = submap.submap_3d.as_mut().unwrap();
                        expected.push(std::mem::take(&mut submap_3d.rotational_scan_matcher_histogram));
                        writer.write(Data::Submap(submap)).unwrap();
                    }
                    _ => writer.write_bytes(raw.bytes).unwrap(),
                },
                portolan_pbstream::Message::Unknown(_) => unreachable!(),
            }
        }
        writer.finish().unwrap();
        migrate(&old, &new, MigrateOptions::default()).unwrap();
        for (found, expected) in histograms(&new).iter().zip(&expected) {
            let (a, b): (f32, f32) = (found.iter().sum(), expected.iter().sum());
            let difference: f32 = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).sum();
            assert!(
                difference < 1e-3 * b && (a - b).abs() < 1e-3 * b,
                "{}: {a} {b} {difference}",
                path.display()
            );
        }
        assert_eq!(load_textures(&mut MapReader::open(&new).unwrap()).unwrap().skipped, []);
    }
}
