//! Packets made by hand, and random ones.

use portolan_geometry::{Duration, Time};
use proptest::prelude::*;

use super::ouster_metadata::PacketProfile;
use super::velodyne_models::PACKET_BYTES;
use super::*;
use crate::PointCloud2;

fn arrival() -> Time {
    Time::from_ros(1_700_000_000, 0)
}

/// A packet of a VLP-16: blocks from an azimuth (hundredths of a degree) on, 40 apart, all ranges the same.
fn puck_packet(azimuth: u16, range: u16, microseconds: u32, mode: u8, product: u8) -> Vec<u8> {
    let mut packet = Vec::new();
    for block in 0..12_u16 {
        let step = if mode == 0x39 { block / 2 } else { block };
        packet.extend_from_slice(&[0xff, 0xee]);
        packet.extend_from_slice(&((azimuth + 40 * step) % 36_000).to_le_bytes());
        for channel in 0..32_u8 {
            packet.extend_from_slice(&range.to_le_bytes());
            packet.push(channel);
        }
    }
    packet.extend_from_slice(&microseconds.to_le_bytes());
    packet.extend_from_slice(&[mode, product]);
    assert_eq!(packet.len(), PACKET_BYTES);
    packet
}

fn points(cloud: &PointCloud2) -> Vec<([f32; 3], f32, u16, f32)> {
    let point = |b: &[u8]| {
        let xyz = [0, 4, 8].map(|at| f32_at(b, at));
        (xyz, f32_at(b, 12), u16::from_le_bytes([b[16], b[17]]), f32_at(b, 18))
    };
    cloud.data.chunks_exact(cloud.point_step as usize).map(point).collect()
}

fn decode(source: &PacketSource, packets: &[(Vec<u8>, Time)]) -> (Vec<Message>, Vec<crate::Repair>) {
    let (mut decoder, mut repairs, mut messages) =
        (source.decoder("lidar"), RepairLog::default(), Vec::new());
    let mut clock = SensorTime::default();
    for (packet, time) in packets {
        decoder.push((packet, *time), &mut clock, &mut repairs, &mut |message| messages.push(message));
    }
    messages.extend(decoder.finish());
    (messages, repairs.list())
}

fn clouds(messages: Vec<Message>) -> Vec<PointCloud2> {
    messages.into_iter().map(|m| if let Message::PointCloud2(c) = m { c } else { panic!() }).collect()
}

#[test]
fn a_puck_measures_where_its_beams_point() {
    // The sensor's clock counts from the hour, 1700000000 s is 20 min before one.
    let microseconds = (1_700_000_000_u64 % 3600 * 1_000_000) as u32;
    let packets = [
        (puck_packet(9000, 2500, microseconds, 0x37, 0x22), arrival()),
        (
            puck_packet(9480, 2500, microseconds + 1327, 0x37, 0x22),
            arrival() + Duration::from_seconds(0.0013),
        ),
    ];
    let (messages, repairs) = decode(&PacketSource::Velodyne(None), &packets);
    assert!(repairs.is_empty(), "{repairs:?}");
    let clouds = clouds(messages);
    assert_eq!((clouds.len(), clouds[0].width), (1, 2 * 12 * 32));
    assert_eq!(clouds[0].header.stamp, arrival());
    let all = points(&clouds[0]);
    // Channel 0: 15° down, 5 m, azimuth 90° clockwise is to the right.
    let ([x, y, z], intensity, ring, time) = all[0];
    assert!(x.abs() < 1e-5 && (y + 5.0 * 15f32.to_radians().cos()).abs() < 1e-5);
    assert!((z + 5.0 * 15f32.to_radians().sin()).abs() < 1e-5 && (intensity, ring, time) == (0.0, 0, 0.0));
    // Channel 15 points 15° up, 34.56 µs later; channel 16 is the next firing.
    assert!(all[15].2 == 15 && (all[15].0[2] - 5.0 * 15f32.to_radians().sin()).abs() < 1e-5);
    assert!((all[15].3 - 34.56e-6).abs() < 2e-7 && (all[16].3 - 55.296e-6).abs() < 2e-7);
    // Half a block later the head has turned by half a step.
    let angle = |p: &([f32; 3], f32, u16, f32)| -p.0[1].atan2(p.0[0]).to_degrees();
    assert!((angle(&all[16]) - 90.2).abs() < 1e-3, "{}", angle(&all[16]));
    assert!((all[12 * 32].3 - 1327e-6).abs() < 1e-6);
}

#[test]
fn turns_are_cut_at_azimuth_zero_and_equal_returns_count_once() {
    let packets: Vec<_> = (0..160_u64)
        .map(|i| {
            let azimuth = (i * 480 % 36_000) as u16;
            let time = arrival() + Duration::from_seconds(i as f64 * 1.327e-3);
            (puck_packet(azimuth, 1000, (i * 1327) as u32, 0x37, 0x22), time)
        })
        .collect();
    let (messages, repairs) = decode(&PacketSource::Velodyne(None), &packets);
    let widths: Vec<u32> = clouds(messages).iter().map(|c| c.width).collect();
    assert_eq!(widths, [75 * 384, 75 * 384, 10 * 384]);
    // That clock was not set.
    assert!(repairs.iter().any(|r| r.what.contains("shifted") && r.count == 1), "{repairs:?}");
    let dual = [(puck_packet(0, 1000, 0, 0x39, 0x28), arrival())];
    let (messages, _) = decode(&PacketSource::Velodyne(None), &dual);
    let cloud = &clouds(messages)[0];
    assert_eq!(cloud.width, 6 * 32);
    // A VLP-32C counts in 4 mm.
    let [x, y, z] = points(cloud)[1].0;
    assert!(((x * x + y * y + z * z).sqrt() - 4.0).abs() < 1e-4);
    // Its second beam points 1° down and 4.2° to the left of the block's azimuth.
    assert!((y.atan2(x).to_degrees() - 4.2).abs() < 1e-3 && (z + 4.0 * 1f32.to_radians().sin()).abs() < 1e-4);
}

#[test]
fn a_calibration_replaces_nominal_angles() {
    let mut text = String::from("lasers:\n");
    for i in 0..64 {
        text += &format!(
            "- {{dist_correction: 0.5, laser_id: {i}, rot_correction: 0.0,\n   vert_correction: {}, vert_offset_correction: 0.1}}\n",
            0.01 * f64::from(i)
        );
    }
    let lasers = parse_calibration(&text).unwrap();
    assert_eq!((lasers.len(), lasers[3].elevation, lasers[3].vertical_offset), (64, 0.03, 0.1));
    let mut packet = puck_packet(0, 1000, 0, 0x37, 0x22);
    packet[100] = 0xff;
    packet[101] = 0xdd;
    let (messages, repairs) = decode(&PacketSource::Velodyne(Some(lasers)), &[(packet.clone(), arrival())]);
    let cloud = &clouds(messages)[0];
    let lower = points(cloud)[32];
    assert_eq!(lower.2, 32);
    assert!((lower.0[0] - (2.5 * 0.32f32.cos() - 0.1 * 0.32f32.sin())).abs() < 1e-3, "{lower:?}");
    assert!(!repairs.iter().any(|r| r.what.contains("nominal")));
    let (_, repairs) = decode(&PacketSource::Velodyne(None), &[(packet, arrival())]);
    assert!(repairs.iter().any(|r| r.what.contains("nominal")));
    assert!(parse_calibration("lasers:\n- {laser_id: 99999}\n").is_none() && parse_calibration("").is_none());
}

fn ouster_packet(profile: PacketProfile, channels: usize, frame: u16, first: u16, range: u32) -> Vec<u8> {
    let is_legacy = profile == PacketProfile::Legacy;
    let mut packet = if is_legacy { Vec::new() } else { vec![0; 32] };
    if !is_legacy {
        packet[2..4].copy_from_slice(&frame.to_le_bytes());
    }
    for column in first..first + 16 {
        packet.extend_from_slice(&(u64::from(column) * 100_000).to_le_bytes());
        packet.extend_from_slice(&column.to_le_bytes());
        if is_legacy {
            packet.extend_from_slice(&frame.to_le_bytes());
            packet.extend_from_slice(&0_u32.to_le_bytes());
        } else {
            packet.extend_from_slice(&1_u16.to_le_bytes());
        }
        for _ in 0..channels {
            let mut bytes =
                vec![0; [12, 12, 4, 16, 8][PacketProfile::ALL.iter().position(|p| *p == profile).unwrap()]];
            match profile {
                PacketProfile::LowData | PacketProfile::LowDataDual => {
                    bytes[..2].copy_from_slice(&((range / 8) as u16).to_le_bytes());
                }
                _ => bytes[..4].copy_from_slice(&range.to_le_bytes()),
            }
            packet.extend(bytes);
        }
        if is_legacy {
            packet.extend_from_slice(&u32::MAX.to_le_bytes());
        }
    }
    packet.extend(vec![0; if is_legacy { 0 } else { 32 }]);
    packet
}

#[test]
fn all_layouts_of_ouster_give_the_same_sphere() {
    let mut metadata = OusterMetadata::assumed(64, 1024);
    metadata.beam_origin = 0.02;
    for profile in PacketProfile::ALL {
        let layout = PacketLayout { profile, channels: 64, columns: 16 };
        let packets: Vec<_> = [(7, 0), (7, 256), (8, 0)]
            .map(|(frame, first)| (ouster_packet(profile, 64, frame, first, 4000), arrival()))
            .to_vec();
        assert_eq!(packets[0].0.len(), layout.packet_bytes(), "{profile:?}");
        let source = PacketSource::OusterLidar(Box::new(metadata.clone()), layout);
        let (messages, repairs) = decode(&source, &packets);
        let clouds = clouds(messages);
        assert_eq!(clouds.iter().map(|c| c.width).collect::<Vec<_>>(), [2048, 1024], "{profile:?}");
        assert!(repairs.iter().any(|r| r.what.contains("shifted")));
        let all = points(&clouds[0]);
        for ([x, y, z], ..) in &all {
            let z = z - 0.03618;
            let across = (x * x + y * y).sqrt() - 0.02;
            assert!(((across * across + z * z).sqrt() - 3.98).abs() < 2e-3, "{profile:?} {x} {y} {z}");
        }
        // Column 0 looks along −x of the lidar's frame turned by half a turn: ahead is +x of the sensor
        // at half a turn of the encoder.
        let ([x, y, _], _, ring, time) = all[1];
        assert!(x < 0.0 && y.abs() < 0.1 * x.abs() && ring == 62 && time == 0.0, "{x} {y}");
        // A quarter of a turn on, clockwise.
        let ([x, y, _], ..) = all[1024 + 1];
        assert!(y > 0.0 && x.abs() < 0.1 * y, "{x} {y}");
        assert!((all[1024].3 - 0.0256).abs() < 1e-6);
    }
}

#[test]
fn metadata_are_read_at_any_depth_and_nonsense_is_not() {
    let text = r#"{"beam_intrinsics": {"beam_altitude_angles": [1.5, -1.5], "beam_azimuth_angles": [0, 1],
        "lidar_origin_to_beam_origin_mm": 20}, "lidar_data_format": {"columns_per_frame": 512,
        "columns_per_packet": 16}, "config_params": {"udp_profile_lidar": "RNG15_RFL8_NIR8"}}"#;
    let metadata = OusterMetadata::parse(text).unwrap();
    assert_eq!((metadata.altitudes.len(), metadata.columns_per_frame, metadata.beam_origin), (2, 512, 0.02));
    assert_eq!(metadata.profile, Some(PacketProfile::LowData));
    let legacy = r#"{"beam_altitude_angles": [1.5], "beam_azimuth_angles": [0], "lidar_mode": "2048x10"}"#;
    assert_eq!(OusterMetadata::parse(legacy).unwrap().columns_per_frame, 2048);
    for wrong in ["", "{}", "[1]", r#"{"beam_altitude_angles": [1e9], "beam_azimuth_angles": [0]}"#] {
        assert!(OusterMetadata::parse(wrong).is_none());
    }
}

#[test]
fn bags_of_packets_are_read_as_clouds() {
    let header = crate::Header { stamp: arrival(), frame_id: "velodyne_top".into() };
    let message = |i: u64| {
        let packet = |k: u64| {
            let azimuth = ((i * 10 + k) * 480 % 36_000) as u16;
            let time = arrival() + Duration::from_seconds((i * 10 + k) as f64 * 1.327e-3);
            (Some(time), puck_packet(azimuth, 1000, ((i * 10 + k) * 1327) as u32, 0x37, 0x22))
        };
        let packets = (0..10).map(packet).collect();
        crate::RecordedMessage {
            topic: "/velodyne_packets".into(),
            log_time: arrival() + Duration::from_seconds(i as f64 * 1.327e-2),
            message: Message::SensorPackets(crate::SensorPackets {
                kind: crate::PacketKind::Velodyne,
                header: Some(header.clone()),
                packets,
            }),
        }
    };
    let recording = crate::MemoryRecording::new((0..20).map(message).collect());
    let recording = unpacked(Box::new(recording)).unwrap();
    let topics = crate::Recording::topics(&*recording);
    assert_eq!((&*topics[0].topic, &*topics[0].type_name), ("/velodyne_packets", "sensor_msgs/PointCloud2"));
    let mut reader = crate::Recording::read(&*recording, &|_| true).unwrap();
    let messages: Vec<Message> =
        std::iter::from_fn(|| reader.next_message().unwrap()).map(|m| m.message).collect();
    let clouds = clouds(messages);
    assert_eq!(clouds.iter().map(|c| c.width).collect::<Vec<_>>(), [75 * 384, 75 * 384, 50 * 384]);
    assert_eq!(&*clouds[0].header.frame_id, "velodyne_top");
}

#[test]
fn imu_packets_are_in_si_units() {
    let mut packet = vec![0; 48];
    packet[16..24].copy_from_slice(&5_000_000_000_u64.to_le_bytes());
    packet[32..36].copy_from_slice(&1.0_f32.to_le_bytes());
    packet[36..40].copy_from_slice(&180.0_f32.to_le_bytes());
    let (messages, _) = decode(&PacketSource::OusterImu, &[(packet, arrival())]);
    let Message::Imu(imu) = &messages[0] else { panic!() };
    assert_eq!(imu.linear_acceleration, [0.0, 0.0, 9.80665]);
    assert!((imu.angular_velocity[0] - std::f64::consts::PI).abs() < 1e-12);
    assert_eq!(imu.header.stamp, arrival());
}

/// Packets of 400 turns' parts, 1.327 ms apart, the sensor's clock ahead of arrival by some seconds each.
fn pucks(ahead: impl Fn(u64) -> f64) -> Vec<(Vec<u8>, Time)> {
    let start = 1_700_000_000_u64 % 3600 * 1_000_000;
    let packet = |i: u64| {
        let microseconds = (start + i * 1327) as f64 + 1e6 * ahead(i);
        let microseconds = microseconds.rem_euclid(3.6e9) as u32;
        let packet = puck_packet((i * 480 % 36_000) as u16, 1000, microseconds, 0x37, 0x22);
        (packet, arrival() + Duration::from_seconds(i as f64 * 1.327e-3))
    };
    (0..400).map(packet).collect()
}

#[test]
fn a_clock_that_jumps_goes_on_as_before() {
    let stamps = |packets: &[(Vec<u8>, Time)]| {
        let (messages, repairs) = decode(&PacketSource::Velodyne(None), packets);
        (clouds(messages).iter().map(|c| c.header.stamp).collect::<Vec<_>>(), repairs)
    };
    let (expected, repairs) = stamps(&pucks(|_| 0.0));
    assert!(expected.len() == 6 && repairs.is_empty(), "{repairs:?}");
    for jump in [5.0, -5.0, 1200.0, 2400.0, -1200.0] {
        let (stamps, repairs) = stamps(&pucks(|i| if i < 200 { 0.0 } else { jump }));
        assert_eq!(stamps, expected, "{jump} s");
        let counted: Vec<u64> =
            repairs.iter().filter(|r| r.what.contains("jumped")).map(|r| r.count).collect();
        assert_eq!((counted, repairs.len()), (vec![1], 1), "{jump} s: {repairs:?}");
    }
    // One damaged time is there and back.
    let (stamps, repairs) = stamps(&pucks(|i| if i == 100 { 60.0 } else { 0.0 }));
    assert!(stamps == expected && repairs[0].count == 2, "{repairs:?}");
}

#[test]
fn recorders_that_hang_and_gaps_are_no_jumps_of_the_clock() {
    let with = |arrival_delay: &dyn Fn(usize) -> f64, keep: &dyn Fn(usize) -> bool| {
        let packets = pucks(|_| 0.0).into_iter().enumerate().filter(|(i, _)| keep(*i));
        let late = packets.map(|(i, (p, t))| (p, t + Duration::from_seconds(arrival_delay(i))));
        decode(&PacketSource::Velodyne(None), &late.collect::<Vec<_>>()).1
    };
    let repairs = with(&|i| if (100..200).contains(&i) { 3.0 } else { 0.0 }, &|_| true);
    assert!(repairs.is_empty(), "{repairs:?}");
    // A pause of 40 min, by both clocks.
    let pause = |i: u64| if i < 200 { 0.0 } else { 2400.0 };
    let packets = pucks(pause).into_iter().enumerate();
    let packets: Vec<_> =
        packets.map(|(i, (p, t))| (p, t + Duration::from_seconds(pause(i as u64)))).collect();
    let (messages, repairs) = decode(&PacketSource::Velodyne(None), &packets);
    assert!(repairs.is_empty(), "{repairs:?}");
    let stamps: Vec<Time> = clouds(messages).iter().map(|c| c.header.stamp).collect();
    assert!((stamps[stamps.len() - 1] - stamps[0]).seconds() > 2400.0);
}

#[test]
fn packets_that_come_twice_count_once() {
    let once = pucks(|_| 0.0);
    let twice: Vec<_> = once.iter().flat_map(|packet| [packet.clone(), packet.clone()]).collect();
    let (expected, _) = decode(&PacketSource::Velodyne(None), &once);
    let (messages, repairs) = decode(&PacketSource::Velodyne(None), &twice);
    assert_eq!(messages, expected);
    assert_eq!((repairs.len(), repairs[0].count, repairs[0].lost_data), (1, 400, false), "{repairs:?}");
    assert!(repairs[0].what.contains("exact repetitions"), "{repairs:?}");
}

fn imu_packet(nanoseconds: u64) -> Vec<u8> {
    let mut packet = vec![0; 48];
    packet[16..24].copy_from_slice(&nanoseconds.to_le_bytes());
    packet
}

#[test]
fn lidar_and_imu_of_an_ouster_share_its_clock() {
    let metadata = r#"{"beam_intrinsics": {"beam_altitude_angles": [1.5, -1.5], "beam_azimuth_angles": [0, 1]},
        "lidar_data_format": {"columns_per_frame": 512, "columns_per_packet": 16}}"#;
    let kind_and_bytes = |i: u64| match i {
        0 => (crate::PacketKind::OusterMetadata, "metadata", metadata.as_bytes().to_vec()),
        _ if i % 2 == 1 => (crate::PacketKind::Ouster, "imu_packets", imu_packet(i * 10_000_000)),
        _ => {
            let packet = ouster_packet(PacketProfile::Legacy, 2, i as u16, (i * 100) as u16, 4000);
            (crate::PacketKind::Ouster, "lidar_packets", packet)
        }
    };
    let message = |i: u64| {
        let (kind, topic, bytes) = kind_and_bytes(i);
        // The first packet of the IMU is 8 ms late.
        let late = if i == 1 { 0.008 } else { 0.0 };
        crate::RecordedMessage {
            topic: format!("/ouster/{topic}").as_str().into(),
            log_time: arrival() + Duration::from_seconds(i as f64 * 0.01 + late),
            message: Message::SensorPackets(crate::SensorPackets {
                kind,
                header: None,
                packets: vec![(None, bytes)],
            }),
        }
    };
    let recording = crate::MemoryRecording::new((0..10).map(message).collect());
    let recording = unpacked(Box::new(recording)).unwrap();
    let stamps = |wanted: &str| {
        let mut reader = crate::Recording::read(&*recording, &|t| t.topic.contains(wanted)).unwrap();
        let messages = std::iter::from_fn(|| reader.next_message().unwrap());
        let stamp = |m: crate::RecordedMessage| match m.message {
            Message::PointCloud2(cloud) => Some((0, cloud.header.stamp)),
            Message::Imu(imu) => Some((1, imu.header.stamp)),
            _ => None,
        };
        let stamps: Vec<(i32, Time)> = messages.filter_map(stamp).collect();
        let of = |kind: i32| stamps.iter().filter(|(k, _)| *k == kind).map(|s| s.1).collect::<Vec<_>>();
        (of(0), of(1))
    };
    let (lidar, imu) = stamps("ouster");
    // By the sensor's clock, 200 columns of 100 µs from the first packet of the lidar and 10 ms of the IMU.
    assert_eq!(imu[0] - lidar[0], Duration::from_seconds(0.01 - 0.02), "{lidar:?} {imu:?}");
    // It does not depend on what is read.
    assert_eq!(stamps("imu").1, imu);
    assert_eq!(stamps("lidar").0, lidar);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn random_packets_never_panic(
        seed in prop::collection::vec(any::<u8>(), 64),
        velodyne in any::<bool>(),
        marks in any::<bool>(),
        times in prop::collection::vec(any::<i64>(), 3),
    ) {
        let source = if velodyne {
            PacketSource::Velodyne(None)
        } else {
            let layout = PacketLayout { profile: PacketProfile::LowData, channels: 16, columns: 16 };
            PacketSource::OusterLidar(Box::new(OusterMetadata::assumed(16, 1024)), layout)
        };
        let length = if velodyne { PACKET_BYTES } else { 64 + 16 * (12 + 64) };
        let packets: Vec<_> = times
            .iter()
            .enumerate()
            .map(|(k, time)| {
                let mut packet: Vec<u8> = (0..length).map(|i| seed[(i * 7 + k) % 64] ^ (i / 64) as u8).collect();
                if marks && velodyne {
                    (0..12).for_each(|b| packet[b * 100..b * 100 + 2].copy_from_slice(&[0xff, 0xee]));
                }
                (packet, Time::from_ticks(*time))
            })
            .collect();
        decode(&source, &packets);
        decode(&PacketSource::OusterImu, &[(seed[..48].to_vec(), Time::MAX)]);
    }
}
