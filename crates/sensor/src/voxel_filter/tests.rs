use super::*;
use portolan_testing::clouds::{crc, flat_box};
use proptest::prelude::*;

fn points(coordinates: &[[f32; 3]]) -> Vec<Point3f> {
    coordinates.iter().map(|c| Point3f::from(*c)).collect()
}

#[test]
fn golden_reservoir() {
    let expected = [0, 0, 0, 3, 3, 3, 3, 3, 3, 3, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10, 10];
    for (n, kept) in (1..=24).zip(expected) {
        let line: Vec<Point3f> = (0..n).map(|i| Point3f::new(0.001 * i as f32, 0.0, 0.0)).collect();
        assert_eq!(voxel_filter_indices(&line, |p| *p, 10.0), [kept], "{n} points");
    }
}

#[test]
fn golden_clouds() {
    let cloud = flat_box(1, 1000);
    for (resolution, count, expected) in [(1.0, 959, 0x3286_edea), (5.0, 187, 0x50a4_c3fa)] {
        let filtered = voxel_filter_points(&cloud, resolution);
        assert_eq!((filtered.len(), crc(&filtered)), (count, expected), "edge {resolution}");
    }
}

#[test]
fn golden_adaptive_clouds() {
    let cloud = PointCloud::new(flat_box(1, 1000));
    let golden = [
        (4.0, 150, 15.0, 163, 0xaf92_5fdb),
        (8.0, 100, 50.0, 148, 0x9ff2_3295),
        (2.0, 900, 50.0, 905, 0x02d9_8624),
    ];
    for (max_length, min_num_points, max_range, count, expected) in golden {
        let filtered = adaptive_voxel_filter(&cloud, max_length, min_num_points, max_range).points;
        assert_eq!((filtered.len(), crc(&filtered)), (count, expected), "{max_length}");
    }
}

#[test]
fn a_single_point_in_a_voxel_is_kept() {
    let cloud = points(&[[0.0, 0.0, 0.0], [0.1, -0.1, 0.1], [0.3, -0.1, 0.0], [0.0, 0.0, 0.1]]);
    let filtered = voxel_filter(&PointCloud::new(cloud.clone()), 0.3);
    assert_eq!(filtered.len(), 2);
    assert!(filtered.points.contains(&cloud[2]) && filtered.points.iter().all(|p| cloud.contains(p)));
    assert!(filtered.intensities.is_empty());
}

#[test]
fn intensities_follow_their_points() {
    let points: Vec<Point3f> = (0..100).map(|i| Point3f::new(-100.0, 0.3, 0.1 * i as f32)).collect();
    let intensities = points.iter().map(|p| p.z).collect();
    let filtered = voxel_filter(&PointCloud { points, intensities }, 0.3);
    assert!(filtered.len() > 10 && filtered.len() == filtered.intensities.len());
    assert!(filtered.points.iter().zip(&filtered.intensities).all(|(p, i)| p.z == *i));
}

#[test]
fn large_coordinates_have_voxels_too() {
    let far = [100_000.0, 100_000.0, 100_000.0];
    let cloud = points(&[far, [100_000.001, 100_000.0, 100_000.0], [-200_000.0; 3], far]);
    assert_eq!(voxel_filter_points(&cloud, 0.01).len(), 2);
}

#[test]
fn times_do_not_affect_voxels() {
    let cloud: Vec<TimedPoint> = (0..100)
        .map(|i| TimedPoint { position: Point3f::new(-100.0, 0.3, 0.4), time: -(i as f32) })
        .collect();
    assert_eq!(voxel_filter_timed(&cloud, 0.3).len(), 1);
}

#[test]
fn points_that_are_not_finite_are_left_out() {
    let cloud = points(&[[f32::NAN, 0.0, 0.0], [1.0, 2.0, 3.0], [0.0, f32::INFINITY, 0.0]]);
    for resolution in [0.5, 0.0, f32::NAN] {
        assert_eq!(voxel_filter_indices(&cloud, |p| *p, resolution), [1]);
    }
    assert_eq!(adaptive_voxel_filter_indices(&cloud, 1.0, 0, 100.0), [1]);
    assert!(adaptive_voxel_filter_indices(&cloud, 1.0, 10, f32::NAN).is_empty());
}

#[test]
fn adaptive_searches_end_at_odd_settings() {
    let cloud = flat_box(2, 50);
    for length in [0.0, -1.0, f32::NAN, f32::INFINITY, f32::MIN_POSITIVE] {
        assert!(adaptive_voxel_filter_indices(&cloud, length, 10, 1000.0).len() <= 50);
        assert!(adaptive_voxel_filter_indices(&[], length, 10, 1000.0).is_empty());
    }
}

proptest! {
    #[test]
    fn every_occupied_voxel_keeps_exactly_one_point(
        coordinates in prop::collection::vec(prop::array::uniform3(-5.0f32..5.0), 0..300),
        resolution in 0.05f32..4.0,
    ) {
        let cloud = points(&coordinates);
        let voxel = |p: &Point3f| p.coords.map(|c| crate::lround(c / resolution));
        let kept = voxel_filter_points(&cloud, resolution);
        let mut voxels: Vec<_> = kept.iter().map(|p| voxel(p).data.0[0]).collect();
        voxels.sort_unstable();
        voxels.dedup();
        prop_assert_eq!(voxels.len(), kept.len());
        prop_assert!(cloud.iter().all(|p| voxels.contains(&voxel(p).data.0[0])));
        prop_assert_eq!(kept, voxel_filter_points(&cloud, resolution));
    }
}
