//! Compares with golden bytes: the output of ROS itself, assembled by hand.

use std::sync::Arc;

use portolan_geometry::Time;

use super::*;
use crate::{Header, Message, NavSatFix, PoseStamped};

fn decode(kind: MessageKind, encoding: Encoding, bytes: &[u8]) -> Result<Message, String> {
    Decoder::default().decode(kind, encoding, "/topic", bytes).map_err(|error| error.to_string())
}

/// Appends values with CDR alignment, in either byte order.
struct Golden {
    bytes: Vec<u8>,
    big_endian: bool,
}

impl Golden {
    fn new(big_endian: bool) -> Self {
        Self { bytes: vec![0, u8::from(!big_endian), 0, 0], big_endian }
    }

    fn put<const N: usize>(mut self, little_endian: [u8; N]) -> Self {
        while !(self.bytes.len() - 4).is_multiple_of(N) {
            self.bytes.push(0);
        }
        let mut bytes = little_endian;
        if self.big_endian {
            bytes.reverse();
        }
        self.bytes.extend(bytes);
        self
    }

    fn text(mut self, text: &str) -> Self {
        self = self.put((text.len() as u32 + 1).to_le_bytes());
        self.bytes.extend(text.as_bytes());
        self.bytes.push(0);
        self
    }

    fn header(self, frame: &str) -> Self {
        self.put(12i32.to_le_bytes()).put(345u32.to_le_bytes()).text(frame)
    }
}

fn header(frame: &str) -> Header {
    Header { stamp: Time::from_ros(12, 345), frame_id: frame.into() }
}

fn fix(frame: &str) -> NavSatFix {
    NavSatFix {
        header: header(frame),
        status: -1,
        service: 0x0203,
        latitude_degrees: 48.5,
        longitude_degrees: -11.25,
        altitude: 500.0,
        position_covariance: std::array::from_fn(|i| i as f64),
        position_covariance_type: 3,
    }
}

#[test]
fn cdr_is_aligned_and_of_either_byte_order() {
    for (big_endian, frame) in [(false, "gps"), (true, "gps"), (false, "gps_0"), (true, "")] {
        let mut golden = Golden::new(big_endian).header(frame);
        golden = golden.put((-1i8).to_le_bytes()).put(0x0203u16.to_le_bytes());
        for value in [48.5f64, -11.25, 500.0].into_iter().chain((0..9).map(f64::from)) {
            golden = golden.put(value.to_le_bytes());
        }
        let bytes = golden.put([3]).bytes;
        let expected = Message::NavSatFix(fix(frame));
        assert_eq!(decode(MessageKind::NavSatFix, Encoding::Cdr, &bytes).unwrap(), expected);
        // Recorders may pad the end.
        let padded = [bytes.as_slice(), &[0; 3]].concat();
        assert_eq!(decode(MessageKind::NavSatFix, Encoding::Cdr, &padded).unwrap(), expected);
        if !big_endian {
            // Stamps have a resolution of 100 ns.
            let mut written = encode(&expected, true, Vec::new()).unwrap();
            written[8..12].copy_from_slice(&345u32.to_le_bytes());
            assert_eq!(written, bytes);
        }
    }
}

#[test]
fn ros1_is_packed_and_numbered() {
    let mut bytes = vec![7, 0, 0, 0]; // sequence number
    bytes.extend(12u32.to_le_bytes());
    bytes.extend(345u32.to_le_bytes());
    bytes.extend(5u32.to_le_bytes());
    bytes.extend(b"/base");
    for value in 1..=7 {
        bytes.extend(f64::from(value).to_le_bytes());
    }
    let pose = crate::Pose { position: [1.0, 2.0, 3.0], orientation_xyzw: [4.0, 5.0, 6.0, 7.0] };
    let expected = Message::PoseStamped(PoseStamped { header: header("base"), pose });
    assert_eq!(decode(MessageKind::PoseStamped, Encoding::Ros1, &bytes).unwrap(), expected);
    bytes.push(0);
    let error = decode(MessageKind::PoseStamped, Encoding::Ros1, &bytes).unwrap_err();
    assert!(error.contains("longer"), "{error}");
}

#[test]
fn every_truncation_is_an_error_and_never_more() {
    let message = Message::NavSatFix(fix("gps"));
    for (encoding, is_cdr) in [(Encoding::Ros1, false), (Encoding::Cdr, true)] {
        let bytes = encode(&message, is_cdr, Vec::new()).unwrap();
        for length in 0..bytes.len() {
            assert!(decode(MessageKind::NavSatFix, encoding, &bytes[..length]).is_err(), "{length}");
        }
    }
}

#[test]
fn other_encapsulations_are_named() {
    for (code, expected) in [([0, 3], "parameter list"), ([0, 7], "XCDR2"), ([9, 9], "unknown")] {
        let bytes = [code.as_slice(), &[0; 100]].concat();
        let error = decode(MessageKind::Imu, Encoding::Cdr, &bytes).unwrap_err();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn stamps_that_ros_cannot_hold_are_refused() {
    for time in [Time::MIN, Time::MAX] {
        let header = Header { stamp: time, frame_id: "a".into() };
        let pose = crate::Pose { position: [0.0; 3], orientation_xyzw: [0.0; 4] };
        let message = Message::PoseStamped(PoseStamped { header, pose });
        assert!(encode(&message, true, Vec::new()).is_err());
        assert!(encode(&message, false, Vec::new()).is_err());
    }
}

#[test]
fn names_of_frames_are_shared() {
    let bytes = encode(&Message::NavSatFix(fix("gps")), true, Vec::new()).unwrap();
    let mut decoder = Decoder::default();
    let mut frame = || {
        let message = decoder.decode(MessageKind::NavSatFix, Encoding::Cdr, "/fix", &bytes).unwrap();
        message.header().unwrap().frame_id.clone()
    };
    assert!(Arc::ptr_eq(&frame(), &frame()));
}

#[test]
fn type_names_of_all_spellings_are_one() {
    for name in ["sensor_msgs/LaserScan", "sensor_msgs/msg/LaserScan", "sensor_msgs::msg::dds_::LaserScan_"] {
        assert_eq!(normalized_type_name(name), "sensor_msgs/LaserScan");
    }
    assert_eq!(MessageKind::from_type_name("sensor_msgs/CompressedImage"), None);
    assert_eq!(MessageKind::from_type_name("tf/tfMessage"), Some(MessageKind::Tf));
    assert!(is_static_tf_topic("/robot/tf_static") && is_static_tf_topic("tf_static"));
    assert!(!is_static_tf_topic("/tf") && !is_static_tf_topic("/not_tf_static"));
}

/// Definitions are complete: every type they name is defined in them.
#[test]
fn definitions_are_complete() {
    for kind in ["sensor_msgs/MultiEchoLaserScan", "nav_msgs/Odometry", "cartographer_ros_msgs/LandmarkList"]
    {
        let ros1 = definition(kind, Dialect::Ros1).unwrap();
        let ros2 = definition(kind, Dialect::Ros2).unwrap();
        assert!(ros1.contains("\ntime stamp\n") && !ros1.contains("builtin_interfaces"));
        assert!(ros2.contains("\nMSG: builtin_interfaces/Time\nint32 sec\n") && !ros2.contains("seq"));
        for text in [ros1, ros2] {
            let defined: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("MSG: ")).collect();
            let named = text.lines().filter(|line| !line.starts_with("MSG:"));
            for name in named.filter_map(|line| line.split([' ', '[']).next()).filter(|n| n.contains('/')) {
                assert_eq!(defined.iter().filter(|defined| **defined == name).count(), 1, "{name}\n{text}");
            }
        }
        assert!(md5sum(kind).is_some());
    }
}

#[test]
fn points_with_channels_are_a_cloud() {
    let mut bytes = vec![0; 12];
    bytes.extend(5u32.to_le_bytes());
    bytes.extend(b"laser");
    bytes.extend(2u32.to_le_bytes());
    (1..=6u8).for_each(|v| bytes.extend(f32::from(v).to_le_bytes()));
    bytes.extend(2u32.to_le_bytes());
    for (name, values) in [("intensity", vec![7.0f32, 8.0]), ("unfinished", vec![9.0f32])] {
        bytes.extend((name.len() as u32).to_le_bytes());
        bytes.extend(name.as_bytes());
        bytes.extend((values.len() as u32).to_le_bytes());
        values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    let kind = MessageKind::from_type_name("sensor_msgs/PointCloud").unwrap();
    let Message::PointCloud2(cloud) = decode(kind, Encoding::Ros1, &bytes).unwrap() else { panic!() };
    let names: Vec<&str> = cloud.fields.iter().map(|field| field.name.as_str()).collect();
    assert_eq!((names, cloud.width, cloud.point_step), (vec!["x", "y", "z", "intensity"], 2, 16));
    let values: Vec<f32> = cloud.data.chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(values, [1.0, 2.0, 3.0, 7.0, 4.0, 5.0, 6.0, 8.0]);
    for length in 0..bytes.len() {
        assert!(decode(kind, Encoding::Ros1, &bytes[..length]).is_err());
    }
}

#[test]
fn points_of_livox_are_a_cloud() {
    let mut bytes = vec![0; 4];
    bytes.extend(12u32.to_le_bytes());
    bytes.extend(0u32.to_le_bytes());
    bytes.extend(5u32.to_le_bytes());
    bytes.extend(b"livox");
    bytes.extend(77u64.to_le_bytes());
    bytes.extend(2u32.to_le_bytes());
    bytes.extend([1, 0, 0, 0]);
    bytes.extend(2u32.to_le_bytes());
    for i in 0..2u32 {
        bytes.extend((i * 5000).to_le_bytes());
        [1.0f32, 2.0, 3.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
        bytes.extend([9, 16, 3]);
    }
    let Message::PointCloud2(cloud) = decode(MessageKind::LivoxPoints, Encoding::Ros1, &bytes).unwrap()
    else {
        panic!()
    };
    assert_eq!((cloud.width, cloud.point_step, cloud.data.len()), (2, 20, 40));
    assert_eq!(cloud.data[36..], 5000u32.to_le_bytes());
    assert_eq!(cloud.data[12..16], 9.0f32.to_le_bytes());
    for length in 0..bytes.len() {
        assert!(decode(MessageKind::LivoxPoints, Encoding::Ros1, &bytes[..length]).is_err());
    }
}
