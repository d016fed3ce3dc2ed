//! Maps edited as documents.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use crate::common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use common::small_map::SmallMap;
use portolan_config::{ConstraintBuilderOptions, Options};
use portolan_geometry::{Rigid3, Time, Vector3, normalize_angle, project_2d};
use portolan_mapfile::{EditError, MapArea, MapDraft, MapInfo, PlacedTexture, info, load_textures};
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::mapping::{PoseGraph, TrajectoryData};
use portolan_pbstream::{MapReader, PbstreamReader, ReadLimits, Severity, pose_from_proto, validate};
use portolan_solver::g2o::Graph;
use portolan_testing::{real_data, real_maps};
use tempfile::TempDir;

fn draft(path: &Path) -> MapDraft {
    MapDraft::open(path, ReadLimits::default()).unwrap()
}

fn summary(path: &Path) -> MapInfo {
    let findings = validate(&mut PbstreamReader::open(path).unwrap());
    assert!(findings.iter().all(|f| f.severity < Severity::Error), "{findings:?}");
    info(&mut MapReader::open(path).unwrap()).unwrap()
}

fn graph(path: &Path) -> PoseGraph {
    MapReader::open(path).unwrap().pose_graph().clone()
}

fn messages(path: &Path) -> Vec<Vec<u8>> {
    PbstreamReader::open(path).unwrap().map(|m| m.unwrap().bytes).collect()
}

fn small(folder: &TempDir, three_d: bool) -> PathBuf {
    let path = folder.path().join("small.pbstream");
    SmallMap::new(three_d).write(&path);
    path
}

#[test]
fn a_map_without_edits_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("copy.pbstream");
    for path in real_maps() {
        draft(&path).write(&copy).unwrap();
        let (a, b) = (messages(&path), messages(&copy));
        // The pose graph is written anew, which changes the sign of zeros at most.
        assert!(a[..1] == b[..1] && a[2..] == b[2..] && graph(&path) == graph(&copy), "{}", path.display());
    }
}

#[test]
fn maps_are_merged_and_taken_apart() {
    let folder = tempfile::tempdir().unwrap();
    let merged = folder.path().join("merged.pbstream");
    for name in ["small_2d", "small_3d"] {
        let Some(path) = real_data(&format!("maps/reference/{name}.pbstream")) else { return };
        let one = summary(&path);
        let mut both = draft(&path);
        let pose = Rigid3::new(Vector3::new(5.0, -3.0, 0.0), Vector3::z() * 0.4);
        assert_eq!(both.append(&path, &pose).unwrap(), BTreeMap::from([(0, 1)]));
        both.write(&merged).unwrap();
        let found = summary(&merged);
        assert_eq!(found.trajectories.len(), 2);
        for (name, count) in &one.counters {
            assert_eq!(found.counters[name], 2 * count, "{name}");
        }
        let (first, second) = (&graph(&merged).trajectory[0], &graph(&merged).trajectory[1]);
        let position = |p: &Option<_>| pose_from_proto(p.as_ref()).unwrap();
        let off = position(&second.node[3].pose).inverse() * pose * position(&first.node[3].pose);
        assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-9);
        // The second one alone, under its old number and in its old place, is the first.
        let apart = folder.path().join("apart.pbstream");
        let mut second = draft(&merged);
        second.retain_trajectories(|id| id == 1);
        second.rename_trajectories(&BTreeMap::from([(1, 0)])).unwrap();
        second.write(&apart).unwrap();
        assert!(messages(&apart)[2..] == messages(&path)[2..], "{name}");
    }
    let (Some(plane), Some(space)) =
        (real_data("maps/reference/small_2d.pbstream"), real_data("maps/reference/small_3d.pbstream"))
    else {
        return;
    };
    let refused = draft(&plane).append(&space, &Rigid3::identity());
    assert!(matches!(refused, Err(EditError::Dimension(_))));
}

#[test]
fn numbers_of_trajectories() {
    let folder = tempfile::tempdir().unwrap();
    let path = small(&folder, false);
    let mut map = draft(&path);
    assert!(matches!(map.require_trajectory(3), Err(EditError::NoTrajectory { id: 3, .. })));
    map.append(&path, &Rigid3::identity()).unwrap();
    let clash = map.rename_trajectories(&BTreeMap::from([(0, 1)]));
    assert!(matches!(clash, Err(EditError::SameTrajectory(1))));
    map.rename_trajectories(&BTreeMap::from([(0, 1), (1, 0)])).unwrap();
    let out = folder.path().join("out.pbstream");
    map.write(&out).unwrap();
    assert_eq!(summary(&out).trajectories.iter().map(|t| t.id).collect::<Vec<_>>(), [0, 1]);
    let mut none = draft(&path);
    none.retain_trajectories(|_| false);
    assert!(matches!(none.write(&out), Err(EditError::Empty)));
}

#[test]
fn maps_are_cut_by_time_and_area() {
    let Some(path) = real_data("maps/reference/aces.pbstream") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.pbstream");
    let mut map = draft(&path);
    let (start, end) = map.time_span().unwrap();
    assert!((end.seconds_since(start) - 1360.0).abs() < 10.0);
    let at = |seconds: f64| start + portolan_geometry::Duration::from_seconds(seconds);
    map.cut_time(at(100.0), at(400.0)).unwrap();
    let report = map.write(&out).unwrap();
    let found = summary(&out);
    let trajectory = &found.trajectories[0];
    assert!(trajectory.duration > 280.0 && trajectory.duration <= 300.0, "{trajectory:?}");
    assert_eq!(trajectory.nodes + report.nodes_removed, 2786);
    assert_eq!(found.counters["odometry_data"] + report.sensor_messages_removed, 7374);
    // Odometry reaches beyond the first and the last node, for interpolation.
    let mut reader = MapReader::open(&out).unwrap();
    let nodes: Vec<i64> =
        reader.pose_graph().trajectory.iter().flat_map(|t| t.node.iter().map(|n| n.timestamp)).collect();
    let mut times = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        if let Data::OdometryData(data) = message.data {
            times.push(data.odometry_data.unwrap().timestamp);
        }
    }
    assert!(times[0] <= nodes[0] && times.last() >= nodes.last());

    let area = MapArea { min_x: -5.0, min_y: -5.0, max_x: 8.0, max_y: 5.0 };
    let count = |inside: bool| {
        let mut map = draft(&path);
        map.cut_area(&area, inside).unwrap();
        map.write(&out).unwrap();
        summary(&out).trajectories[0].nodes
    };
    let (inside, outside) = (count(true), count(false));
    assert!(inside > 50 && outside > 2000 && inside + outside <= 2786, "{inside} {outside}");
    assert!(matches!(draft(&path).cut_time(Time::MIN, at(-1.0)), Err(EditError::Empty)));
}

/// Known pixels of submaps that lie in the area, a pixel from its border.
fn known_in(area: &MapArea, path: &Path) -> usize {
    let textures = load_textures(&mut MapReader::open(path).unwrap()).unwrap().textures;
    let known_in = |placed: &PlacedTexture| {
        let texture = &placed.texture;
        let map_from_slice = placed.map_from_submap * texture.submap_from_slice;
        let (pixels, width) = (texture.pixels(), texture.width);
        let is_known_inside = |i: &usize| {
            let metres = |i: usize| -(i as f64 + 0.5) * texture.resolution;
            let p = map_from_slice * nalgebra::Point3::new(metres(i / width), metres(i % width), 0.0);
            let border = 1.5 * texture.resolution;
            pixels[*i] != [0, 0]
                && (area.min_x + border..area.max_x - border).contains(&p.x)
                && (area.min_y + border..area.max_y - border).contains(&p.y)
        };
        (0..pixels.len()).filter(is_known_inside).count()
    };
    textures.iter().map(known_in).sum()
}

#[test]
fn areas_taken_out_are_not_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.pbstream");
    for (name, area) in [
        ("aces", MapArea { min_x: -5.0, min_y: -5.0, max_x: 8.0, max_y: 5.0 }),
        ("small_tsdf", MapArea { min_x: 1.0, min_y: -20.0, max_x: 20.0, max_y: 20.0 }),
        ("small_3d", MapArea { min_x: 2.0, min_y: -20.0, max_x: 20.0, max_y: 20.0 }),
    ] {
        let Some(path) = real_data(&format!("maps/reference/{name}.pbstream")) else { return };
        assert!(known_in(&area, &path) > 100, "{name}");
        let mut map = draft(&path);
        map.cut_area(&area, false).unwrap();
        map.rename_trajectories(&BTreeMap::from([(0, 3)])).unwrap();
        let report = map.write(&out).unwrap();
        assert!(report.cells_cleared > 0, "{name}");
        assert_eq!(known_in(&area, &out), 0, "{name}");
        assert_eq!(summary(&out).trajectories[0].id, 3);
    }
}

#[test]
fn maps_that_cannot_be_cut_moved_or_optimised_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("small.pbstream"), folder.path().join("out.pbstream"));
    let changed = |change: fn(&mut SmallMap)| {
        let mut map = SmallMap::new(false);
        change(&mut map);
        map.write(&path);
        draft(&path)
    };
    // Nobody knows where the cells of such a grid are.
    let mut map = changed(|map| {
        map.submap_2d(0).grid.as_mut().unwrap().limits.as_mut().unwrap().resolution = f64::NAN;
    });
    map.cut_area(&MapArea { min_x: 50.0, min_y: 50.0, max_x: 51.0, max_y: 51.0 }, false).unwrap();
    let error = map.write(&out).unwrap_err().to_string();
    assert!(error.contains("submap 0,0 cannot be cut") && error.contains("`repair`"), "{error}");
    // Marked cells are as good as others.
    let mut map = changed(|map| {
        let cells = &mut map.submap_2d(0).grid.as_mut().unwrap().cells;
        cells
            .iter_mut()
            .filter(|cell| **cell > 0 && **cell < 32_768)
            .take(1)
            .for_each(|cell| *cell += 32_768);
    });
    map.cut_area(&MapArea { min_x: 50.0, min_y: 50.0, max_x: 51.0, max_y: 51.0 }, false).unwrap();
    map.write(&out).unwrap();
    std::fs::remove_file(&out).unwrap();
    let error = changed(|_| {}).transform(&Rigid3::translation(1e300, 0.0, 0.0)).unwrap_err();
    assert!(matches!(error, EditError::TooFar), "{error}");
    let mut map = changed(|map| {
        let pose = map.graph.constraint[0].relative_pose.as_mut().unwrap();
        pose.translation.as_mut().unwrap().x = 1e300;
    });
    let error = map.optimize(&Options::for_2d(), 10).unwrap_err();
    assert!(matches!(error, EditError::Optimization(_)), "{error}");
    assert!(!out.exists());
}

#[test]
fn submaps_that_are_missing_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("small.pbstream");
    let mut map = SmallMap::new(false);
    map.rest.retain(|data| !matches!(data, Data::Submap(_)));
    let submaps: usize = map.graph.trajectory.iter().map(|t| t.submap.len()).sum();
    map.write(&path);
    let loaded = load_textures(&mut MapReader::open(&path).unwrap()).unwrap();
    assert_eq!((loaded.textures.len(), loaded.skipped.len()), (0, submaps));
}

#[test]
fn loops_are_dropped_found_again_and_optimised() {
    let Some(path) = real_data("maps/reference/aces.pbstream") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.pbstream");
    let mut map = draft(&path);
    let residuals = map.loop_residuals();
    assert_eq!(residuals.len() as u64, summary(&path).constraints.inter_submap);
    let options = ConstraintBuilderOptions { global_localization_min_score: 0.5, ..Default::default() };
    let (good, found) = residuals
        .iter()
        .rev()
        .take(10)
        .find_map(|good| Some((*good, map.find_loop(good.submap, good.node, &options).ok()?)))
        .unwrap();
    map.drop_loop(good.submap, good.node).unwrap();
    assert!(matches!(map.drop_loop(good.submap, good.node), Err(EditError::NoLoop { .. })));
    let weights = map.loop_weights();
    map.add_loop(good.submap, good.node, &found.submap_from_node, weights).unwrap();
    let again = map.loop_residuals().into_iter().find(|r| (r.submap, r.node) == (good.submap, good.node));
    assert!(again.unwrap().translation < good.translation + 0.1, "{again:?} {good:?}");
    let missing = map.add_loop((0, 9999), good.node, &found.submap_from_node, weights);
    let message = missing.unwrap_err().to_string();
    assert!(message.contains("there is no submap 0,9999 in the map; there are 0,0 to 0,"), "{message}");
    let strict = ConstraintBuilderOptions { global_localization_min_score: 0.999, ..Default::default() };
    let message = map.find_loop(good.submap, good.node, &strict).unwrap_err().to_string();
    assert!(message.contains("at best, and 0.999 is needed"), "{message}");
    let dropped = map.drop_loops_beyond(1.0, f64::INFINITY);
    assert!(dropped > 0 && map.loop_residuals()[0].translation <= 1.0);
    let done = map.optimize(&Options::for_2d(), 50).unwrap();
    assert!(done.final_cost < done.initial_cost && done.nodes == 2786, "{done:?}");
    map.write(&out).unwrap();
    summary(&out);
}

#[test]
fn optimising_a_consistent_map_in_3d_changes_it_little() {
    let Some(path) = real_data("maps/reference/corridor_imu.pbstream") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.pbstream");
    let mut map = draft(&path);
    let done = map.optimize(&Options::for_3d(), 200).unwrap();
    assert!(done.final_cost <= done.initial_cost && done.nodes == 727, "{done:?}");
    assert!(done.largest_move < 0.2, "{done:?}");
    map.write(&out).unwrap();
    let gravity = summary(&out).trajectories[0].gravity_constant.unwrap();
    assert!((gravity - 9.8).abs() < 0.2, "{gravity}");
}

#[test]
fn loops_in_3d_are_found() {
    let Some(path) = real_data("maps/reference/corridor_imu.pbstream") else { return };
    let map = draft(&path);
    let options = ConstraintBuilderOptions { global_localization_min_score: 0.4, ..Default::default() };
    let good = *map.loop_residuals().last().unwrap();
    let found = map.find_loop(good.submap, good.node, &options).unwrap();
    let measured = map.pose_graph().constraint.iter().find(|c| {
        c.tag == 1
            && c.submap_id.map(|id| (id.trajectory_id, id.submap_index)) == Some(good.submap)
            && c.node_id.map(|id| (id.trajectory_id, id.node_index)) == Some(good.node)
    });
    let measured = pose_from_proto(measured.unwrap().relative_pose.as_ref()).unwrap();
    let off = measured.inverse() * found.submap_from_node;
    assert!(off.translation.vector.norm() < 0.3 && off.rotation.angle() < 0.05, "{off} {found:?}");
}

#[test]
fn the_map_moves_as_a_whole() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (small(&folder, false), folder.path().join("out.pbstream"));
    let turn = Rigid3::new(Vector3::new(1.0, 2.0, 0.0), Vector3::z());
    let mut map = draft(&path);
    map.transform(&turn).unwrap();
    assert!(map.loop_residuals()[0].translation < 1e-12);
    map.write(&out).unwrap();
    let moved = pose_from_proto(graph(&out).trajectory[0].node[2].pose.as_ref()).unwrap();
    let expected = turn * Rigid3::translation(2.0, 0.0, 0.0);
    assert!((moved.inverse() * expected).translation.vector.norm() < 1e-12);
    let tilt = Rigid3::new(Vector3::zeros(), Vector3::x());
    assert!(matches!(draft(&path).transform(&tilt), Err(EditError::Dimension(_))));
    draft(&small(&folder, true)).transform(&tilt).unwrap();
}

#[test]
fn fixed_frames_move_with_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("in.pbstream"), folder.path().join("out.pbstream"));
    let mut map = SmallMap::new(false);
    map.rest.push(Data::TrajectoryData(TrajectoryData {
        gravity_constant: 9.8,
        fixed_frame_origin_in_map: common::small_map::pose(0.5),
        ..TrajectoryData::default()
    }));
    map.write(&path);
    let origin = |path: &Path| {
        let mut reader = MapReader::open(path).unwrap();
        while let Some(message) = reader.next_message().unwrap() {
            if let Data::TrajectoryData(data) = message.data {
                return pose_from_proto(data.fixed_frame_origin_in_map.as_ref()).unwrap();
            }
        }
        panic!("no trajectory data");
    };
    let turn = Rigid3::new(Vector3::new(1.0, 2.0, 0.0), Vector3::z());
    for optimise in [false, true] {
        let mut map = draft(&path);
        if optimise {
            map.optimize(&Options::for_2d(), 5).unwrap();
        }
        map.transform(&turn).unwrap();
        map.rename_trajectories(&BTreeMap::from([(0, 2)])).unwrap();
        map.write(&out).unwrap();
        let off = origin(&out).inverse() * turn * Rigid3::translation(0.5, 0.0, 0.0);
        assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-9, "{off}");
    }
}

#[test]
fn walls_of_a_turned_map_turn_with_it() {
    let Some(path) = real_data("maps/wild/SDBArrow_AGV_map.pbstream") else { return };
    let mut map = draft(&path);
    let before = map.walls().unwrap();
    map.transform(&Rigid3::new(Vector3::zeros(), Vector3::z() * 0.3)).unwrap();
    let after = map.walls().unwrap();
    let off = (after.angle - before.angle - 0.3).rem_euclid(std::f64::consts::FRAC_PI_2);
    assert!(off.min(std::f64::consts::FRAC_PI_2 - off) < 0.01, "{before:?} {after:?}");
}

#[test]
fn poses_are_exported_and_imported() {
    for name in ["small_2d", "small_3d"] {
        let Some(path) = real_data(&format!("maps/reference/{name}.pbstream")) else { return };
        let mut map = draft(&path);
        let exported = map.to_graph().unwrap();
        if let Graph::TwoD(graph) = &exported {
            let nodes = &map.pose_graph().trajectory[0].node;
            let vertices = graph.vertices.iter().rev().zip(nodes.iter().rev());
            for (vertex, node) in vertices {
                let pose = project_2d(&pose_from_proto(node.pose.as_ref()).unwrap());
                let off = (pose.inverse() * vertex.pose).angle;
                assert!(normalize_angle(off).abs() < 0.01, "{name}: off by {off} rad");
            }
        }
        map.take_graph_poses(&exported).unwrap();
        let (before, after) = (graph(&path), map.pose_graph().clone());
        for (a, b) in before.trajectory[0].node.iter().zip(&after.trajectory[0].node) {
            let pose = |p: &Option<_>| pose_from_proto(p.as_ref()).unwrap();
            let off = pose(&a.pose).inverse() * pose(&b.pose);
            assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6, "{name}");
        }
        let other = match exported {
            Graph::TwoD(_) => Graph::ThreeD(Default::default()),
            Graph::ThreeD(_) => Graph::TwoD(Default::default()),
        };
        assert!(matches!(map.take_graph_poses(&other), Err(EditError::Poses(_))));
        let shift = Rigid3::translation(3.0, 0.0, 0.0);
        let poses: Vec<(Time, Rigid3)> = before.trajectory[0].node[5..20]
            .iter()
            .map(|n| (Time::from_ticks(n.timestamp), shift * pose_from_proto(n.pose.as_ref()).unwrap()))
            .collect();
        let done = map.replace_trajectory(0, &poses).unwrap();
        assert_eq!(done.nodes, 15);
        assert_eq!(done.nodes_moved_along as usize, before.trajectory[0].node.len() - 15);
        assert!(map.replace_trajectory(0, &[]).is_err());
    }
}
