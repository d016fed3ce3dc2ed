use super::*;
use portolan_testing::clouds::flat_box;
use proptest::prelude::*;

fn compress(points: &[[f32; 3]]) -> CompressedPointCloud {
    let points: Vec<Point3f> = points.iter().map(|p| Point3f::from(*p)).collect();
    CompressedPointCloud::compress(&points).unwrap()
}

#[test]
#[allow(clippy::excessive_precision)] // the digits as printed by Cartographer
fn golden_points() {
    let compressed = compress(&[
        [1.2345, -0.5, 0.25],
        [-3.0, 2.0, 0.001],
        [1.2349, -0.5004, 0.2496],
        [100.0, -200.0, 5.0],
        [0.0, 0.0, 0.0],
        [1.0235, -0.0005, 0.0015],
        [-0.0015, 70.0, -0.0025],
    ]);
    #[rustfmt::skip]
    let expected = [
        1, -1, 68, -1, 1072022526, 1, 97, -196, 4, 948634272, 1, 0, -1, 0, 3145727,
        2, 1, -1, 0, 262680787, 262680787, 1, -3, 1, 0, 2048072, 1, 0, 0, 0, 0,
    ];
    assert_eq!((compressed.num_points, &compressed.point_data[..]), (7, &expected[..]));
    let twice = Point3f::new(1.23500001, -0.5, 0.25);
    let decoded = [
        Point3f::new(-0.00200000009, 70.0, -0.00200000009),
        Point3f::new(100.000008, -200.000015, 5.0),
        Point3f::new(1.023, -0.00100000005, 0.00200000009),
        twice,
        twice,
        Point3f::new(-3.00000024, 2.0, 0.00100000005),
        Point3f::origin(),
    ];
    assert_eq!(compressed.decompress().unwrap(), decoded);
}

#[test]
fn golden_cloud() {
    let compressed = CompressedPointCloud::compress(&flat_box(1, 1000)).unwrap();
    let bytes: Vec<u8> = compressed.point_data.iter().flat_map(|i| i.to_le_bytes()).collect();
    assert_eq!((compressed.point_data.len(), crc32fast::hash(&bytes)), (4812, 0x1899_a761));
    assert_eq!(compressed.point_data[..5], [1, -20, -18, -3, 470_291_353]);
}

#[test]
fn single_points_come_back_within_a_millimetre() {
    let mut cases = vec![
        [8000.0, 7500.0, 5000.0],
        [1000.0, 2000.0, 3000.0],
        [100.0, 200.0, 300.0],
        [10.0, 20.0, 30.0],
        [-0.00049, -0.0005, -0.0015],
        [0.05119, 0.0512, 0.05121],
        [-0.05119, -0.0512, -0.05121],
    ];
    cases.extend((0..=16).map(|i| [0.8389 + 0.0001 * i as f32; 3]));
    for case in cases {
        let first = compress(&[case]).decompress().unwrap();
        let second = CompressedPointCloud::compress(&first).unwrap().decompress().unwrap();
        for decoded in [&first, &second] {
            assert_eq!(decoded.len(), 1);
            assert!((decoded[0] - Point3f::from(case)).amax() <= 0.001, "{case:?} {decoded:?}");
        }
        assert_eq!(first, second);
    }
}

#[test]
fn neighbouring_points_remain_distinct() {
    let three = compress(&[[0.838, 0.0, 0.0], [0.839, 0.0, 0.0], [0.84, 0.0, 0.0]]).decompress().unwrap();
    assert!(three[0] != three[1] && three[1] != three[2] && three[0] != three[2]);
    assert_eq!(CompressedPointCloud::default().decompress().unwrap(), []);

    let line: Vec<[f32; 3]> = (0..3000).map(|i| [i as f32 * 0.001 - 1.5, 0.0, 0.0]).collect();
    let compressed = compress(&line);
    let points = compressed.decompress().unwrap();
    let mut x: Vec<f32> = points.iter().map(|p| p.x).collect();
    x.sort_by(f32::total_cmp);
    assert!(x.windows(2).all(|w| (w[1] - w[0] - 0.001).abs() <= 2e-7));
    assert_eq!(CompressedPointCloud::compress(&points).unwrap(), compressed);
}

#[test]
fn points_beyond_the_format_are_named() {
    let points =
        [Point3f::new(1.0, 2.0, 3.0), Point3f::new(0.0, 8389.0, 0.0), Point3f::new(f32::NAN, 0.0, 0.0)];
    let error = CompressedPointCloud::compress(&points).unwrap_err();
    assert!(matches!(error, Error::OutOfBounds { index: 1, .. }) && error.to_string().contains("8389"));
    let (compressed, left_out) = CompressedPointCloud::compress_within_bounds(&points).unwrap();
    assert_eq!((compressed.num_points, left_out), (1, 2));
    let edge = compress(&[[8388.607, -8388.607, 8388.607]]);
    assert!((edge.decompress().unwrap()[0].x - 8388.607).abs() < 1e-3);
}

#[test]
fn damage_is_named() {
    let good = compress(&[[1.0, 2.0, 3.0], [1.1, 2.0, 3.0]]);
    let with =
        |num_points: i32, point_data: Vec<i32>| CompressedPointCloud { num_points, point_data }.decompress();
    assert_eq!(with(-1, vec![]), Err(Error::NegativeCount(-1)));
    assert_eq!(with(i32::MAX, vec![]), Err(Error::Truncated { claimed: i32::MAX, found: 0 }));
    assert_eq!(with(3, good.point_data.clone()), Err(Error::Truncated { claimed: 3, found: 2 }));
    assert_eq!(with(1, vec![-1, 0, 0, 0, 0]), Err(Error::BadBlock(0)));
    assert_eq!(with(1, vec![1, 0, i32::MIN, 0, 0]), Err(Error::BadBlock(0)));
    assert_eq!(with(1, vec![1, 0, 0, 0, -1]), Err(Error::BadPoint(4)));
    assert_eq!(with(1, good.point_data).unwrap().len(), 1);
}

proptest! {
    #[test]
    fn round_trips_within_half_a_millimetre(
        coordinates in prop::collection::vec(prop::array::uniform3(-60.0f32..60.0), 0..200),
    ) {
        let compressed = compress(&coordinates);
        let mut decoded = compressed.decompress().unwrap();
        prop_assert_eq!(CompressedPointCloud::compress(&decoded).unwrap(), compressed);
        prop_assert_eq!(decoded.len(), coordinates.len());
        for c in &coordinates {
            let near = decoded.iter().position(|d| (d - Point3f::from(*c)).amax() <= 0.000_51);
            prop_assert!(near.is_some());
            decoded.swap_remove(near.unwrap());
        }
    }

    #[test]
    fn any_integers_give_points_or_an_error(num_points: i32, point_data in prop::collection::vec(-3..2000i32, 0..60)) {
        let _ = CompressedPointCloud { num_points, point_data }.decompress();
    }

    #[test]
    fn flipped_bits_never_panic(index in 0..4812usize, bit in 0..32u32, length in 0..4812usize) {
        let mut compressed = CompressedPointCloud::compress(&flat_box(1, 1000)).unwrap();
        compressed.point_data[index] ^= 1 << bit;
        compressed.point_data.truncate(length);
        if let Ok(points) = compressed.decompress() {
            prop_assert!(points.len() == 1000);
        }
    }
}
