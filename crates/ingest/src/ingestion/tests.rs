use std::sync::Arc;

use portolan_issue::Issue;
use portolan_recording::{LaserScan, MemoryRecording, PoseStamped};
use portolan_sensor::SensorKind;
use proptest::prelude::*;

use super::*;
use crate::test_messages::{at, cloud, fixed, imu, moving, named, odometry, scan};

fn read(
    messages: Vec<RecordedMessage>,
    options: &IngestOptions,
) -> (Vec<(SensorId, Measurement)>, Vec<Issue>) {
    let mut ingestion = Ingestion::new(&MemoryRecording::new(messages), options).unwrap();
    let found = ingestion.by_ref().map(Result::unwrap).collect();
    (found, ingestion.issues())
}

fn issue<'a>(issues: &'a [Issue], part: &str) -> &'a Issue {
    issues.iter().find(|r| r.to_string().contains(part)).unwrap_or_else(|| panic!("{part}: {issues:?}"))
}

fn robot(messages: impl IntoIterator<Item = RecordedMessage>) -> Vec<RecordedMessage> {
    let transforms = fixed(&[("base_link", "laser", [0.5, 0.0, 0.2], 0.0)]);
    let mut all = vec![named("/tf_static", 0.0, Message::Tf(transforms))];
    all.extend(messages);
    all
}

fn with_times(seconds: f64) -> LaserScan {
    let Message::LaserScan(mut scan) = scan(seconds, "laser") else { panic!() };
    scan.time_increment = 0.0005;
    scan
}

#[test]
fn scans_are_subdivided_and_moved_into_the_tracking_frame() {
    let messages =
        robot((0..5).map(|i| named("/scan", f64::from(i), Message::LaserScan(with_times(f64::from(i))))));
    let options = IngestOptions { num_subdivisions_per_laser_scan: 10, ..IngestOptions::default() };
    let (found, issues) = read(messages, &options);
    assert_eq!((found.len(), issues.len()), (50, 0));
    let (sensor, Measurement::Range(first)) = &found[0] else { panic!() };
    assert_eq!((&*sensor.id, sensor.kind), ("scan", SensorKind::Range));
    assert_eq!(first.points_in_tracking.len(), 9);
    assert!((first.origin_in_tracking.x - 0.5).abs() < 1e-6);
    let expected = at(0.0) + Duration::from_seconds(8.0 * 0.0005);
    assert!((first.time - expected).seconds().abs() < 1e-6);
    assert_eq!(first.points_in_tracking[8].time, 0.0);
    assert!((first.points_in_tracking[0].time + 0.004).abs() < 1e-6);
    // Without times there is nothing to subdivide; Cartographer would keep one piece in ten.
    let messages = robot((0..5).map(|i| named("/scan", f64::from(i), scan(f64::from(i), "laser"))));
    let (found, issues) = read(messages, &options);
    assert_eq!((found.len(), issue(&issues, "not subdivided").count), (5, 5));
}

#[test]
fn clouds_in_millimetres_become_metres() {
    let in_units = |unit: f32| {
        let clouds = (0..3).map(|i| {
            let t = 0.1 * f64::from(i);
            let Message::PointCloud2(mut cloud) = cloud(t, "laser") else { panic!() };
            for point in cloud.data.chunks_exact_mut(cloud.point_step as usize) {
                for value in point[..12].as_chunks_mut::<4>().0 {
                    *value = (f32::from_le_bytes(*value) * unit).to_le_bytes();
                }
            }
            named("/points", t, Message::PointCloud2(cloud))
        });
        read(robot(clouds), &IngestOptions::default())
    };
    let ((found, issues), (expected, none)) = (in_units(1e3), in_units(1.0));
    assert_eq!(issue(&issues, "clouds in millimetres were converted to metres").count, 3);
    assert!(none.is_empty(), "{none:?}");
    assert_eq!((found.len(), expected.len()), (3, 3));
    for ((_, a), (_, b)) in found.iter().zip(&expected) {
        let (Measurement::Range(a), Measurement::Range(b)) = (a, b) else { panic!() };
        for (a, b) in a.points_in_tracking.iter().zip(&b.points_in_tracking) {
            assert!((a.position - b.position).norm() < 1e-4, "{a:?} {b:?}");
        }
    }
}

#[test]
fn odometry_is_that_of_the_tracking_frame() {
    let mut messages =
        robot((0..5).map(|i| named("/odom", f64::from(i), odometry(f64::from(i), f64::from(i)))));
    messages.push(named("/scan", 0.0, scan(0.0, "laser")));
    let options = IngestOptions { tracking_frame: Some("laser".into()), ..IngestOptions::default() };
    let (found, _) = read(messages, &options);
    let (_, Measurement::Odometry(last)) = found.last().unwrap() else { panic!() };
    // pose · (child → tracking)⁻¹ with the scanner half a metre ahead.
    assert!((last.odom_from_tracking.translation.x - 4.5).abs() < 1e-9);
}

#[test]
fn late_transforms_are_used_and_the_last_messages_are_kept() {
    let mut messages = Vec::new();
    for i in 0..40 {
        let t = 0.1 * f64::from(i);
        messages.push(named("/scan", t, scan(t, "laser")));
        // Recorded 0.4 s after the scan that needs it.
        messages.push(named("/tf", t + 0.4, Message::Tf(moving("base_link", "laser", t, [0.1, 0.0, 0.0]))));
    }
    let (found, issues) = read(messages, &IngestOptions::default());
    assert_eq!(found.len(), 40, "{issues:?}");
    assert!(found.last().unwrap().1.time() >= at(3.9));
}

#[test]
fn odometry_from_transforms() {
    let mut messages = robot([]);
    for i in 0..20 {
        let t = 0.1 * f64::from(i);
        messages.push(named("/scan", t, scan(t, "laser")));
        messages.push(named("/tf", t, Message::Tf(moving("odom", "base_link", t, [t, 0.0, 0.0]))));
    }
    let (found, _) = read(messages, &IngestOptions::default());
    let poses: Vec<f64> = found
        .iter()
        .filter_map(|(_, m)| {
            if let Measurement::Odometry(o) = m { Some(o.odom_from_tracking.translation.x) } else { None }
        })
        .collect();
    assert_eq!(poses.len(), 20);
    assert!((poses[19] - 1.9).abs() < 1e-9);
}

#[test]
fn faults_are_survived_and_counted() {
    let mut messages = robot([]);
    for i in 0..30 {
        let t = 0.1 * f64::from(i);
        let stamp = match i {
            10 => t - 0.5,
            11 => 0.9,
            15 => t + 1e9,
            _ => t,
        };
        messages.push(named("/scan", t, scan(stamp, "laser")));
    }
    messages.push(named("/odom", 2.0, odometry(2.0, f64::NAN)));
    messages.push(named("/odom", 2.1, odometry(2.1, 1.0)));
    messages.push(named("/imu", 2.1, imu(2.1, [0.0, 0.0, f64::NAN])));
    let Message::LaserScan(mut odd) = scan(3.0, "laser") else { panic!() };
    (odd.range_min, odd.range_max) = (5.0, 1.0);
    odd.ranges[3] = f32::NAN;
    odd.ranges[4] = -1.0;
    messages.push(named("/scan", 3.0, Message::LaserScan(odd)));
    messages.push(named("/scan", 3.1, scan(3.1, "elsewhere")));
    let (found, issues) = read(messages, &IngestOptions { use_imu: Some(false), ..IngestOptions::default() });
    let scans = found.iter().filter(|m| m.0.kind == SensorKind::Range).count();
    assert_eq!((scans, found.len()), (28, 29));
    assert_eq!(issue(&issues, "earlier time").count, 1);
    assert_eq!(issue(&issues, "time of the one before").count, 1);
    assert_eq!(issue(&issues, "jumps away").count, 1);
    assert_eq!(issue(&issues, "invalid poses").count, 1);
    assert_eq!(issue(&issues, "range_min and range_max").count, 1);
    assert_eq!(issue(&issues, "not a number").count, 1);
    assert!(issue(&issues, "\"elsewhere\" is not in the transform tree").lost_data());
}

#[test]
fn sampling_skipping_and_fixed_poses() {
    let pose = |t: f64| {
        let pose =
            portolan_recording::Pose { position: [t, 0.0, 0.0], orientation_xyzw: [0.0, 0.0, 0.0, 1.0] };
        Message::PoseStamped(PoseStamped {
            header: portolan_recording::Header { stamp: at(t), frame_id: "gnss".into() },
            pose,
        })
    };
    let messages = robot((0..100).flat_map(|i| {
        let t = 0.1 * f64::from(i);
        [named("/scan", t, scan(t, "laser")), named("/pose", t, pose(t))]
    }));
    let mut options = IngestOptions {
        fixed_frame_pose_topic: Some("/pose".into()),
        skip: Duration::from_seconds(2.0),
        length: Some(Duration::from_seconds(4.95)),
        ..IngestOptions::default()
    };
    options.sampling.rangefinder = 0.5;
    let (found, _) = read(messages.clone(), &options);
    let poses = found.iter().filter(|m| m.0.kind == SensorKind::FixedFramePose).count();
    assert_eq!((poses, found.len() - poses), (50, 25));
    options.sampling.rangefinder = 2.0;
    assert!(Ingestion::new(&MemoryRecording::new(messages), &options).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn any_order_of_stamps_gives_ascending_times(
        stamps in prop::collection::vec((0u8..5, prop_oneof![9 => -2.0..20.0f64, 1 => -1e12..1e12f64], any::<bool>()), 1..200),
        subdivisions in 1usize..5,
    ) {
        let mut messages = robot([named("/scan", 0.0, scan(0.0, "laser"))]);
        for (i, (kind, stamp, wild)) in stamps.iter().enumerate() {
            let t = 0.05 * i as f64;
            let stamp = if *wild { *stamp } else { t };
            messages.push(match kind {
                0 => named("/scan", t, scan(stamp, "laser")),
                1 => named("/odom", t, odometry(stamp, t)),
                2 => named("/points", t, cloud(stamp, "laser")),
                3 => named("/imu", t, imu(stamp, [0.0, 0.0, 9.8])),
                _ => named("/tf", t, Message::Tf(moving("odom", "base_link", stamp, [t, 0.0, 0.0]))),
            });
        }
        let options = IngestOptions { num_subdivisions_per_laser_scan: subdivisions, ..IngestOptions::default() };
        let (found, _) = read(messages, &options);
        let mut last: BTreeMap<Arc<str>, Time> = BTreeMap::new();
        for (sensor, measurement) in found {
            let before = last.insert(sensor.id.clone(), measurement.time());
            prop_assert!(before.is_none_or(|b| b < measurement.time()));
        }
    }
}
