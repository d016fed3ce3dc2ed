//! Every tool on maps in which one message says anything: no panic, and what repair leaves is good.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use crate::common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use common::small_map::{SmallMap, pose};
use portolan_config::Options;
use portolan_geometry::{Dimension, Rigid3, Time};
use portolan_mapfile::{
    MapArea, MapDraft, MigrateOptions, PaintOptions, info, load_textures, migrate, paint, repair,
};
use portolan_pbstream::proto::mapping as m;
use portolan_pbstream::proto::mapping::grid2_d::Grid;
use portolan_pbstream::proto::mapping::pose_graph::LandmarkPose;
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::proto::sensor;
use portolan_pbstream::{
    MapReader, MessageKind, PbstreamReader, PbstreamWriter, RawMessage, ReadLimits, Severity, validate,
};
use proptest::prelude::*;

/// What kind of submaps the map has.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Probability,
    Tsdf,
    HybridGrid,
}

/// A small map that has every kind of message.
fn whole_map(kind: Kind) -> SmallMap {
    let mut map = SmallMap::new(kind == Kind::HybridGrid);
    if kind == Kind::Tsdf {
        for i in 0..2 {
            let grid = map.submap_2d(i).grid.as_mut().unwrap();
            let weight_cells = grid.cells.clone();
            grid.grid =
                Some(Grid::Tsdf2d(m::Tsdf2d { truncation_distance: 0.3, max_weight: 10.0, weight_cells }));
        }
    }
    let imu = |i: i64| sensor::ImuData { timestamp: 1000 + i, ..sensor::ImuData::default() };
    let fixed = |i: i64| sensor::FixedFramePoseData { timestamp: 1000 + i, pose: pose(0.1) };
    let seen = sensor::landmark_data::LandmarkObservation {
        id: b"door".to_vec(),
        landmark_to_tracking_transform: pose(2.0),
        translation_weight: 10.0,
        rotation_weight: 1.0,
    };
    let landmarks = sensor::LandmarkData { timestamp: 1001, landmark_observations: vec![seen] };
    map.graph.landmark_poses.push(LandmarkPose { landmark_id: "door".to_owned(), global_pose: pose(2.0) });
    map.rest.push(Data::TrajectoryData(m::TrajectoryData {
        gravity_constant: 9.8,
        fixed_frame_origin_in_map: pose(0.5),
        ..m::TrajectoryData::default()
    }));
    for i in 0..2 {
        map.rest.push(Data::ImuData(m::ImuData {
            trajectory_id: 0,
            imu_data: Some(imu(i)),
            derived_from_poses: false,
        }));
        let fixed_frame_pose_data = Some(fixed(2 * i));
        map.rest.push(Data::FixedFramePoseData(m::FixedFramePoseData {
            trajectory_id: 0,
            fixed_frame_pose_data,
        }));
    }
    map.rest.push(Data::LandmarkData(m::LandmarkData { trajectory_id: 0, landmark_data: Some(landmarks) }));
    map
}

fn messages(path: &Path) -> Vec<RawMessage> {
    PbstreamReader::open(path).unwrap().collect::<Result<_, _>>().unwrap()
}

fn write(path: &Path, messages: &[RawMessage]) {
    let mut writer = PbstreamWriter::create(path).unwrap();
    messages.iter().for_each(|m| writer.write_bytes(m.bytes.clone()).unwrap());
    writer.finish().unwrap();
}

/// Everything that reads maps. Errors are fine, panics are not.
fn use_every_tool(path: &Path, folder: &Path) {
    let out = folder.join("out.pbstream");
    if let Ok(mut reader) = MapReader::open(path) {
        drop(info(&mut reader));
    }
    if let Ok(textures) = MapReader::open(path).and_then(|mut reader| load_textures(&mut reader)) {
        let options = PaintOptions { max_pixels: 1 << 20, ..PaintOptions::default() };
        drop(paint(&textures.textures, &options));
    }
    drop(migrate(path, &out, MigrateOptions::default()));
    for raw in messages(path) {
        drop(raw.to_text());
    }
    let Ok(mut draft) = MapDraft::open(path, ReadLimits::default()) else { return };
    drop(draft.append(path, &Rigid3::translation(1.0, 2.0, 0.0)));
    draft.loop_residuals();
    draft.drop_loops_beyond(0.3, 0.1);
    if draft.dimension() != Some(Dimension::ThreeD) {
        drop(draft.find_loop((0, 0), (0, 2), &Default::default()));
    }
    drop(draft.walls());
    drop(draft.to_graph());
    drop(draft.optimize(&Options::default(), 3));
    drop(draft.cut_time(Time::from_ticks(1000), Time::from_ticks(1001)));
    drop(draft.cut_area(&MapArea { min_x: -1.0, min_y: -1.0, max_x: 0.5, max_y: 1.0 }, false));
    drop(draft.rename_trajectories(&BTreeMap::from([(0, 7)])));
    drop(draft.write(&out));
}

/// Repairs; what is left must have no errors and open in every tool.
fn repaired_is_good(path: &Path, folder: &Path) -> Result<(), TestCaseError> {
    let repaired: PathBuf = folder.join("repaired.pbstream");
    if repair(path, &repaired, ReadLimits::default()).is_err() {
        return Ok(());
    }
    let left = validate(&mut PbstreamReader::open(&repaired).unwrap());
    let errors: Vec<_> = left.iter().filter(|f| f.severity == Severity::Error).collect();
    prop_assert!(errors.is_empty(), "{errors:?}");
    prop_assert!(MapDraft::open(&repaired, ReadLimits::default()).is_ok());
    let mut reader = MapReader::open(&repaired).unwrap();
    prop_assert!(info(&mut reader).is_ok());
    Ok(())
}

#[test]
fn the_map_has_every_kind_of_message_and_is_good() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.pbstream");
    for kind in [Kind::Probability, Kind::Tsdf, Kind::HybridGrid] {
        whole_map(kind).write(&path);
        let kinds: std::collections::BTreeSet<MessageKind> =
            messages(&path).iter().map(RawMessage::kind).collect();
        assert_eq!(kinds.len(), 10, "{kinds:?}");
        let findings = validate(&mut PbstreamReader::open(&path).unwrap());
        assert!(findings.is_empty(), "{findings:?}");
        use_every_tool(&path, folder.path());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// One message, flipped or cut.
    #[test]
    fn damaged_messages(
        kind in prop_oneof![Just(Kind::Probability), Just(Kind::Tsdf), Just(Kind::HybridGrid)],
        which in 0..17_usize,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in prop::option::weighted(0.2, any::<prop::sample::Index>()),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.pbstream");
        whole_map(kind).write(&path);
        let mut all = messages(&path);
        let which = which % all.len();
        let bytes = &mut all[which].bytes;
        let length = bytes.len();
        for (at, mask) in flips.iter().filter(|_| length > 0) {
            bytes[at.index(length)] ^= mask;
        }
        bytes.truncate(cut.filter(|_| length > 0).map_or(length, |c| c.index(length)));
        write(&path, &all);
        validate(&mut PbstreamReader::open(&path).unwrap());
        use_every_tool(&path, folder.path());
        repaired_is_good(&path, folder.path())?;
    }

    /// Messages left out, doubled and in another order.
    #[test]
    fn shuffled_messages(order in prop::collection::vec(0..17_usize, 1..20), is_3d in any::<bool>()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.pbstream");
        whole_map(if is_3d { Kind::HybridGrid } else { Kind::Probability }).write(&path);
        let all = messages(&path);
        let shuffled: Vec<RawMessage> = order.iter().map(|i| all[i % all.len()].clone()).collect();
        write(&path, &shuffled);
        validate(&mut PbstreamReader::open(&path).unwrap());
        use_every_tool(&path, folder.path());
        repaired_is_good(&path, folder.path())?;
    }
}

#[test]
fn numbers_at_their_ends() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.pbstream");
    type Change = fn(&mut SmallMap);
    let changes: [Change; 9] = [
        |map| map.graph.trajectory[0].node[1].timestamp = i64::MIN,
        |map| map.graph.trajectory[0].node[0].timestamp = i64::MAX,
        |map| map.graph.trajectory[0].node[0].pose = pose(1e300),
        |map| map.graph.trajectory[0].submap[1].pose = pose(-1e12),
        |map| map.graph.trajectory[0].trajectory_id = i32::MAX,
        |map| map.graph.trajectory[0].node[2].node_index = i32::MIN,
        |map| map.graph.constraint[0].translation_weight = 1e308,
        |map| {
            let limits = map.submap_2d(0).grid.as_mut().unwrap().limits.as_mut().unwrap();
            limits.cell_limits = Some(m::CellLimits { num_x_cells: 46341, num_y_cells: 46341 });
        },
        |map| {
            let limits = map.submap_2d(0).grid.as_mut().unwrap().limits.as_mut().unwrap();
            (limits.resolution, limits.max.as_mut().unwrap().x) = (1e300, 1e300);
        },
    ];
    for change in changes {
        let mut map = whole_map(Kind::Probability);
        change(&mut map);
        map.write(&path);
        validate(&mut PbstreamReader::open(&path).unwrap());
        use_every_tool(&path, folder.path());
        repaired_is_good(&path, folder.path()).unwrap();
    }
    let mut map = whole_map(Kind::HybridGrid);
    let grid = map.submap_3d(0).high_resolution_hybrid_grid.as_mut().unwrap();
    grid.x_indices = vec![i32::MIN, i32::MAX, 0];
    map.write(&path);
    use_every_tool(&path, folder.path());
    repaired_is_good(&path, folder.path()).unwrap();
}
