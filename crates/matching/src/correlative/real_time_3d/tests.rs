use portolan_geometry::{Vector3, quaternion_from_angle_axis};
use portolan_grids::{HybridInserter, HybridInserterOptions};

use super::*;
use crate::testing::{Lcg, drawn_cloud_b, golden_initial_3d, golden_scan_3d};
use portolan_sensor::RangeData;

#[test]
fn the_golden_scan_is_matched() {
    let options = RealTimeCorrelativeOptions {
        linear_search_window: 0.15,
        angular_search_window: 0.0175,
        ..Default::default()
    };
    let matcher = RealTimeCorrelativeMatcher3d::new(&options).unwrap();
    let grid = drawn_cloud_b(0.1, 5);
    let found = matcher.match_scan(&golden_initial_3d(), &golden_scan_3d(), &grid).unwrap();
    assert!((found.score - 0.400_433_15).abs() < 1e-5, "{found:?}");
    let golden = Vector3::new(0.409_041_822, -0.309_115_559, 0.149_097_964);
    assert!((found.pose.translation.vector - golden).norm() < 1e-5, "{found:?}");
    let golden = na::Quaternion::new(0.998704791, -0.00318153459, -0.00215967163, 0.0507352315);
    assert!((found.pose.rotation.quaternion() - golden).norm() < 1e-6, "{found:?}");
}

/// Seven points seen from one metre beside the position from which they were inserted.
#[test]
fn small_errors_are_corrected() {
    let places = [
        (-3.0, 2.0, 0.0),
        (-4.0, 2.0, 0.0),
        (-5.0, 2.0, 0.0),
        (-6.0, 2.0, 0.0),
        (-6.0, 3.0, 1.0),
        (-6.0, 4.0, 2.0),
        (-7.0, 3.0, 1.0),
    ];
    let returns = PointCloud::new(places.iter().map(|p| Point3f::new(p.0, p.1, p.2)).collect());
    let cloud = PointCloud::new(returns.points.iter().map(|p| p + Vector3::x().cast::<f32>()).collect());
    let mut grid = HybridGrid::new(0.1).unwrap();
    let data = RangeData { returns, ..Default::default() };
    let inserter = HybridInserter::new(&HybridInserterOptions::default()).unwrap();
    inserter.insert(&data, f32::INFINITY, &mut grid, None).unwrap();
    let options = RealTimeCorrelativeOptions {
        linear_search_window: 0.3,
        angular_search_window: 1f64.to_radians(),
        translation_delta_cost_weight: 0.1,
        rotation_delta_cost_weight: 1.0,
    };
    let matcher = RealTimeCorrelativeMatcher3d::new(&options).unwrap();
    let turn = |axis: Vector3| quaternion_from_angle_axis(&(axis.normalize() * 0.8f64.to_radians()));
    let expected = Rigid3::translation(-1.0, 0.0, 0.0);
    for (translation, rotation) in [
        (Vector3::new(-1.0, 0.0, 0.0), na::UnitQuaternion::identity()),
        (Vector3::new(-0.8, 0.0, 0.0), na::UnitQuaternion::identity()),
        (Vector3::new(-1.0, 0.0, -0.2), na::UnitQuaternion::identity()),
        (Vector3::new(-0.9, -0.2, 0.2), na::UnitQuaternion::identity()),
        (Vector3::new(-1.0, 0.0, 0.0), turn(Vector3::x())),
        (Vector3::new(-1.0, 0.0, 0.0), turn(Vector3::y())),
        (Vector3::new(-1.0, 0.0, 0.0), turn(Vector3::new(0.0, 1.0, 1.0))),
    ] {
        let initial = Rigid3::from_parts(translation.into(), rotation);
        let found = matcher.match_scan(&initial, &cloud, &grid).unwrap().pose;
        // It does not matter which of the rotations that put every point in its cell is found.
        for p in &cloud.points {
            let p = p.cast::<f64>();
            assert!((found * p - expected * p).norm() < 0.1, "{initial} {found}");
        }
    }
}

#[test]
fn the_result_is_that_of_trying_everything() {
    let (grid, mut lcg) = (drawn_cloud_b(0.3, 3), Lcg::new(6));
    for round in 0..6 {
        let options = RealTimeCorrelativeOptions {
            linear_search_window: 0.3 * f64::from(round % 3),
            angular_search_window: 0.06,
            translation_delta_cost_weight: f64::from(round),
            rotation_delta_cost_weight: 1.0,
        };
        let mut scan = golden_scan_3d();
        scan.points.retain(|_| lcg.unit() < 0.05);
        let offset = [0; 3].map(|_| f64::from(lcg.symmetric(0.5)));
        let rotation = quaternion_from_angle_axis(&Vector3::new(0.01, -0.02, f64::from(lcg.symmetric(0.2))));
        let initial = Rigid3::from_parts(offset.into(), rotation);
        let window = Window::new(&options, &scan.points, grid.lattice());
        let mut best = (f32::NEG_INFINITY, Rigid3f::identity());
        for shift in 0..window.num_shifts() {
            for rotation in 0..window.num_rotations() {
                let candidate = Rigid3f::from_parts(window.shift(shift).into(), window.rotation(rotation));
                let pose = to_f32(&initial) * candidate;
                let mean = super::super::fast_3d::mean_probability(&scan.points, &pose, &grid);
                let weighted = f64::from(candidate.translation.vector.norm())
                    * options.translation_delta_cost_weight
                    + f64::from(candidate.rotation.angle()) * options.rotation_delta_cost_weight;
                let score = (f64::from(mean) * (-weighted * weighted).exp()) as f32;
                if score > best.0 {
                    best = (score, pose);
                }
            }
        }
        let found =
            RealTimeCorrelativeMatcher3d::new(&options).unwrap().match_scan(&initial, &scan, &grid).unwrap();
        assert!((found.score - best.0).abs() < 2e-6, "{found:?} {best:?}");
        assert!((to_f32(&found.pose).to_homogeneous() - best.1.to_homogeneous()).norm() < 1e-5, "{round}");
    }
}

#[test]
fn searches_of_odd_input_terminate() {
    let grid = drawn_cloud_b(0.45, 1);
    let matcher = RealTimeCorrelativeMatcher3d::new(&RealTimeCorrelativeOptions::default()).unwrap();
    let cloud = PointCloud::new(vec![Point3f::new(f32::NAN, 0.0, 0.0)]);
    assert!(matcher.match_scan(&Rigid3::identity(), &cloud, &grid).is_none());
    let cloud = PointCloud::new(vec![Point3f::new(3.0, 0.0, 0.0)]);
    assert!(matcher.match_scan(&Rigid3::translation(f64::NAN, 0.0, 0.0), &cloud, &grid).is_none());
    assert!(matcher.match_scan(&Rigid3::translation(1e9, 0.0, 0.0), &cloud, &grid).is_some());
    let negative = RealTimeCorrelativeOptions { linear_search_window: -1.0, ..Default::default() };
    assert!(RealTimeCorrelativeMatcher3d::new(&negative).is_err());
}
