//! 3D maps of other programs go into memory and come out again.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use crate::common;

use std::path::Path;

use common::small_map::SmallMap;
use portolan_config::Options;
use portolan_mapfile::{
    LoadedMap, MapConversionError, MapDraft, MapLoadSettings, load_textures, read_map, submap_textures_3d,
    write_graph,
};
use portolan_mapping::{Space2d, Space3d};
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::{FindingKind, MapReader, PbstreamReader, ReadLimits, validate};
use portolan_testing::{real_data, real_maps};
use prost::Message as _;

fn messages(path: &Path) -> (m::PoseGraph, Vec<Data>) {
    let mut reader = MapReader::open(path).unwrap();
    let mut rest = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        rest.push(message.data);
    }
    (reader.pose_graph().clone(), rest)
}

fn is_3d(path: &Path) -> bool {
    messages(path).1.iter().any(|d| matches!(d, Data::Submap(m::Submap { submap_3d: Some(_), .. })))
}

/// Reads a map and writes it again.
fn through_memory(path: &Path, copy: &Path) -> LoadedMap<Space3d> {
    let loaded: LoadedMap<Space3d> = read_map(path, &MapLoadSettings::default()).unwrap();
    let options = Options::default();
    write_graph(&loaded.graph, &loaded.trajectories, &options, copy, true).unwrap();
    loaded
}

#[test]
fn textures_of_memory_and_file_agree() {
    let Some(path) = real_data("maps/reference/small_3d.pbstream") else { return };
    let from_file = load_textures(&mut MapReader::open(&path).unwrap()).unwrap().textures;
    let loaded: LoadedMap<Space3d> = read_map(&path, &MapLoadSettings::default()).unwrap();
    let in_memory = submap_textures_3d(&loaded.into_map(Options::default()));
    assert!(!from_file.is_empty());
    assert_eq!(from_file.len(), in_memory.len());
    for (a, b) in from_file.iter().zip(&in_memory) {
        // Rotations are normalised when they are read into memory.
        assert!((a.map_from_submap.inverse() * b.map_from_submap).rotation.angle() < 1e-9);
        assert_eq!((a.id, a.texture.width, a.texture.height), (b.id, b.texture.width, b.texture.height));
        assert!(a.texture.pixels() == b.texture.pixels(), "{:?}", a.id);
    }
}

#[test]
fn maps_in_3d_survive_memory() {
    let folder = tempfile::tempdir().unwrap();
    let mut count = 0;
    for path in real_maps().into_iter().filter(|p| is_3d(p)) {
        let copy = folder.path().join("copy.pbstream");
        let loaded = through_memory(&path, &copy);
        let ((before, old), (after, new)) = (messages(&path), messages(&copy));
        assert_eq!(before.constraint.len(), after.constraint.len(), "{}", path.display());
        let submaps = |all: &[Data]| -> Vec<m::Submap> {
            all.iter().filter_map(|d| if let Data::Submap(s) = d { Some(s.clone()) } else { None }).collect()
        };
        let (old_submaps, new_submaps) = (submaps(&old), submaps(&new));
        assert_eq!(old_submaps.len(), new_submaps.len());
        for (a, b) in old_submaps.iter().zip(&new_submaps) {
            let (a, b) = (a.submap_3d.as_ref().unwrap(), b.submap_3d.as_ref().unwrap());
            assert_eq!(a.high_resolution_hybrid_grid, b.high_resolution_hybrid_grid);
            assert_eq!(a.low_resolution_hybrid_grid, b.low_resolution_hybrid_grid);
            assert_eq!(a.rotational_scan_matcher_histogram, b.rotational_scan_matcher_histogram);
            assert_eq!((a.num_range_data, a.finished), (b.num_range_data, b.finished));
        }
        let kinds = |all: &[Data]| {
            let of = |f: fn(&Data) -> bool| all.iter().filter(|d| f(d)).count();
            [
                of(|d| matches!(d, Data::Node(_))),
                of(|d| matches!(d, Data::ImuData(_))),
                of(|d| matches!(d, Data::TrajectoryData(_))),
            ]
        };
        assert_eq!(kinds(&old), kinds(&new), "{}", path.display());
        let (mut memory, mut stored) = (0, 0);
        for (entry, message) in loaded.graph.state().submaps.values().zip(&old_submaps) {
            let submap = entry.submap.as_ref().unwrap();
            let message = message.submap_3d.as_ref().unwrap();
            memory += submap.high_resolution_grid.memory_bytes() + submap.low_resolution_grid.memory_bytes();
            stored += message.high_resolution_hybrid_grid.as_ref().unwrap().encoded_len()
                + message.low_resolution_hybrid_grid.as_ref().unwrap().encoded_len();
        }
        eprintln!("{}: grids take {memory} bytes, {stored} in the file unpacked", path.display());
        // Grids that are only read take no more memory than a fifth more than their messages.
        assert!(5 * memory <= 6 * stored, "{}: {memory} bytes, {stored} in the file", path.display());
        count += 1;
    }
    assert!(count > 0 || real_maps().is_empty());
}

/// Times of IMU samples, and whether they were measured.
fn imu(path: &Path) -> Vec<(i64, bool)> {
    let of = |data: &Data| match data {
        Data::ImuData(m::ImuData { imu_data: Some(imu), derived_from_poses, .. }) => {
            Some((imu.timestamp, !derived_from_poses))
        }
        _ => None,
    };
    messages(path).1.iter().filter_map(of).collect()
}

#[test]
fn trajectories_without_imu_get_samples_that_agree_with_the_poses() {
    let folder = tempfile::tempdir().unwrap();
    let [path, copy, edited] = ["map", "copy", "edited"].map(|name| folder.path().join(name));
    let mut map = SmallMap::new(true);
    for (node, part) in map.graph.trajectory[0].node.iter_mut().zip(&mut map.rest[2..5]) {
        node.timestamp = (node.timestamp - 1000) * 10_000_000;
        let Data::Node(m::Node { node_data: Some(data), .. }) = part else { panic!("no node: {part:?}") };
        data.timestamp = node.timestamp;
    }
    map.rest.retain(|data| !matches!(data, Data::ImuData(_)));
    map.write(&path);
    let warnings = |path: &Path| {
        let findings = validate(&mut PbstreamReader::open(path).unwrap());
        findings.into_iter().map(|f| f.kind).collect::<Vec<_>>()
    };
    assert_eq!(warnings(&path), [FindingKind::Imu]);
    let loaded = through_memory(&path, &copy);
    assert!(loaded.graph.problem().sensors.values().all(|s| s.imu.is_empty()));
    assert_eq!(warnings(&copy), []);
    let expected: Vec<(i64, bool)> = (0..9).map(|i| (i * 2_500_000, false)).collect();
    assert_eq!(imu(&copy), expected);
    // What is derived is not taken for measured.
    let again = through_memory(&copy, &edited);
    assert!(again.graph.problem().sensors.values().all(|s| s.imu.is_empty()));
    for from in [&path, &copy] {
        MapDraft::open(from, ReadLimits::default()).unwrap().write(&edited).unwrap();
        assert_eq!((imu(&edited), warnings(&edited)), (expected.clone(), vec![]));
    }
}

#[test]
fn negative_zeros_survive_memory() {
    let folder = tempfile::tempdir().unwrap();
    let [path, copy] = ["map", "copy"].map(|name| folder.path().join(name));
    let mut map = SmallMap::new(true);
    let pose = map.graph.trajectory[0].node[1].pose.as_mut().unwrap();
    pose.translation.as_mut().unwrap().y = -0.0;
    pose.rotation.as_mut().unwrap().x = -0.0;
    map.write(&path);
    through_memory(&path, &copy);
    for path in [path, copy] {
        let pose = messages(&path).0.trajectory[0].node[1].pose.unwrap();
        assert!(
            pose.translation.unwrap().y.is_sign_negative() && pose.rotation.unwrap().x.is_sign_negative()
        );
    }
}

#[test]
fn unfinished_submaps_remain_unfinished() {
    let folder = tempfile::tempdir().unwrap();
    let [path, copy, edited] = ["map", "copy", "edited"].map(|name| folder.path().join(name));
    let mut map = SmallMap::new(true);
    let Data::Submap(m::Submap { submap_3d: Some(last), .. }) = &mut map.rest[1] else { panic!("no submap") };
    last.finished = false;
    map.write(&path);
    through_memory(&path, &copy);
    MapDraft::open(&copy, ReadLimits::default()).unwrap().write(&edited).unwrap();
    for path in [path, copy, edited] {
        let finished = |data: &Data| match data {
            Data::Submap(m::Submap { submap_3d: Some(submap), .. }) => Some(submap.finished),
            _ => None,
        };
        assert_eq!(messages(&path).1.iter().filter_map(finished).collect::<Vec<_>>(), [true, false]);
    }
}

#[test]
fn maps_of_the_other_dimension_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.pbstream");
    SmallMap::new(false).write(&path);
    let refused = read_map::<Space3d>(&path, &MapLoadSettings::default());
    assert!(matches!(refused, Err(MapConversionError::TwoD)));
    SmallMap::new(true).write(&path);
    let refused = read_map::<Space2d>(&path, &MapLoadSettings::default());
    assert!(matches!(refused, Err(MapConversionError::ThreeD)));
    let copy = folder.path().join("copy.pbstream");
    through_memory(&path, &copy);
    assert!(is_3d(&copy));
}
