//! Maps of other programs go into memory and come out again.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use crate::common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use common::small_map::SmallMap;
use portolan_config::{Options, PoseGraphOptions};
use portolan_geometry::{Rigid3, rotation_angle};
use portolan_issue::{IssueKind, IssueLog};
use portolan_mapfile::{
    FrozenTrajectories, LoadedMap, MapConversionError, MapLoadSettings, load_map, load_textures, read_map_2d,
    submap_textures_2d, write_map_2d,
};
use portolan_mapping::{Mapper, MapperSettings, PoseGraph, Space2d, TrajectoryId, TrajectoryState};
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{self as m};
use portolan_pbstream::proto::transform::Rigid3d;
use portolan_pbstream::{MapReader, PbstreamReader, PbstreamWriter, pose_from_proto, validate};
use portolan_testing::{real_data, real_maps};
use proptest::prelude::*;
use tempfile::TempDir;

/// All messages of a map.
struct Contents {
    graph: m::PoseGraph,
    options: m::AllTrajectoryBuilderOptions,
    rest: Vec<Data>,
}

fn contents(path: &Path) -> Contents {
    let mut reader = MapReader::open(path).unwrap();
    let mut rest = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        rest.push(message.data);
    }
    Contents { graph: reader.pose_graph().clone(), options: reader.options().clone(), rest }
}

impl Contents {
    fn submaps(&self) -> Vec<&m::Submap> {
        self.rest.iter().filter_map(|d| if let Data::Submap(s) = d { Some(s) } else { None }).collect()
    }

    fn nodes(&self) -> Vec<&m::Node> {
        self.rest.iter().filter_map(|d| if let Data::Node(n) = d { Some(n) } else { None }).collect()
    }

    fn odometry(&self) -> Vec<&m::OdometryData> {
        self.rest.iter().filter_map(|d| if let Data::OdometryData(o) = d { Some(o) } else { None }).collect()
    }

    fn is_3d(&self) -> bool {
        self.submaps().iter().any(|s| s.submap_3d.is_some())
    }
}

fn load(path: &Path) -> LoadedMap<Space2d> {
    read_map_2d(path, &MapLoadSettings::default()).unwrap()
}

/// What reading said besides the map.
struct Loaded {
    trajectory_ids: BTreeMap<i32, TrajectoryId>,
    format_version: u32,
    issues: IssueLog,
}

/// Reads a map and writes it; returns the new file and what reading said.
fn saved_again(path: &Path, folder: &TempDir, name: &str) -> (PathBuf, Loaded) {
    let map = load(path);
    let loaded = Loaded {
        trajectory_ids: map.trajectory_ids.clone(),
        format_version: map.format_version,
        issues: map.issues.clone(),
    };
    let again = folder.path().join(name);
    write_map_2d(&map.into_map(Options::for_2d()), &again, true).unwrap();
    (again, loaded)
}

fn assert_same_pose(a: Option<&Rigid3d>, b: Option<&Rigid3d>, what: &str) {
    let (a, b): (Rigid3, Rigid3) = (pose_from_proto(a).unwrap(), pose_from_proto(b).unwrap());
    assert!(off(&a, &b) < 1e-9, "{what}: {a} {b}");
}

/// How far apart two poses are: metres or radians, whatever is more.
fn off(a: &Rigid3, b: &Rigid3) -> f64 {
    let off = a.inverse() * b;
    off.translation.vector.norm().max(rotation_angle(&off))
}

fn maps_2d() -> Vec<PathBuf> {
    real_maps().into_iter().filter(|p| !contents(p).is_3d()).collect()
}

#[test]
fn maps_in_2d_survive() {
    let maps = maps_2d();
    let folder = TempDir::new().unwrap();
    for path in &maps {
        let (again, loaded) = saved_again(path, &folder, "again.pbstream");
        eprintln!("{}: version {}, {:?}", path.display(), loaded.format_version, loaded.issues);
        let (a, b) = (contents(path), contents(&again));
        compare_graphs(&a, &b, &loaded);
        compare_submaps(&a, &b, &loaded);
        compare_nodes(&a, &b, &loaded);
        assert_eq!(a.odometry().len(), b.odometry().len());
        assert_eq!(a.options.options_with_sensor_ids.len(), b.options.options_with_sensor_ids.len());

        let (third, _) = saved_again(&again, &folder, "third.pbstream");
        assert!(std::fs::read(&again).unwrap() == std::fs::read(&third).unwrap(), "{}", path.display());
    }
}

/// The id that a trajectory of the file got.
fn new_id(loaded: &Loaded, id: i32) -> i32 {
    loaded.trajectory_ids[&id].0 as i32
}

fn compare_graphs(a: &Contents, b: &Contents, loaded: &Loaded) {
    assert_eq!(a.graph.trajectory.len(), b.graph.trajectory.len());
    for (a, b) in a.graph.trajectory.iter().zip(&b.graph.trajectory) {
        assert_eq!(new_id(loaded, a.trajectory_id), b.trajectory_id);
        assert_eq!((a.submap.len(), a.node.len()), (b.submap.len(), b.node.len()));
        for (a, b) in a.submap.iter().zip(&b.submap) {
            assert_eq!(a.submap_index, b.submap_index);
            assert_same_pose(a.pose.as_ref(), b.pose.as_ref(), "submap");
        }
        for (a, b) in a.node.iter().zip(&b.node) {
            assert_eq!((a.node_index, a.timestamp), (b.node_index, b.timestamp));
            assert_same_pose(a.pose.as_ref(), b.pose.as_ref(), "node");
        }
    }
    assert_eq!(a.graph.constraint.len(), b.graph.constraint.len());
    for (a, b) in a.graph.constraint.iter().zip(&b.graph.constraint) {
        let (a_submap, b_submap) = (a.submap_id.unwrap(), b.submap_id.unwrap());
        assert_eq!(new_id(loaded, a_submap.trajectory_id), b_submap.trajectory_id);
        assert_eq!(a_submap.submap_index, b_submap.submap_index);
        assert_eq!(a.node_id.unwrap().node_index, b.node_id.unwrap().node_index);
        assert_eq!(
            (a.translation_weight, a.rotation_weight, a.tag),
            (b.translation_weight, b.rotation_weight, b.tag)
        );
        assert_same_pose(a.relative_pose.as_ref(), b.relative_pose.as_ref(), "constraint");
    }
    assert_eq!(a.graph.landmark_poses.len(), b.graph.landmark_poses.len());
}

fn compare_submaps(a: &Contents, b: &Contents, loaded: &Loaded) {
    let (a, b) = (a.submaps(), b.submaps());
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(&b) {
        let (id_a, id_b) = (a.submap_id.unwrap(), b.submap_id.unwrap());
        assert_eq!(
            (new_id(loaded, id_a.trajectory_id), id_a.submap_index),
            (id_b.trajectory_id, id_b.submap_index)
        );
        let (a, b) = (a.submap_2d.as_ref().unwrap(), b.submap_2d.as_ref().unwrap());
        assert_eq!((a.finished, a.num_range_data), (b.finished, b.num_range_data));
        assert_same_pose(a.local_pose.as_ref(), b.local_pose.as_ref(), "submap in its local map");
        let (a, b) = (a.grid.as_ref().unwrap(), b.grid.as_ref().unwrap());
        assert!(a.cells == b.cells && a.limits == b.limits && a.grid == b.grid);
        if loaded.issues.is_empty() {
            assert_eq!(a.known_cells_box, b.known_cells_box);
        }
    }
}

fn compare_nodes(a: &Contents, b: &Contents, loaded: &Loaded) {
    let (a, b) = (a.nodes(), b.nodes());
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(&b) {
        let (id_a, id_b) = (a.node_id.unwrap(), b.node_id.unwrap());
        assert_eq!(
            (new_id(loaded, id_a.trajectory_id), id_a.node_index),
            (id_b.trajectory_id, id_b.node_index)
        );
        let (a, b) = (a.node_data.as_ref().unwrap(), b.node_data.as_ref().unwrap());
        assert_eq!(a.timestamp, b.timestamp);
        assert_same_pose(a.local_pose.as_ref(), b.local_pose.as_ref(), "node in its local map");
        assert_eq!(a.filtered_gravity_aligned_point_cloud, b.filtered_gravity_aligned_point_cloud);
        assert_eq!(a.rotational_scan_matcher_histogram, b.rotational_scan_matcher_histogram);
    }
}

#[test]
fn maps_of_the_reference_come_back_unchanged() {
    let folder = TempDir::new().unwrap();
    for name in ["aces", "small_2d", "small_tsdf"] {
        let Some(path) = real_data(&format!("maps/reference/{name}.pbstream")) else { continue };
        let (again, _) = saved_again(&path, &folder, "again.pbstream");
        let (a, b) = (contents(&path), contents(&again));
        assert_eq!(a.options.options_with_sensor_ids, b.options.options_with_sensor_ids, "{name}");
        // Only constraints are turned back and forth.
        assert_eq!(a.graph.trajectory, b.graph.trajectory, "{name}");
        assert!(a.rest == b.rest, "{name}: the other messages differ in content or order");
        let findings = validate(&mut PbstreamReader::open(&again).unwrap());
        assert!(findings.is_empty(), "{findings:?}");
    }
}

#[test]
fn frozen_maps_keep_constraints_and_measurements() {
    let Some(path) = real_data("maps/reference/small_2d.pbstream") else { return };
    let settings = MapLoadSettings { frozen: FrozenTrajectories::All, ..MapLoadSettings::default() };
    let loaded = read_map_2d(&path, &settings).unwrap();
    let state = loaded.graph.state();
    let thawed = load(&path);
    assert_eq!(state.constraints, thawed.graph.state().constraints);
    assert_eq!(loaded.graph.problem().sensors, thawed.graph.problem().sensors);
    assert!(loaded.graph.problem().sensors.values().any(|s| !s.odometry.is_empty()));
    assert!(state.submaps.values().all(|s| !s.node_ids.is_empty()));
    assert_eq!(state.trajectory_state(TrajectoryId(0)), TrajectoryState::Frozen);
}

#[test]
fn maps_are_added_behind_each_other_and_continued() {
    let Some(path) = real_data("maps/reference/small_2d.pbstream") else { return };
    let mut graph = PoseGraph::<Space2d>::new(PoseGraphOptions::default());
    let mut ended = BTreeMap::new();
    for expected in 0..2 {
        let loaded =
            load_map(&mut MapReader::open(&path).unwrap(), &mut graph, &FrozenTrajectories::None).unwrap();
        assert_eq!(loaded.trajectory_ids[&0], TrajectoryId(expected));
        ended.extend(loaded.trajectories);
    }
    let nodes = graph.state().nodes.len();
    assert!(nodes > 0 && nodes.is_multiple_of(2));
    let settings = MapperSettings { threads: 1, ..MapperSettings::default() };
    let mut mapper = Mapper::with_graph(&Options::for_2d(), settings, graph, ended).unwrap();
    assert_eq!(mapper.add_trajectory(&Default::default(), None).unwrap(), TrajectoryId(2));
    let (map, _) = mapper.finish().unwrap();
    assert_eq!(map.scan_poses(TrajectoryId(1)).len(), nodes / 2);
    // A trajectory without anything does not make the map unreadable.
    let folder = TempDir::new().unwrap();
    let saved = folder.path().join("both.pbstream");
    write_map_2d(&map, &saved, true).unwrap();
    assert_eq!(load(&saved).trajectories.len(), 3);
}

#[test]
fn textures_of_memory_and_file_agree() {
    for name in ["small_2d", "small_tsdf"] {
        let Some(path) = real_data(&format!("maps/reference/{name}.pbstream")) else { continue };
        let from_file = load_textures(&mut MapReader::open(&path).unwrap()).unwrap().textures;
        let in_memory = submap_textures_2d(&load(&path).into_map(Options::for_2d()));
        assert_eq!(from_file.len(), in_memory.len());
        for (a, b) in from_file.iter().zip(&in_memory) {
            assert_eq!((a.id, a.texture.width, a.texture.height), (b.id, b.texture.width, b.texture.height));
            assert!(off(&a.map_from_submap, &b.map_from_submap) < 1e-12);
            assert!(off(&a.texture.submap_from_slice, &b.texture.submap_from_slice) < 1e-12);
            assert!(a.texture.pixels() == b.texture.pixels(), "{name} {:?}", a.id);
        }
    }
}

#[test]
fn maps_in_3d_are_refused() {
    for name in ["small_3d", "corridor_imu"] {
        let Some(path) = real_data(&format!("maps/reference/{name}.pbstream")) else { continue };
        let refused = read_map_2d(&path, &MapLoadSettings::default()).err().unwrap();
        assert!(matches!(refused, MapConversionError::ThreeD), "{refused}");
    }
}

/// Writes the messages of the small reference map after `change`, and reads them.
fn changed(
    change: impl Fn(&mut m::PoseGraph, &mut Data),
) -> Option<Result<LoadedMap<Space2d>, MapConversionError>> {
    let path = real_data("maps/reference/small_2d.pbstream")?;
    let mut contents = contents(&path);
    let folder = TempDir::new().unwrap();
    let changed = folder.path().join("changed.pbstream");
    contents.rest.iter_mut().for_each(|data| change(&mut contents.graph, data));
    let mut writer = PbstreamWriter::create(&changed).unwrap();
    writer.write_header(2).unwrap();
    writer.write(Data::PoseGraph(contents.graph)).unwrap();
    writer.write(Data::AllTrajectoryBuilderOptions(contents.options)).unwrap();
    contents.rest.into_iter().for_each(|data| writer.write(data).unwrap());
    writer.finish().unwrap();
    Some(read_map_2d(&changed, &MapLoadSettings::default()))
}

#[test]
fn damage_within_messages_is_an_error() {
    let grid = |data: &mut Data, change: fn(&mut m::Grid2D)| {
        if let Data::Submap(submap) = data {
            change(submap.submap_2d.as_mut().unwrap().grid.as_mut().unwrap());
        }
    };
    let errors = [
        changed(|_, data| grid(data, |g| g.cells.truncate(3))),
        changed(|_, data| grid(data, |g| g.cells[0] = 70_000)),
        changed(|_, data| grid(data, |g| g.grid = None)),
        changed(|_, data| grid(data, |g| g.limits = None)),
        changed(|_, data| {
            if let Data::Node(node) = data {
                node.node_data.as_mut().unwrap().local_pose = None;
            }
        }),
        changed(|_, data| {
            if let Data::Node(node) = data {
                let data = node.node_data.as_mut().unwrap();
                data.filtered_gravity_aligned_point_cloud.as_mut().unwrap().num_points = i32::MAX;
            }
        }),
        changed(|graph, _| graph.trajectory[0].node[0].pose = None),
        changed(|graph, _| graph.constraint[0].relative_pose = None),
    ];
    for (i, result) in errors.into_iter().enumerate() {
        assert!(result.is_none_or(|r| r.is_err()), "case {i}");
    }
}

#[test]
fn parts_that_do_not_belong_together_are_counted() {
    let Some(lost) = changed(|graph, _| {
        graph.trajectory[0].node.truncate(20);
        graph.constraint[0].submap_id.as_mut().unwrap().submap_index = 77;
    }) else {
        return;
    };
    let issues = lost.unwrap().issues;
    assert!(issues.count_of(IssueKind::NodeUnplaced) > 0, "{issues:?}");
    assert!(issues.count_of(IssueKind::ConstraintUnconnected) > 0, "{issues:?}");
}

#[test]
fn truncated_files_are_errors() {
    let Some(path) = real_data("maps/reference/small_2d.pbstream") else { return };
    let bytes = std::fs::read(&path).unwrap();
    let folder = TempDir::new().unwrap();
    let cut = folder.path().join("cut.pbstream");
    for length in [0, 7, 9, 200, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&cut, &bytes[..length]).unwrap();
        assert!(read_map_2d(&cut, &MapLoadSettings::default()).is_err(), "{length}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever the messages say, reading ends with an error or a map that can be written and read.
    #[test]
    fn damaged_messages_never_panic(
        which in 1..12_usize,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in prop::option::weighted(0.2, any::<prop::sample::Index>()),
    ) {
        let folder = TempDir::new().unwrap();
        let [whole, damaged, again] = ["a", "b", "c"].map(|name| folder.path().join(name));
        SmallMap::new(false).write(&whole);
        let mut writer = PbstreamWriter::create(&damaged).unwrap();
        for message in PbstreamReader::open(&whole).unwrap() {
            let mut message = message.unwrap();
            if message.index as usize == which && !message.bytes.is_empty() {
                for (at, mask) in &flips {
                    let at = at.index(message.bytes.len());
                    message.bytes[at] ^= mask;
                }
                message.bytes.truncate(cut.map_or(usize::MAX, |c| c.index(message.bytes.len())));
            }
            writer.write_bytes(message.bytes).unwrap();
        }
        writer.finish().unwrap();
        if let Ok(loaded) = read_map_2d(&damaged, &MapLoadSettings::default())
            && write_map_2d(&loaded.into_map(Options::for_2d()), &again, true).is_ok()
        {
            prop_assert!(read_map_2d(&again, &MapLoadSettings::default()).is_ok());
        }
    }
}
