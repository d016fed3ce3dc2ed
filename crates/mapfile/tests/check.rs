//! Findings in good and in bad maps, and their repair.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use crate::common;

use common::small_map::SmallMap;
use portolan_mapfile::{Repair, RepairError, RepairReport, info, repair};
use portolan_pbstream::proto::mapping::serialized_data::Data;
use portolan_pbstream::{FindingKind, MapReader, PbstreamReader, RawMessage, ReadLimits, Severity, validate};
use portolan_testing::real_maps;
use proptest::prelude::*;
use std::path::Path;

fn messages(path: &Path) -> Vec<Vec<u8>> {
    let read: Result<Vec<RawMessage>, _> = PbstreamReader::open(path).unwrap().collect();
    read.unwrap().into_iter().map(|m| m.bytes).collect()
}

#[test]
fn real_maps_have_no_errors_and_need_no_repair() {
    let folder = tempfile::tempdir().unwrap();
    let repaired = folder.path().join("repaired.pbstream");
    for path in real_maps() {
        let findings = validate(&mut PbstreamReader::open(&path).unwrap());
        assert!(findings.iter().all(|f| f.severity < Severity::Error), "{}: {findings:?}", path.display());
        let report = repair(&path, &repaired, ReadLimits::default()).unwrap();
        assert!(report.repairs.is_empty(), "{}: {report:?}", path.display());
        assert!(messages(&path) == messages(&repaired), "{}", path.display());
    }
}

/// Damages a small map; returns what is found, what was repaired, and checks that then all is well.
fn damaged(three_d: bool, damage: impl FnOnce(&mut SmallMap)) -> (Vec<FindingKind>, RepairReport) {
    let folder = tempfile::tempdir().unwrap();
    let (path, repaired) = (folder.path().join("map.pbstream"), folder.path().join("repaired.pbstream"));
    let mut map = SmallMap::new(three_d);
    damage(&mut map);
    map.write(&path);
    let findings = validate(&mut PbstreamReader::open(&path).unwrap());
    let kinds = findings.iter().map(|f| f.kind).collect();
    let report = repair(&path, &repaired, ReadLimits::default()).unwrap();
    let left = validate(&mut PbstreamReader::open(&repaired).unwrap());
    assert!(left.iter().all(|f| f.severity < Severity::Error), "{left:?}");
    info(&mut MapReader::open(&repaired).unwrap()).unwrap();
    (kinds, report)
}

fn repairs(report: &RepairReport) -> Vec<(Repair, u64)> {
    report.repairs.iter().map(|(r, n)| (*r, *n)).collect()
}

#[test]
fn a_small_good_map_is_good() {
    for three_d in [false, true] {
        let (findings, report) = damaged(three_d, |_| {});
        assert_eq!((findings, repairs(&report), report.messages), (vec![], vec![], 11));
    }
}

#[test]
fn impossible_grids_are_found() {
    let (found, report) = damaged(false, |map| map.submap_2d(0).grid.as_mut().unwrap().cells.truncate(5));
    assert_eq!(found, [FindingKind::Grid]);
    assert_eq!(
        repairs(&report),
        [(Repair::SubmapDropped, 1), (Repair::SubmapPoseDropped, 1), (Repair::ConstraintDropped, 2)]
    );
    assert!(report.loses_data());
    let (found, report) = damaged(false, |map| {
        let grid = map.submap_2d(1).grid.as_mut().unwrap();
        grid.cells[0] = -3;
        grid.cells[1] = 40000;
        grid.known_cells_box.as_mut().unwrap().max_x = 7;
    });
    assert_eq!(found, [FindingKind::Grid, FindingKind::Grid]);
    assert_eq!(repairs(&report), [(Repair::CellsMended, 1)]);
    let (found, report) = damaged(true, |map| {
        map.submap_3d(1).high_resolution_hybrid_grid.as_mut().unwrap().x_indices[1] = 9000;
        map.submap_3d(0).low_resolution_hybrid_grid.as_mut().unwrap().values.pop();
    });
    assert_eq!(found, [FindingKind::Grid, FindingKind::Grid]);
    assert_eq!(report.repairs[&Repair::CellsMended], 1);
    assert_eq!(report.repairs[&Repair::SubmapDropped], 1);
}

#[test]
fn maps_that_other_programs_cannot_optimise_are_found() {
    let (found, report) = damaged(true, |map| map.rest.retain(|d| !matches!(d, Data::ImuData(_))));
    assert_eq!(found, [FindingKind::Imu]);
    assert!(!report.loses_data() && report.repairs.keys().eq([&Repair::ImuDerived]), "{report:?}");
    let (found, report) = damaged(false, |map| map.graph.constraint.clear());
    assert_eq!(found, [FindingKind::Unconstrained]);
    assert!(report.repairs.is_empty(), "{report:?}");
}

#[test]
fn places_beyond_the_earth_are_found() {
    let (found, report) = damaged(false, |map| {
        let node = map.graph.trajectory[0].node[1].pose.as_mut().unwrap();
        node.translation.get_or_insert_default().x = 1e12;
    });
    assert_eq!(found, [FindingKind::FarAway]);
    assert!(report.repairs.is_empty(), "{report:?}");
}

#[test]
fn impossible_poses_are_found() {
    let (found, report) = damaged(false, |map| {
        let node = map.graph.trajectory[0].node[1].pose.as_mut().unwrap();
        node.translation.as_mut().unwrap().x = f64::NAN;
        let constraint = map.graph.constraint[0].relative_pose.as_mut().unwrap();
        constraint.rotation.as_mut().unwrap().w = 1.01;
        map.node(2).gravity_alignment = None;
        map.node(0).local_pose.as_mut().unwrap().rotation.as_mut().unwrap().w = 0.9;
    });
    assert_eq!(found, [FindingKind::Pose; 4]);
    assert_eq!(
        repairs(&report),
        [
            (Repair::NodeDropped, 2),
            (Repair::NodePoseDropped, 2),
            (Repair::ConstraintDropped, 2),
            (Repair::QuaternionNormalised, 2)
        ]
    );
}

#[test]
fn ids_and_constraints_must_fit() {
    let (found, report) = damaged(false, |map| {
        map.graph.constraint[1].node_id.as_mut().unwrap().node_index = 77;
        map.graph.constraint[2].translation_weight = -1.0;
        let again = map.rest[0].clone();
        map.rest.push(again);
        map.rest.remove(4);
    });
    assert_eq!(
        found,
        [
            FindingKind::Constraint,
            FindingKind::Constraint,
            FindingKind::DuplicateId,
            FindingKind::MissingPart
        ]
    );
    assert_eq!(
        repairs(&report),
        [(Repair::SubmapDropped, 1), (Repair::NodePoseDropped, 1), (Repair::ConstraintDropped, 2)]
    );
}

#[test]
fn order_options_and_times_are_checked() {
    let (found, report) = damaged(false, |map| {
        map.options.options_with_sensor_ids.clear();
        map.rest.swap(5, 7);
        map.rest.insert(1, Data::PoseGraph(map.graph.clone()));
        map.node(1).timestamp = 5;
    });
    assert_eq!(
        found,
        [FindingKind::Order, FindingKind::Time, FindingKind::Time, FindingKind::Time, FindingKind::Options]
    );
    assert_eq!(report.repairs[&Repair::OptionsMade], 1);
    assert_eq!(report.repairs[&Repair::MessageDropped], 1);
    assert_eq!(report.repairs[&Repair::SensorDataDropped], 2);
}

#[test]
fn clouds_and_histograms_are_checked() {
    let (found, report) = damaged(true, |map| {
        map.node(0).filtered_gravity_aligned_point_cloud.as_mut().unwrap().num_points = 9;
        map.node(1).rotational_scan_matcher_histogram[3] = f32::NAN;
        map.submap_3d(1).rotational_scan_matcher_histogram[0] = f32::INFINITY;
    });
    assert_eq!(found, [FindingKind::Histogram, FindingKind::PointCloud, FindingKind::Histogram]);
    assert_eq!(repairs(&report), [(Repair::PointCloudDropped, 1), (Repair::HistogramDropped, 2)]);
}

#[test]
fn many_findings_are_counted() {
    let (found, _) = damaged(false, |map| {
        for _ in 0..50 {
            map.graph.constraint.push(Default::default());
        }
    });
    // Every one has an invalid pose; the constraints to submap (0, 0) and node (0, 0) are otherwise fine.
    assert_eq!(found.len(), 21);
}

#[test]
fn lost_parts_are_recomputed() {
    let folder = tempfile::tempdir().unwrap();
    let (path, repaired) = (folder.path().join("map.pbstream"), folder.path().join("repaired.pbstream"));
    SmallMap::new(false).write(&path);
    let bytes = std::fs::read(&path).unwrap();
    let sizes = records(&bytes);
    // Without header, pose graph and options.
    let cut = [&bytes[..8], &bytes[sizes[3]..]].concat();
    std::fs::write(&path, cut).unwrap();
    let report = repair(&path, &repaired, ReadLimits::default()).unwrap();
    assert_eq!(
        repairs(&report),
        [(Repair::HeaderMade, 1), (Repair::PoseGraphMade, 1), (Repair::OptionsMade, 1)]
    );
    let left = validate(&mut PbstreamReader::open(&repaired).unwrap());
    assert!(left.iter().all(|f| f.kind == FindingKind::Unconstrained), "{left:?}");
    assert_eq!(messages(&repaired).len(), 11);
    std::fs::write(&path, vec![7; 100_000]).unwrap();
    assert!(matches!(repair(&path, &repaired, ReadLimits::default()), Err(RepairError::Nothing)));
}

/// Where the records start.
fn records(bytes: &[u8]) -> Vec<usize> {
    let mut starts = vec![8];
    while let Some(size) = bytes[*starts.last().unwrap()..].first_chunk::<8>() {
        starts.push(starts.last().unwrap() + 8 + u64::from_le_bytes(*size) as usize);
    }
    starts
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn repair_survives_anything(
        at in any::<prop::sample::Index>(), length in 0..300usize, junk in prop::collection::vec(any::<u8>(), 0..40)
    ) {
        let folder = tempfile::tempdir().unwrap();
        let (path, repaired) = (folder.path().join("map.pbstream"), folder.path().join("repaired.pbstream"));
        SmallMap::new(true).write(&path);
        let mut bytes = std::fs::read(&path).unwrap();
        let start = at.index(bytes.len());
        let end = (start + length).min(bytes.len());
        let starts = records(&bytes);
        bytes.splice(start..end, junk.iter().copied());
        std::fs::write(&path, &bytes).unwrap();
        if let Ok(mut reader) = PbstreamReader::open(&path) {
            let _ = validate(&mut reader);
        }
        match repair(&path, &repaired, ReadLimits::default()) {
            Ok(_) => {
                let left = validate(&mut PbstreamReader::open(&repaired).unwrap());
                prop_assert!(left.iter().all(|f| f.severity < Severity::Error), "{:?}", left);
                // Everything before the damage is there (its parts may hang on what was lost).
                let whole = starts.iter().filter(|s| **s <= start).count() as u64;
                if start > starts[3] && end < starts[5] {
                    prop_assert!(messages(&repaired).len() as u64 + 2 >= whole);
                }
            }
            Err(RepairError::Nothing) => {}
            Err(error) => prop_assert!(false, "{}", error),
        }
    }
}
