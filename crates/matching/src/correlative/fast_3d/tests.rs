use portolan_geometry::{Vector3, rotation_from_roll_pitch_yaw};
use portolan_grids::{HybridInserter, HybridInserterOptions};
use portolan_sensor::RangeData;

use super::*;
use crate::correlative::rotational_histogram;
use crate::testing::{Lcg, cloud_b, drawn_cloud_b, golden_scan_3d};

fn pose(x: f64, y: f64, z: f64, yaw: f64) -> Rigid3 {
    Rigid3::from_parts([x, y, z].into(), rotation_from_roll_pitch_yaw(0.0, 0.0, yaw))
}

#[test]
fn the_golden_node_is_found() {
    let (high, low, scan) = (drawn_cloud_b(0.1, 5), drawn_cloud_b(0.45, 5), golden_scan_3d());
    let options = FastCorrelativeOptions3d {
        branch_and_bound_depth: 6,
        min_rotational_score: 0.3,
        min_low_resolution_score: 0.3,
        linear_xy_search_window: 2.0,
        linear_z_search_window: 0.8,
        angular_search_window: 0.26,
        ..Default::default()
    };
    let histograms = [rotational_histogram(&cloud_b(), 120), rotational_histogram(&scan, 120)];
    let node = NodeToFind {
        high_resolution_cloud: &scan,
        low_resolution_cloud: &scan,
        rotational_histogram: &histograms[1],
        gravity_alignment: Quaternion::identity(),
    };
    let submap = SubmapToSearch { low_resolution_grid: &low, rotational_histogram: &histograms[0] };
    for full_resolution_depth in [3, 1, 6] {
        let options = FastCorrelativeOptions3d { full_resolution_depth, ..options.clone() };
        let matcher = FastCorrelativeMatcher3d::new(&high, &options).unwrap();
        let guess = pose(1.2, 0.6, -0.3, 0.0);
        let found = matcher.match_local(&guess, &Rigid3::identity(), &node, &submap, 0.2).unwrap();
        assert!((found.found.score - 0.608_290_2).abs() < 1e-6, "{found:?}");
        assert!((found.rotational_score - 0.977_870_17).abs() < 1e-5, "{found:?}");
        assert!((found.low_resolution_score - 0.724_005_2).abs() < 1e-5, "{found:?}");
        let translation = found.found.pose.translation.vector;
        assert!((translation - Vector3::new(0.4, -0.3, 0.1)).norm() < 1e-6, "{found:?}");
        let q = found.found.pose.rotation;
        assert!((q.w - 0.998_678_92).abs() < 1e-6 && (q.k - 0.051_385_485).abs() < 1e-6, "{found:?}");
    }
}

/// Twelve points on the three axes, no two at the same distance.
fn star() -> PointCloud {
    let points = [
        (4.0, 0.0, 0.0),
        (4.5, 0.0, 0.0),
        (5.0, 0.0, 0.0),
        (5.5, 0.0, 0.0),
        (0.0, 4.0, 0.0),
        (0.0, 4.5, 0.0),
        (0.0, 5.0, 0.0),
        (0.0, 5.5, 0.0),
        (0.0, 0.0, 4.0),
        (0.0, 0.0, 4.5),
        (0.0, 0.0, 5.0),
        (0.0, 0.0, 5.5),
    ];
    PointCloud::new(points.iter().map(|p| Point3f::new(p.0, p.1, p.2)).collect())
}

fn star_grid(resolution: f32, pose: &Rigid3) -> HybridGrid {
    let inserter = HybridInserter::new(&HybridInserterOptions {
        hit_probability: 0.7,
        miss_probability: 0.4,
        num_free_space_voxels: 5,
        ..Default::default()
    })
    .unwrap();
    let mut grid = HybridGrid::new(resolution).unwrap();
    let pose = to_f32(pose);
    let data = RangeData {
        origin: Point3f::from(pose.translation.vector),
        returns: star().transformed(&pose),
        misses: PointCloud::default(),
    };
    inserter.insert(&data, f32::INFINITY, &mut grid, None).unwrap();
    grid
}

#[test]
fn perturbed_poses_are_found() {
    let options = FastCorrelativeOptions3d {
        branch_and_bound_depth: 6,
        full_resolution_depth: 6,
        min_rotational_score: 0.1,
        min_low_resolution_score: 0.15,
        linear_xy_search_window: 0.8,
        linear_z_search_window: 0.8,
        angular_search_window: 0.3,
    };
    let (cloud, zero) = (star(), [0.0; 10]);
    let far = PointCloud::new(vec![Point3f::new(42.0, 42.0, 42.0)]);
    let mut lcg = Lcg::new(42);
    for round in 0..20 {
        let [x, y, z] = [0; 3].map(|_| f64::from(lcg.symmetric(0.7)));
        let expected = pose(x, y, z, f64::from(lcg.symmetric(0.2)));
        let grid = star_grid(0.05, &expected);
        let matcher = FastCorrelativeMatcher3d::new(&grid, &options).unwrap();
        let submap = SubmapToSearch { low_resolution_grid: &grid, rotational_histogram: &zero };
        let node = NodeToFind {
            high_resolution_cloud: &cloud,
            low_resolution_cloud: &cloud,
            rotational_histogram: &zero,
            gravity_alignment: Quaternion::identity(),
        };
        let (identity, level) = (Rigid3::identity(), Quaternion::identity());
        let far_node = NodeToFind { low_resolution_cloud: &far, ..node };
        let local = |node| matcher.match_local(&identity, &identity, node, &submap, 0.1);
        let full = |node| matcher.match_full(&level, &level, node, &submap, 0.1);
        // The search of the whole submap takes long at so low a score.
        let mut all = vec![local(&node)];
        if round < 4 {
            all.push(full(&node));
        }
        if round < 2 {
            assert!(local(&far_node).is_none() && full(&far_node).is_none());
        }
        for found in all {
            let found = found.unwrap();
            assert!(found.found.score > 0.1 && found.rotational_score > 0.09, "{found:?}");
            assert!(found.low_resolution_score > 0.14, "{found:?}");
            let error = found.found.pose.inverse() * expected;
            assert!(error.translation.vector.norm() < 0.05 && error.rotation.angle() < 0.05, "{found:?}");
        }
    }
}

/// Scores every placement.
fn exhaustive(
    matcher: &FastCorrelativeMatcher3d,
    grid: &HybridGrid,
    guess: &Rigid3,
    submap_pose: &Rigid3,
    node: &NodeToFind<'_>,
    submap: &SubmapToSearch<'_>,
) -> f32 {
    let o = &matcher.options;
    let turns = matcher.turns(guess, submap_pose, node, submap, o.angular_search_window);
    let n = |v: f64| (v / f64::from(matcher.lattice.resolution)).round() as i32;
    let (xy, z) = (n(o.linear_xy_search_window), n(o.linear_z_search_window));
    let byte = |cell| u32::from(matcher.score.byte(grid.probability(cell)));
    let mut best = 0.0f32;
    for (scan, turn) in turns.iter().enumerate().filter_map(|(i, t)| Some((i, t.as_ref()?))) {
        let points = &node.high_resolution_cloud.points;
        let cells: Vec<_> =
            points.iter().map(|p| matcher.lattice.unchecked_cell((turn.pose * p).into())).collect();
        for z in -z..=z {
            for y in -xy..=xy {
                for x in -xy..=xy {
                    let sum = cells.iter().map(|c| byte([c[0] + x, c[1] + y, c[2] + z])).sum();
                    let score = matcher.score.of(sum, points.len());
                    let placement = Placement3d { scan: scan as u32, shift: [z, y, x] };
                    let coarse = mean_probability(
                        &node.low_resolution_cloud.points,
                        &matcher.pose(&turns, placement).unwrap(),
                        submap.low_resolution_grid,
                    );
                    if f64::from(coarse) >= o.min_low_resolution_score {
                        best = best.max(score);
                    }
                }
            }
        }
    }
    best
}

#[test]
fn the_best_of_all_placements_is_found() {
    let (high, low) = (drawn_cloud_b(0.3, 3), drawn_cloud_b(0.6, 3));
    let mut lcg = Lcg::new(8);
    for round in 0..12 {
        let options = FastCorrelativeOptions3d {
            branch_and_bound_depth: 1 + round % 5,
            full_resolution_depth: 1 + round % 3,
            min_rotational_score: 0.0,
            min_low_resolution_score: if round < 8 { 0.3 } else { 0.5 },
            linear_xy_search_window: 1.5,
            linear_z_search_window: 0.6,
            angular_search_window: 0.2,
        };
        let mut scan = golden_scan_3d();
        scan.points.retain(|_| lcg.unit() < 0.02);
        let tilt = rotation_from_roll_pitch_yaw(
            f64::from(lcg.symmetric(0.2)),
            f64::from(lcg.symmetric(0.2)),
            f64::from(lcg.symmetric(3.0)),
        );
        let node = NodeToFind {
            high_resolution_cloud: &scan,
            low_resolution_cloud: &scan,
            rotational_histogram: &[],
            gravity_alignment: Quaternion::identity(),
        };
        let submap = SubmapToSearch { low_resolution_grid: &low, rotational_histogram: &[] };
        let matcher = FastCorrelativeMatcher3d::new(&high, &options).unwrap();
        let offset = [0; 3].map(|_| f64::from(lcg.symmetric(0.8)));
        let submap_pose = Rigid3::from_parts([3.0, -2.0, 1.0].into(), tilt);
        let guess = submap_pose * Rigid3::from_parts(offset.into(), Quaternion::identity());
        let best = exhaustive(&matcher, &high, &guess, &submap_pose, &node, &submap);
        let found = matcher.match_local(&guess, &submap_pose, &node, &submap, 0.1);
        assert_eq!(found.map_or(0.0, |f| f.found.score), best, "round {round}");
        assert_eq!(matcher.match_local(&guess, &submap_pose, &node, &submap, best), None);
    }
}

#[test]
fn absurd_input_finds_nothing() {
    let grid = drawn_cloud_b(0.45, 1);
    let options = FastCorrelativeOptions3d::default();
    let matcher = FastCorrelativeMatcher3d::new(&grid, &options).unwrap();
    let submap = SubmapToSearch { low_resolution_grid: &grid, rotational_histogram: &[] };
    let cloud = PointCloud::new(vec![Point3f::new(f32::NAN, 0.0, 0.0), Point3f::new(1e30, 0.0, 1e30)]);
    let node = NodeToFind {
        high_resolution_cloud: &cloud,
        low_resolution_cloud: &cloud,
        rotational_histogram: &[],
        gravity_alignment: Quaternion::identity(),
    };
    let (here, nowhere) = (Rigid3::identity(), Rigid3::translation(f64::NAN, 0.0, 0.0));
    assert_eq!(matcher.match_local(&here, &here, &node, &submap, 0.3), None);
    assert_eq!(matcher.match_local(&nowhere, &here, &node, &submap, 0.3), None);
    assert_eq!(matcher.match_local(&here, &here, &node, &submap, f32::NAN), None);
    let empty = PointCloud::default();
    let node = NodeToFind { high_resolution_cloud: &empty, ..node };
    assert_eq!(matcher.match_full(&here.rotation, &here.rotation, &node, &submap, 0.3), None);
    let unknown = HybridGrid::new(0.1).unwrap();
    assert!(FastCorrelativeMatcher3d::new(&unknown, &options).is_ok());
    for depth in [0, 25] {
        let options = FastCorrelativeOptions3d { full_resolution_depth: depth, ..options.clone() };
        assert!(FastCorrelativeMatcher3d::new(&unknown, &options).is_err());
    }
}

#[test]
fn grids_with_voxels_everywhere_are_refused_in_time() {
    let (mut grid, mut lcg) = (HybridGrid::new(0.1).unwrap(), Lcg::new(3));
    for _ in 0..1_200_000 {
        grid.set_probability([0; 3].map(|_| lcg.symmetric(2300.0) as i32), 0.8);
    }
    let refused = FastCorrelativeMatcher3d::new(&grid, &FastCorrelativeOptions3d::default()).err();
    assert_eq!(refused, Some(crate::MatcherOptionError::TooManyVoxels));
}
