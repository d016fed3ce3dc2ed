use super::*;
use crate::MapLimits;
use crate::testing::{crc_u16, room_limits, room1, room2};
use portolan_geometry::Vector2;
use portolan_sensor::PointCloud;

fn plain() -> TsdfInserterOptions {
    TsdfInserterOptions {
        truncation_distance: 2.0,
        project_sdf_distance_to_scan_normal: false,
        update_weight_angle_scan_normal_to_ray_kernel_bandwidth: 0.0,
        update_weight_distance_cell_to_hit_kernel_bandwidth: 0.0,
        ..Default::default()
    }
}

fn drawn(options: &TsdfInserterOptions, hits: &[(f32, f32)], times: usize) -> Tsdf2d {
    let limits = MapLimits::new(1.0, Vector2::new(1.0, 7.0), 8, 1).unwrap();
    let mut tsdf = Tsdf2d::new(limits, 2.0, 10.0).unwrap();
    let returns = PointCloud::new(hits.iter().map(|(x, y)| Point3f::new(*x, *y, 0.0)).collect());
    let data = RangeData { origin: Point3f::new(-0.5, -0.5, 0.0), returns, misses: PointCloud::default() };
    let inserter = TsdfInserter::new(options).unwrap();
    for _ in 0..times {
        inserter.insert(&data, &mut tsdf).unwrap();
    }
    tsdf
}

fn check(tsdf: &Tsdf2d, x: f32, y: f32, distance: f32, weight: f32) {
    let cell = tsdf.limits().cell_index(Vector2f::new(x, y));
    assert_eq!(tsdf.is_known(cell), weight != 0.0, "({x}, {y})");
    assert!(
        (tsdf.signed_distance(cell) - distance).abs() < 1e-4,
        "({x}, {y}) {}",
        tsdf.signed_distance(cell)
    );
    assert!((tsdf.weight(cell) - weight).abs() < 1e-2, "({x}, {y}) {}", tsdf.weight(cell));
}

#[test]
fn one_ray() {
    for (times, weight) in [(1, 1.0), (1001, 10.0)] {
        let tsdf = drawn(&plain(), &[(-0.5, 3.5)], times);
        for y in [1.5, 2.5, 3.5, 4.5, 5.5] {
            check(&tsdf, -0.5, y, (3.5 - y).clamp(-2.0, 2.0), weight);
            check(&tsdf, 0.5, y, -2.0, 0.0);
            check(&tsdf, 1.5, y, -2.0, 0.0);
        }
        check(&tsdf, 0.5, 6.5, -2.0, 0.0);
        check(&tsdf, -0.5, -1.5, -2.0, 0.0);
    }
}

#[test]
fn free_space_and_weights() {
    let tsdf = drawn(&TsdfInserterOptions { update_free_space: true, ..plain() }, &[(-0.5, 3.5)], 1);
    check(&tsdf, -0.5, -0.5, 2.0, 1.0);
    check(&tsdf, -0.5, 0.5, 2.0, 1.0);
    for (update_weight_range_exponent, weight) in [(1, 0.25), (2, 0.0625)] {
        let options = TsdfInserterOptions { update_weight_range_exponent, ..plain() };
        check(&drawn(&options, &[(-0.5, 3.5)], 1), -0.5, 3.5, 0.0, weight);
    }
}

#[test]
fn distances_along_rays_and_normals() {
    let hits = [(-0.5, 3.5), (5.5, 3.5), (10.5, 3.5)];
    let tsdf = drawn(&plain(), &hits, 1);
    let expected = (6.0f32.powi(2) + 4.0f32.powi(2)).sqrt() - (5.0f32.powi(2) + 3.0f32.powi(2)).sqrt();
    check(&tsdf, 4.5, 2.5, expected, 1.0);
    let normal_estimation = NormalEstimationOptions { num_normal_samples: 2, sample_radius: 10.0 };
    let projecting =
        TsdfInserterOptions { project_sdf_distance_to_scan_normal: true, normal_estimation, ..plain() };
    let tsdf = drawn(&projecting, &hits[..2], 1);
    check(&tsdf, 4.5, 2.5, 1.0, 1.0);
    check(&tsdf, 6.5, 4.5, -1.0, 1.0);
}

#[test]
fn kernels() {
    let normal_estimation = NormalEstimationOptions { num_normal_samples: 2, sample_radius: 10.0 };
    let angle = TsdfInserterOptions {
        normal_estimation: normal_estimation.clone(),
        update_weight_angle_scan_normal_to_ray_kernel_bandwidth: 10.0,
        ..plain()
    };
    let tsdf = drawn(&angle, &[(-0.5, 3.5), (5.5, 3.5)], 1);
    let at = |x: f32, y: f32| tsdf.weight(tsdf.limits().cell_index(Vector2f::new(x, y)));
    assert!((at(-0.5, 3.5) - gaussian_kernel(0.0, 10.0)).abs() < 1e-3);
    assert!((at(4.5, 2.5) - gaussian_kernel(6f32.atan2(4.0), 10.0)).abs() < 1e-3);
    let distance =
        TsdfInserterOptions { update_weight_distance_cell_to_hit_kernel_bandwidth: 10.0, ..plain() };
    let tsdf = drawn(&distance, &[(-0.5, 3.5)], 1);
    check(&tsdf, -0.5, 1.5, 2.0, gaussian_kernel(2.0, 10.0));
    check(&tsdf, -0.5, 3.5, 0.0, gaussian_kernel(0.0, 10.0));
}

#[test]
fn drawn_rooms_equal_the_golden_fields() {
    let inserter = TsdfInserter::new(&TsdfInserterOptions::default()).unwrap();
    let mut tsdf = Tsdf2d::new(room_limits(), 0.3, 10.0).unwrap();
    let check = |tsdf: &Tsdf2d, min_x: i32, non_zero: usize, cells: u32| {
        let known = tsdf.known_cells_box().unwrap();
        assert_eq!((known.min, known.max), (CellIndex::new(min_x, 80), CellIndex::new(262, 292)));
        assert_eq!(tsdf.cells().iter().filter(|c| **c != 0).count(), non_zero);
        assert_eq!(crc_u16(tsdf.cells()), cells);
    };
    inserter.insert(&room1(), &mut tsdf).unwrap();
    check(&tsdf, 90, 5433, 0x291a_7b03);
    assert_eq!(crc_u16(tsdf.weight_cells()), 0x3fcc_c76d);
    (0..2).for_each(|_| assert!(inserter.insert(&room1(), &mut tsdf).is_ok()));
    check(&tsdf, 90, 5433, 0x291a_7b03);
    assert_eq!(crc_u16(tsdf.weight_cells()), 0xae73_e4de);
    inserter.insert(&room2(), &mut tsdf).unwrap();
    check(&tsdf, 89, 7741, 0x8075_7cdd);
    // Single weights depend on the last bit of the exponential function.
    let sum: i64 = tsdf.weight_cells().iter().map(|w| i64::from(*w)).sum();
    assert!((sum - 27_938_318).abs() <= 4, "{sum}");
}

#[test]
fn absurd_points_are_handled() {
    let inserter = TsdfInserter::new(&TsdfInserterOptions::default()).unwrap();
    let mut tsdf = Tsdf2d::new(room_limits(), 0.3, 10.0).unwrap();
    let mut data = room1();
    data.returns.points.extend([data.origin, Point3f::new(f32::NAN, 0.0, 0.0)]);
    assert_eq!(inserter.insert(&data, &mut tsdf).unwrap().not_finite, 1);
    let before = tsdf.clone();
    data.returns.points.push(Point3f::new(-1e9, 1e9, 0.0));
    assert!(matches!(inserter.insert(&data, &mut tsdf), Err(GridError::TooLarge { .. })));
    assert_eq!(tsdf, before);
    let options = TsdfInserterOptions { truncation_distance: 0.0, ..Default::default() };
    assert!(TsdfInserter::new(&options).is_err());
}
