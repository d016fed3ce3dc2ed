use portolan_geometry::Point3f;
use portolan_sensor::PointCloud;

use super::*;
use crate::testing::{Lcg, cloud_b, crc_cells, drawn_cloud_b, range_data_b};

fn small_scan() -> (RangeData, HybridInserter) {
    let options = HybridInserterOptions {
        hit_probability: 0.7,
        miss_probability: 0.4,
        num_free_space_voxels: 1000,
        intensity_threshold: 100.0,
    };
    let points = [(-3.0, -1.0), (-2.0, 0.0), (-1.0, 1.0), (0.0, 2.0)];
    let returns = PointCloud {
        points: points.iter().map(|p| Point3f::new(p.0, p.1, 4.0)).collect(),
        intensities: vec![7.0, 8.0, 9.0, 10.0],
    };
    let data = RangeData { origin: Point3f::new(0.0, 0.0, -4.0), returns, misses: PointCloud::default() };
    (data, HybridInserter::new(&options).unwrap())
}

#[test]
fn hits_and_misses_are_in_their_cells() {
    let (data, inserter) = small_scan();
    let mut grid = HybridGrid::new(1.0).unwrap();
    let mut intensities = IntensityGrid::new(1.0).unwrap();
    let report = inserter.insert(&data, f32::INFINITY, &mut grid, Some(&mut intensities)).unwrap();
    assert_eq!((report.hits, report.not_finite, report.outside), (4, 0, 0));
    for z in [-4, -3, -2] {
        assert!((grid.probability([0, 0, z]) - 0.4).abs() < 1e-4);
    }
    for (x, y) in (-4..=4).flat_map(|x| (-4..=4).map(move |y| (x, y))) {
        let cell = [x, y, 4];
        let hit = (-3..=0).contains(&x) && y == x + 2;
        assert_eq!(grid.is_known(cell), hit, "{cell:?}");
        assert!((grid.probability(cell) - if hit { 0.7 } else { 0.1 }).abs() < 1e-4);
        let expected = if hit { 10.0 + x as f32 } else { 0.0 };
        assert!((intensities.intensity(cell) - expected).abs() < 1e-6);
    }
    for _ in 0..1000 {
        inserter.insert(&data, f32::INFINITY, &mut grid, None).unwrap();
    }
    assert!((grid.probability([-2, 0, 4]) - 0.9).abs() < 1e-3);
    for cell in [[-2, 0, 3], [0, 0, -3], [0, 0, -2]] {
        assert!((grid.probability(cell) - 0.1).abs() < 1e-3, "{cell:?}");
    }
}

#[test]
fn drawn_clouds_equal_the_golden_grids() {
    let points = cloud_b();
    let bytes: Vec<u8> =
        points.points.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f32::to_le_bytes).collect();
    assert_eq!(crc32fast::hash(&bytes), 0x89a4_648c);
    for (resolution, cells, crc, first, last, extent) in [
        (0.1, 5551, 0xd75e_a00f, [-65, -29, -20, 25874], [65, 30, 20, 25874], 256),
        (0.45, 2188, 0x5eb1_de22, [-13, -11, -4, 25874], [13, 11, 4, 25874], 128),
    ] {
        let grid = drawn_cloud_b(resolution, 5);
        assert_eq!((grid.num_cells(), grid.extent()), (cells, extent));
        for grid in [&grid, &grid.compacted()] {
            assert_eq!(crc_cells(grid), crc, "{resolution}");
            let mut all = Vec::new();
            grid.for_each_cell(|[x, y, z], v| all.push([x, y, z, i32::from(v)]));
            assert_eq!((all[0], all[all.len() - 1]), (first, last));
        }
    }
}

#[test]
fn far_returns_are_left_out() {
    let (data, inserter) = (range_data_b(), small_scan().1);
    let mut grid = HybridGrid::new(0.1).unwrap();
    let report = inserter.insert(&data, 6.0, &mut grid, None).unwrap();
    let near = data.returns.points.iter().filter(|p| (*p - data.origin).norm() <= 6.0).count();
    assert!(report.hits == near && near > 100 && near < data.returns.len());
}

#[test]
fn absurd_points_are_handled() {
    let (mut data, inserter) = small_scan();
    let mut grid = HybridGrid::new(1.0).unwrap();
    data.returns.points.push(Point3f::new(f32::NAN, 0.0, 0.0));
    data.returns.points.push(Point3f::new(0.0, f32::INFINITY, 0.0));
    data.returns.points.push(Point3f::new(0.0, 1e30, 0.0));
    data.returns.points.push(data.origin);
    let report = inserter.insert(&data, f32::INFINITY, &mut grid, None).unwrap();
    assert_eq!((report.hits, report.outside, report.not_finite), (5, 2, 1));
    let before = grid.clone();
    data.origin.x = f32::NAN;
    assert!(inserter.insert(&data, 10.0, &mut grid, None).is_err());
    assert_eq!(grid, before);
    for (hit, miss) in [(0.5, 0.4), (0.6, 0.5), (f64::NAN, 0.4)] {
        let options =
            HybridInserterOptions { hit_probability: hit, miss_probability: miss, ..Default::default() };
        assert!(HybridInserter::new(&options).is_err());
    }
}

#[test]
fn many_scans_at_once_are_drawn_as_one_after_the_other() {
    let inserter = HybridInserter::new(&HybridInserterOptions::default()).unwrap();
    let scans: Vec<RangeData> = (0..12)
        .map(|seed| RangeData { returns: crate::testing::oval_hall(seed % 5, 700), ..range_data_b() })
        .chain([RangeData { origin: Point3f::new(f32::NAN, 0.0, 0.0), ..range_data_b() }])
        .collect();
    let (mut at_once, mut in_turn) = (HybridGrid::new(0.2).unwrap(), HybridGrid::new(0.2).unwrap());
    let report = inserter.insert_all(&scans, 12.0, &mut at_once);
    let hits: usize =
        scans.iter().filter_map(|s| inserter.insert(s, 12.0, &mut in_turn, None).ok()).map(|r| r.hits).sum();
    assert_eq!(at_once, in_turn);
    assert!(report.hits == hits && hits > 1000);
    assert_eq!(at_once.num_cells(), at_once.compacted().num_cells());
}

/// Scans of the hall, as many as make a submap, each thinned by a voxel filter.
#[test]
fn grids_take_no_more_memory_than_their_files() {
    let inserter = HybridInserter::new(&HybridInserterOptions::default()).unwrap();
    for (resolution, scans) in [(0.1, 40), (0.45, 5)] {
        let mut grid = HybridGrid::new(resolution).unwrap();
        for seed in 0..scans {
            let data = RangeData { returns: crate::testing::oval_hall(seed, 2000), ..range_data_b() };
            inserter.insert(&data, f32::INFINITY, &mut grid, None).unwrap();
        }
        let file = crate::testing::stored_bytes(&grid);
        for (state, memory) in
            [("growing", grid.memory_bytes()), ("finished", grid.compacted().memory_bytes())]
        {
            assert!(
                memory < file,
                "{resolution} {state}: {memory} bytes for {file}, {} cells",
                grid.num_cells()
            );
        }
    }
}

#[test]
fn cells_before_a_hit_are_at_equal_steps_of_the_ray() {
    let mut lcg = Lcg::new(5);
    let options = HybridInserterOptions { num_free_space_voxels: 7, ..HybridInserterOptions::default() };
    let inserter = HybridInserter::new(&options).unwrap();
    for i in 0..50_000 {
        let reach = [3.0, 40.0, 8000.0][i % 3];
        let [begin, end] = [(); 2].map(|()| [(); 3].map(|()| lcg.symmetric(reach) as i32));
        let delta = [0, 1, 2].map(|axis| end[axis] - begin[axis]);
        let steps = delta.iter().map(|d| d.abs()).max().unwrap();
        let step = |k: i32| [0, 1, 2].map(|axis| begin[axis] + delta[axis] * k / steps);
        let expected: Vec<VoxelIndex> = ((steps - 7).max(0)..steps).rev().map(step).collect();
        let mut cells = Vec::new();
        inserter.clear_before(begin, end, |cell| cells.push(cell));
        assert_eq!(cells, expected, "{begin:?} {end:?}");
    }
}
