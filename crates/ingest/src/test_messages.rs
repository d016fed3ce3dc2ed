//! Messages for tests, here and in `portolan-diagnose`. Times are seconds since some start.

use portolan_geometry::{Duration, Time};
use portolan_recording::{
    FieldType, Header, Imu, LaserScan, Message, Odometry, PointCloud2, PointField, Pose, RecordedMessage,
    TfMessage, TransformStamped,
};

pub(crate) fn at(seconds: f64) -> Time {
    Time::from_ros(1_700_000_000, 0) + Duration::from_seconds(seconds)
}

pub(crate) fn named(topic: &str, log_seconds: f64, message: Message) -> RecordedMessage {
    RecordedMessage { topic: topic.into(), log_time: at(log_seconds), message }
}

fn header(seconds: f64, frame: &str) -> Header {
    Header { stamp: at(seconds), frame_id: frame.into() }
}

/// 90 beams over 180°, at 2 m.
pub(crate) fn scan(seconds: f64, frame: &str) -> Message {
    Message::LaserScan(LaserScan {
        header: header(seconds, frame),
        angle_min: -1.57,
        angle_max: 1.57,
        angle_increment: 2.0 * 1.57 / 89.0,
        time_increment: 0.0,
        scan_time: 0.05,
        range_min: 0.1,
        range_max: 30.0,
        ranges: vec![2.0; 90],
        intensities: Vec::new(),
    })
}

/// A cloud of one row whose points have these fields, with a byte of padding.
pub(crate) fn cloud_of(fields: &[(&str, FieldType)], points: &[Vec<f64>], big: bool) -> PointCloud2 {
    let mut offset = 0;
    let mut described = Vec::new();
    for &(name, field_type) in fields {
        described.push(PointField { name: name.into(), offset, field_type: Some(field_type), count: 1 });
        offset += field_type.size_bytes() as u32;
    }
    let step = offset + 1;
    let mut data = Vec::new();
    for point in points {
        for ((_, field_type), value) in fields.iter().zip(point) {
            let mut bytes = match field_type {
                FieldType::Int8 => (*value as i8).to_le_bytes().to_vec(),
                FieldType::Uint8 => (*value as u8).to_le_bytes().to_vec(),
                FieldType::Int16 => (*value as i16).to_le_bytes().to_vec(),
                FieldType::Uint16 => (*value as u16).to_le_bytes().to_vec(),
                FieldType::Int32 => (*value as i32).to_le_bytes().to_vec(),
                FieldType::Uint32 => (*value as u32).to_le_bytes().to_vec(),
                FieldType::Float32 => (*value as f32).to_le_bytes().to_vec(),
                FieldType::Float64 => value.to_le_bytes().to_vec(),
            };
            if big {
                bytes.reverse();
            }
            data.extend(bytes);
        }
        data.push(0xee);
    }
    PointCloud2 {
        header: header(0.0, "lidar"),
        height: 1,
        width: points.len() as u32,
        fields: described,
        is_bigendian: big,
        point_step: step,
        row_step: step * points.len() as u32,
        data,
        is_dense: true,
    }
}

/// Four rings all around.
pub(crate) fn cloud(seconds: f64, frame: &str) -> Message {
    let fields = [
        ("x", FieldType::Float32),
        ("y", FieldType::Float32),
        ("z", FieldType::Float32),
        ("time", FieldType::Float32),
    ];
    let mut points = Vec::new();
    for i in 0..720 {
        let angle = f64::from(i) / 720.0 * std::f64::consts::TAU;
        // No two clouds are the same.
        let range = 5.0 + 1e-5 * (100.0 * seconds + f64::from(i)).sin();
        for z in [-0.5, 0.0, 0.5, 1.0] {
            points.push(vec![range * angle.cos(), range * angle.sin(), z, 0.05 * f64::from(i) / 720.0]);
        }
    }
    let mut cloud = cloud_of(&fields, &points, false);
    cloud.header = header(seconds, frame);
    Message::PointCloud2(cloud)
}

pub(crate) fn imu(seconds: f64, linear_acceleration: [f64; 3]) -> Message {
    Message::Imu(Imu {
        header: header(seconds, "imu_link"),
        orientation_xyzw: [0.0, 0.0, 0.0, 1.0],
        orientation_covariance: [0.0; 9],
        angular_velocity: [0.0; 3],
        angular_velocity_covariance: [0.0; 9],
        linear_acceleration,
        linear_acceleration_covariance: [0.0; 9],
    })
}

pub(crate) fn odometry(seconds: f64, x: f64) -> Message {
    Message::Odometry(Odometry {
        header: header(seconds, "odom"),
        child_frame_id: "base_link".into(),
        pose: Pose { position: [x, 0.0, 0.0], orientation_xyzw: [0.0, 0.0, 0.0, 1.0] },
        pose_covariance: Vec::new(),
        linear_velocity: [0.0; 3],
        angular_velocity: [0.0; 3],
        twist_covariance: Vec::new(),
    })
}

/// Static transforms: parent, child, position, and yaw; a yaw of 99 means that the third coordinate of the
/// position is the pitch.
pub(crate) fn fixed(transforms: &[(&str, &str, [f64; 3], f64)]) -> TfMessage {
    let transform = |(parent, child, [x, y, z], yaw): &(&str, &str, [f64; 3], f64)| {
        let (position, orientation_xyzw) = if *yaw == 99.0 {
            ([*x, *y, 0.0], [0.0, (z / 2.0).sin(), 0.0, (z / 2.0).cos()])
        } else {
            ([*x, *y, *z], [0.0, 0.0, (yaw / 2.0).sin(), (yaw / 2.0).cos()])
        };
        let transform = Pose { position, orientation_xyzw };
        TransformStamped { header: header(0.0, parent), child_frame_id: (*child).into(), transform }
    };
    TfMessage { is_static: true, transforms: transforms.iter().map(transform).collect() }
}

pub(crate) fn moving(parent: &str, child: &str, seconds: f64, position: [f64; 3]) -> TfMessage {
    let transform = Pose { position, orientation_xyzw: [0.0, 0.0, 0.0, 1.0] };
    let transform =
        TransformStamped { header: header(seconds, parent), child_frame_id: child.into(), transform };
    TfMessage { is_static: false, transforms: vec![transform] }
}
