//! Reads synthetic bags of packets.

use portolan_geometry::{Duration, Time};

use super::*;
use crate::{MemoryRecording, PacketKind, PointCloud2, RecordedMessage, SensorPackets};

fn arrival() -> Time {
    Time::from_ros(1_700_000_000, 0)
}

/// A packet of a VLP-16: blocks start at an azimuth (hundredths of a degree) and are 40 apart; all ranges are
/// equal.
fn puck_packet(azimuth: u16, range: u16, microseconds: u32) -> Vec<u8> {
    let mut packet = Vec::new();
    for block in 0..12_u16 {
        packet.extend_from_slice(&[0xff, 0xee]);
        packet.extend_from_slice(&((azimuth + 40 * block) % 36_000).to_le_bytes());
        for channel in 0..32_u8 {
            packet.extend_from_slice(&range.to_le_bytes());
            packet.push(channel);
        }
    }
    packet.extend_from_slice(&microseconds.to_le_bytes());
    packet.extend_from_slice(&[0x37, 0x22]);
    packet
}

/// A packet of an Ouster with two beams in the legacy layout: 16 columns of 100 µs.
fn ouster_packet(frame: u16, first: u16, range: u32) -> Vec<u8> {
    let mut packet = Vec::new();
    for column in first..first + 16 {
        packet.extend_from_slice(&(u64::from(column) * 100_000).to_le_bytes());
        packet.extend_from_slice(&column.to_le_bytes());
        packet.extend_from_slice(&frame.to_le_bytes());
        packet.extend_from_slice(&0_u32.to_le_bytes());
        for _ in 0..2 {
            packet.extend_from_slice(&range.to_le_bytes());
            packet.extend_from_slice(&[0; 8]);
        }
        packet.extend_from_slice(&u32::MAX.to_le_bytes());
    }
    packet
}

fn imu_packet(nanoseconds: u64) -> Vec<u8> {
    let mut packet = vec![0; 48];
    packet[16..24].copy_from_slice(&nanoseconds.to_le_bytes());
    packet
}

fn clouds(messages: Vec<Message>) -> Vec<PointCloud2> {
    messages.into_iter().map(|m| if let Message::PointCloud2(c) = m { c } else { panic!() }).collect()
}

#[test]
fn bags_of_packets_are_read_as_clouds() {
    let header = Header { stamp: arrival(), frame_id: "velodyne_top".into() };
    let message = |i: u64| {
        let packet = |k: u64| {
            let azimuth = ((i * 10 + k) * 480 % 36_000) as u16;
            let time = arrival() + Duration::from_seconds((i * 10 + k) as f64 * 1.327e-3);
            (Some(time), puck_packet(azimuth, 1000, ((i * 10 + k) * 1327) as u32))
        };
        let packets = (0..10).map(packet).collect();
        RecordedMessage {
            topic: "/velodyne_packets".into(),
            log_time: arrival() + Duration::from_seconds(i as f64 * 1.327e-2),
            message: Message::SensorPackets(SensorPackets {
                kind: PacketKind::Velodyne,
                header: Some(header.clone()),
                packets,
            }),
        }
    };
    let recording = MemoryRecording::new((0..20).map(message).collect());
    let recording = unpacked(Box::new(recording)).unwrap();
    let topics = recording.topics();
    assert_eq!((&*topics[0].topic, &*topics[0].type_name), ("/velodyne_packets", "sensor_msgs/PointCloud2"));
    let mut reader = recording.read(&|_| true).unwrap();
    let messages: Vec<Message> =
        std::iter::from_fn(|| reader.next_message().unwrap()).map(|m| m.message).collect();
    let clouds = clouds(messages);
    assert_eq!(clouds.iter().map(|c| c.width).collect::<Vec<_>>(), [75 * 384, 75 * 384, 50 * 384]);
    assert_eq!(&*clouds[0].header.frame_id, "velodyne_top");
}

#[test]
fn lidar_and_imu_of_an_ouster_share_its_clock() {
    let metadata = r#"{"beam_intrinsics": {"beam_altitude_angles": [1.5, -1.5], "beam_azimuth_angles": [0, 1]},
        "lidar_data_format": {"columns_per_frame": 512, "columns_per_packet": 16}}"#;
    let kind_and_bytes = |i: u64| match i {
        0 => (PacketKind::OusterMetadata, "metadata", metadata.as_bytes().to_vec()),
        _ if i % 2 == 1 => (PacketKind::Ouster, "imu_packets", imu_packet(i * 10_000_000)),
        _ => {
            let packet = ouster_packet(i as u16, (i * 100) as u16, 4000);
            (PacketKind::Ouster, "lidar_packets", packet)
        }
    };
    let message = |i: u64| {
        let (kind, topic, bytes) = kind_and_bytes(i);
        // The first packet of the IMU is 8 ms late.
        let late = if i == 1 { 0.008 } else { 0.0 };
        RecordedMessage {
            topic: format!("/ouster/{topic}").as_str().into(),
            log_time: arrival() + Duration::from_seconds(i as f64 * 0.01 + late),
            message: Message::SensorPackets(SensorPackets {
                kind,
                header: None,
                packets: vec![(None, bytes)],
            }),
        }
    };
    let recording = MemoryRecording::new((0..10).map(message).collect());
    let recording = unpacked(Box::new(recording)).unwrap();
    let stamps = |wanted: &str| {
        let mut reader = recording.read(&|t| t.topic.contains(wanted)).unwrap();
        let messages = std::iter::from_fn(|| reader.next_message().unwrap());
        let stamp = |m: RecordedMessage| match m.message {
            Message::PointCloud2(cloud) => Some((0, cloud.header.stamp)),
            Message::Imu(imu) => Some((1, imu.header.stamp)),
            _ => None,
        };
        let stamps: Vec<(i32, Time)> = messages.filter_map(stamp).collect();
        let of = |kind: i32| stamps.iter().filter(|(k, _)| *k == kind).map(|s| s.1).collect::<Vec<_>>();
        (of(0), of(1))
    };
    let (lidar, imu) = stamps("ouster");
    // In the sensor's clock the first lidar packet is at 20 ms (column 200, 100 µs per column), the first IMU
    // packet at 10 ms.
    assert_eq!(imu[0] - lidar[0], Duration::from_seconds(0.01 - 0.02), "{lidar:?} {imu:?}");
    // Stamps do not depend on which topics are read.
    assert_eq!(stamps("imu").1, imu);
    assert_eq!(stamps("lidar").0, lidar);
}

#[test]
fn packets_of_new_firmware_are_read_from_bags() {
    let metadata = r#"{"beam_intrinsics": {"beam_altitude_angles": [1.5, -1.5], "beam_azimuth_angles": [0, 1]},
        "lidar_data_format": {"columns_per_frame": 512, "columns_per_packet": 8, "header_type": "FUSA",
        "udp_profile_lidar": "RNG15_RFL8_NIR8_ZONE16"}}"#;
    let header = |kind: u8| {
        let mut packet = vec![kind, 5, 0, 0];
        packet.resize(32, 0);
        packet
    };
    let lidar = |frame: u8| {
        let mut packet = header(1);
        packet[7] = frame; // the highest of 32 bits
        for column in 0..8_u16 {
            packet.extend_from_slice(&[0; 8]);
            packet.extend_from_slice(&column.to_le_bytes());
            packet.extend_from_slice(&[1, 0]);
            // Range and reflectivity, then zones.
            (0..2).for_each(|_| packet.extend_from_slice(&[0xf4, 0x01, 9, 0, 0xff, 0xff, 0, 0]));
        }
        packet.extend_from_slice(&[0; 32]);
        packet
    };
    let mut imu = header(2);
    imu.resize(132, 0);
    (0..4).for_each(|_| imu.extend_from_slice(&[[0; 10].as_slice(), &[1], &[0; 25]].concat()));
    imu.extend_from_slice(&[0; 32]);
    let mut zones = header(3);
    zones.resize(680, 0);
    let messages = [
        (PacketKind::OusterMetadata, "metadata", metadata.as_bytes().to_vec()),
        (PacketKind::Ouster, "zone_packets", zones),
        (PacketKind::Ouster, "imu_packets", imu),
        (PacketKind::Ouster, "lidar_packets", lidar(1)),
        (PacketKind::Ouster, "lidar_packets", lidar(2)),
    ];
    let message = |(kind, topic, bytes): (PacketKind, &str, Vec<u8>)| RecordedMessage {
        topic: format!("/ouster/{topic}").as_str().into(),
        log_time: arrival(),
        message: Message::SensorPackets(SensorPackets { kind, header: None, packets: vec![(None, bytes)] }),
    };
    let recording = MemoryRecording::new(messages.into_iter().map(message).collect());
    let recording = unpacked(Box::new(recording)).unwrap();
    let mut reader = recording.read(&|_| true).unwrap();
    let messages: Vec<Message> =
        std::iter::from_fn(|| reader.next_message().unwrap()).map(|m| m.message).collect();
    let widths: Vec<u32> = messages
        .iter()
        .filter_map(|m| if let Message::PointCloud2(c) = m { Some(c.width) } else { None })
        .collect();
    assert_eq!(widths, [16, 16]);
    assert_eq!(messages.iter().filter(|m| matches!(m, Message::Imu(_))).count(), 4);
    assert!(reader.issues().iter().all(|issue| !issue.lost_data()), "{:?}", reader.issues());
}
