use portolan_recording::Header;
use proptest::prelude::*;

use super::*;
use crate::point_time::detect;
use crate::test_messages::cloud_of as cloud;

fn convert(cloud: &PointCloud2, time: Option<PointTime>) -> (TimedPoints, CloudFaults) {
    CloudLayout::of(cloud).unwrap().points(cloud.header.stamp, cloud, time, true)
}

#[test]
fn any_order_type_and_byte_order_reads_the_same() {
    use FieldType::{Float32, Float64, Int16, Uint8, Uint32};
    let time = Some(PointTime { unit: 1e-9, origin: PointTimeOrigin::Stamp, reach: 1.0 });
    for big in [false, true] {
        let a = cloud(
            &[("x", Float32), ("y", Float32), ("z", Float32), ("intensity", Float32), ("t", Uint32)],
            &[vec![1.0, 2.0, 3.0, 9.0, 0.0], vec![-1.0, 0.5, 0.0, 8.0, 50_000_000.0]],
            big,
        );
        let b = cloud(
            &[
                ("t", Float64),
                ("ring", Uint8),
                ("z", Float64),
                ("intensity", Int16),
                ("y", Float64),
                ("x", Float32),
            ],
            &[vec![0.0, 1.0, 3.0, 9.0, 2.0, 1.0], vec![5e7, 1.0, 0.0, 8.0, 0.5, -1.0]],
            big,
        );
        let (points, faults) = convert(&a, time);
        assert_eq!((points.clone(), faults), convert(&b, time));
        assert_eq!(
            points.time,
            a.header.stamp + portolan_geometry::Duration::from_seconds(f64::from(0.05f32))
        );
        assert_eq!((points.points[0].time, points.points[1].time), (-0.05, 0.0));
        assert_eq!(points.intensities, [9.0, 8.0]);
        assert_eq!(faults, CloudFaults::default());
    }
}

#[test]
fn invalid_points_are_counted() {
    let fields = [("x", FieldType::Float32), ("y", FieldType::Float32), ("z", FieldType::Float32)];
    let mut message = cloud(
        &fields,
        &[
            vec![f64::NAN, 0.0, 0.0],
            vec![0.0; 3],
            vec![1.0, 0.0, 0.0],
            vec![2e6, 0.0, 0.0],
            vec![1.0, 1.0, 1.0],
        ],
        false,
    );
    message.data.truncate(message.data.len() - 1);
    let (points, faults) = convert(&message, None);
    assert_eq!(points.points.len(), 1);
    assert_eq!(faults, CloudFaults { not_finite: 2, far_time: 0, zero: 1, missing: 1 });
    assert_eq!(points.time, message.header.stamp);
}

#[test]
fn rows_may_be_padded() {
    let fields = [("x", FieldType::Float32), ("y", FieldType::Float32), ("z", FieldType::Float32)];
    let mut message = cloud(&fields, &[vec![1.0; 3], vec![2.0; 3], vec![3.0; 3], vec![4.0; 3]], false);
    (message.width, message.height, message.row_step) = (2, 2, 2 * message.point_step + 3);
    let tail = message.data.split_off(2 * message.point_step as usize);
    message.data.extend([0xaa; 3]);
    message.data.extend(tail);
    let (points, faults) = convert(&message, None);
    let xs: Vec<f32> = points.points.iter().map(|p| p.position.x).collect();
    assert_eq!((xs.as_slice(), faults.missing), ([1.0, 2.0, 3.0, 4.0].as_slice(), 0));
}

#[test]
fn times_of_clocks_keep_their_digits() {
    let fields = [
        ("x", FieldType::Float32),
        ("y", FieldType::Float32),
        ("z", FieldType::Float32),
        ("timestamp", FieldType::Float64),
    ];
    let points: Vec<Vec<f64>> = (0..10).map(|i| vec![1.0, 1.0, 1.0, 1.7e9 + 0.01 * f64::from(i)]).collect();
    let message = cloud(&fields, &points, false);
    let (points, _) =
        convert(&message, Some(PointTime { unit: 1.0, origin: PointTimeOrigin::Epoch, reach: 1.0 }));
    assert!((points.time.seconds_since(message.header.stamp) - 0.09).abs() < 1e-6);
    assert!((points.points[0].time + 0.09).abs() < 1e-6);
    let epoch = Some(PointTime { unit: 1.0, origin: PointTimeOrigin::Epoch, reach: 1.0 });
    let moved = message.header.stamp + portolan_geometry::Duration::from_seconds(-0.05);
    let (points, _) = CloudLayout::of(&message).unwrap().points(moved, &message, epoch, true);
    assert!((points.time.seconds_since(message.header.stamp) - 0.04).abs() < 1e-6);
    let (points, _) =
        convert(&message, Some(PointTime { unit: 1.0, origin: PointTimeOrigin::OtherClock, reach: 1.0 }));
    assert!((points.time.seconds_since(message.header.stamp) - 0.09).abs() < 1e-6);
}

#[test]
fn organised_clouds_show_the_times_of_all_columns() {
    let fields = ["x", "y", "z", "t"].map(|name| (name, FieldType::Float32));
    for (rings, columns) in [(128, 512), (128, 1800), (64, 1024), (32, 1800), (16, 1800)] {
        let time = |i: u32| f64::from(i % columns) * 0.1 / f64::from(columns);
        let mut points: Vec<Vec<f64>> = (0..rings * columns).map(|i| vec![1.0, 1.0, 1.0, time(i)]).collect();
        let span = |points: &[Vec<f64>]| {
            let message = cloud(&fields, points, false);
            CloudLayout::of(&message).unwrap().time_span(&message).unwrap().span
        };
        assert!((span(&points) - 0.1).abs() < 0.001, "{rings} {columns}");
        points[1000][3] = 1e9;
        assert!((span(&points) - 0.1).abs() < 0.02, "{rings} {columns}: {}", span(&points));
    }
}

#[test]
fn points_with_a_time_of_their_own_are_left_out_and_counted() {
    let fields =
        |kind| [("x", FieldType::Float32), ("y", FieldType::Float32), ("z", FieldType::Float32), ("t", kind)];
    let times = |base: f64, wrong: f64| -> Vec<Vec<f64>> {
        let time = |i: u32| if i % 60 == 7 { wrong } else { base + 1e-4 * f64::from(i) };
        (0..1000).map(|i| vec![1.0, 1.0, 1.0, time(i)]).collect()
    };
    let date = 1.7e9;
    for (kind, base, wrong) in [
        (FieldType::Float32, 0.0, 1e9),
        (FieldType::Float32, 0.0, 0.6),
        (FieldType::Float32, -0.1, -5.0),
        (FieldType::Float64, date, 0.0),
        (FieldType::Float64, date, date + 5.0),
    ] {
        let message = cloud(&fields(kind), &times(base, wrong), false);
        let span = CloudLayout::of(&message).unwrap().time_span(&message).unwrap();
        let time = detect(&[span], Some(0.1)).unwrap();
        let (points, faults) = convert(&message, Some(time));
        assert_eq!((points.points.len(), faults.far_time), (983, 17), "{base} {wrong} {time:?}");
        let end = if base == 0.0 { date } else { date + base.min(0.0) } + 0.0999;
        assert!(
            (points.time.unix_seconds() - end).abs() < 1e-4,
            "{base} {wrong} {}",
            points.time.unix_seconds()
        );
    }
}

fn field_type() -> impl Strategy<Value = Option<FieldType>> {
    use FieldType::*;
    prop::sample::select(vec![
        None,
        Some(Int8),
        Some(Uint8),
        Some(Int16),
        Some(Uint16),
        Some(Int32),
        Some(Uint32),
        Some(Float32),
        Some(Float64),
    ])
}

proptest! {
    #[test]
    fn random_layouts_never_panic(
        fields in prop::collection::vec(
            (prop::sample::select(vec!["x", "y", "z", "time", "t", "intensity", ""]), prop_oneof![0u32..40, any::<u32>()], field_type(), 0u32..3),
            0..9,
        ),
        size in (prop_oneof![0u32..30, any::<u32>()], prop_oneof![0u32..30, any::<u32>()]),
        steps in (prop_oneof![0u32..40, any::<u32>()], prop_oneof![0u32..400, any::<u32>()]),
        data in prop::collection::vec(any::<u8>(), 0..600),
        flags in any::<(bool, bool)>(),
        unit in prop::sample::select(vec![1.0, 1e-3, 1e-9]),
        reach in prop::sample::select(vec![0.25, 1e9, f64::INFINITY]),
        origin in prop::sample::select(vec![PointTimeOrigin::Stamp, PointTimeOrigin::Epoch, PointTimeOrigin::OtherClock]),
    ) {
        let message = PointCloud2 {
            header: Header { stamp: Time::from_ros(1, 0), frame_id: "lidar".into() },
            height: size.0,
            width: size.1,
            fields: fields
                .into_iter()
                .map(|(name, offset, field_type, count)| PointField { name: name.into(), offset, field_type, count })
                .collect(),
            is_bigendian: flags.0,
            point_step: steps.0,
            row_step: steps.1,
            data,
            is_dense: flags.1,
        };
        if let Ok(layout) = CloudLayout::of(&message) {
            layout.time_span(&message);
            let (points, _) = layout.points(message.header.stamp, &message, Some(PointTime { unit, origin, reach }), flags.1);
            prop_assert!(points.points.iter().all(|p| p.time <= 0.0));
            prop_assert!(points.points.is_sorted_by(|a, b| a.time <= b.time));
        }
    }
}
