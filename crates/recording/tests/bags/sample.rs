//! Messages and small recordings for the tests.

use std::path::Path;
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_issue::Issue;
use portolan_recording::*;

/// A moment in whole ticks, so that it survives every format.
pub fn time(ticks: i64) -> Time {
    Time::from_ros(1_700_000_000, 0) + portolan_geometry::Duration::from_ticks(ticks)
}

fn header(n: i64) -> Header {
    // Names of every length try every alignment behind them.
    let frame_id: Arc<str> = "a_laser_frame"[..(n % 13) as usize].into();
    Header { stamp: time(n), frame_id }
}

fn pose(n: i64) -> Pose {
    let n = n as f64;
    Pose { position: [n, -2.5, 0.125 * n], orientation_xyzw: [0.1, 0.2, n, 0.9] }
}

fn floats(count: i64, scale: f32) -> Vec<f32> {
    (0..count).map(|i| i as f32 * scale).collect()
}

/// One message of every kind; `n` varies content and lengths.
pub fn every_kind(n: i64) -> Vec<(&'static str, Message)> {
    let covariance = |scale: f64| std::array::from_fn(|i| i as f64 * scale);
    vec![
        (
            "/scan",
            Message::LaserScan(LaserScan {
                header: header(n),
                angle_min: -1.5,
                angle_max: 1.5,
                angle_increment: 0.01,
                time_increment: 1e-4,
                scan_time: 0.1,
                range_min: 0.05,
                range_max: 30.0,
                ranges: floats(n % 50, 0.1),
                intensities: floats(n % 3, 100.0),
            }),
        ),
        (
            "/echoes",
            Message::MultiEchoLaserScan(MultiEchoLaserScan {
                header: header(n + 1),
                angle_min: -1.0,
                angle_max: 1.0,
                angle_increment: 0.02,
                time_increment: 0.0,
                scan_time: 0.05,
                range_min: 0.1,
                range_max: 10.0,
                ranges: (0..n % 5).map(|i| floats(i, 0.3)).collect(),
                intensities: vec![],
            }),
        ),
        (
            "/points",
            Message::PointCloud2(PointCloud2 {
                header: header(n + 2),
                height: 1,
                width: 3,
                fields: vec![
                    PointField {
                        name: "x".into(),
                        offset: 0,
                        field_type: Some(FieldType::Float32),
                        count: 1,
                    },
                    PointField { name: "odd".into(), offset: 4, field_type: None, count: 2 },
                ],
                is_bigendian: false,
                point_step: 7,
                row_step: 21,
                data: (0..21).map(|i| (i * n) as u8).collect(),
                is_dense: true,
            }),
        ),
        (
            "/imu",
            Message::Imu(Imu {
                header: header(n + 3),
                orientation_xyzw: [0.0, 0.0, 0.0, 1.0],
                orientation_covariance: covariance(0.1),
                angular_velocity: [0.1, -0.2, n as f64],
                angular_velocity_covariance: covariance(0.2),
                linear_acceleration: [0.0, 0.0, 9.81],
                linear_acceleration_covariance: covariance(0.3),
            }),
        ),
        (
            "/odom",
            Message::Odometry(Odometry {
                header: header(n + 4),
                child_frame_id: "base_link".into(),
                pose: pose(n),
                pose_covariance: covariance_6x6(0.01),
                linear_velocity: [1.0, 0.0, 0.0],
                angular_velocity: [0.0, 0.0, 0.3],
                twist_covariance: covariance_6x6(0.02),
            }),
        ),
        (
            "/fix",
            Message::NavSatFix(NavSatFix {
                header: header(n + 5),
                status: -1,
                service: 513,
                latitude_degrees: 48.1,
                longitude_degrees: 11.5,
                altitude: 517.1,
                position_covariance: covariance(1.0),
                position_covariance_type: 2,
            }),
        ),
        ("/tf", tf(n, false)),
        ("/tf_static", tf(n + 1, true)),
        ("/tracked_pose", Message::PoseStamped(PoseStamped { header: header(n + 6), pose: pose(n) })),
        (
            "/landmark",
            Message::LandmarkList(LandmarkList {
                header: header(n + 7),
                landmarks: (0..n % 4)
                    .map(|i| LandmarkEntry {
                        id: "landmark_7"[..(i + 5) as usize].to_owned(),
                        tracking_from_landmark: pose(i),
                        translation_weight: 1e3,
                        rotation_weight: 1e2,
                    })
                    .collect(),
            }),
        ),
    ]
}

fn covariance_6x6(scale: f64) -> Vec<f64> {
    (0..36).map(|i| f64::from(i) * scale).collect()
}

fn tf(n: i64, is_static: bool) -> Message {
    let transform = |i| TransformStamped {
        header: header(n + i),
        child_frame_id: "base_footprint"[..(i + 1) as usize].into(),
        transform: pose(i),
    };
    Message::Tf(TfMessage { is_static, transforms: (0..n % 6).map(transform).collect() })
}

/// `rounds` times every kind, in order of log time.
pub fn recorded(rounds: i64) -> Vec<RecordedMessage> {
    let mut messages = Vec::new();
    for n in 0..rounds {
        for (topic, message) in every_kind(n) {
            let log_time = time(messages.len() as i64 * 12_345);
            messages.push(RecordedMessage { topic: topic.into(), log_time, message });
        }
    }
    messages
}

/// Writes messages.
pub fn write(path: &Path, format: Option<RecordingFormat>, messages: &[RecordedMessage]) {
    let mut writer = create(path, format).unwrap();
    for message in messages {
        writer.write(message).unwrap();
    }
    writer.finish().unwrap();
}

/// The bytes of a recording of these messages.
pub fn bytes(format: RecordingFormat, messages: &[RecordedMessage]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording");
    write(&path, Some(format), messages);
    std::fs::read(&path).unwrap()
}

/// Reads everything; the second part is what was repaired.
pub fn read_all(recording: &dyn Recording) -> (Vec<RecordedMessage>, Vec<Issue>) {
    let mut reader = recording.read(&|_| true).unwrap();
    let mut messages = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        messages.push(message);
    }
    (messages, reader.issues())
}

/// Compares messages one by one, so that a difference is reported readably.
pub fn assert_same(found: &[RecordedMessage], expected: &[RecordedMessage]) {
    for (number, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert_eq!(found.topic, expected.topic, "message {number}");
        assert_eq!(found.log_time, expected.log_time, "message {number}");
        assert_eq!(found.message, expected.message, "message {number}");
    }
    assert_eq!(found.len(), expected.len());
}

/// Every format that can be written.
pub const FORMATS: [RecordingFormat; 6] = [
    RecordingFormat::Ros1Bag(BagCompression::None),
    RecordingFormat::Ros1Bag(BagCompression::Lz4),
    RecordingFormat::Ros1Bag(BagCompression::Bz2),
    RecordingFormat::Mcap(McapCompression::None),
    RecordingFormat::Mcap(McapCompression::Lz4),
    RecordingFormat::Mcap(McapCompression::Zstd),
];
