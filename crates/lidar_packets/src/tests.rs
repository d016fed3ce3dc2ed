//! Decodes synthetic packets and random ones.

use portolan_geometry::{Duration, Time};
use proptest::prelude::*;

use super::velodyne_models::PACKET_BYTES;
use super::*;
use portolan_issue::{IssueKind, IssueLog, Severity};

fn arrival() -> Time {
    Time::from_ros(1_700_000_000, 0)
}

/// A packet of a VLP-16: blocks start at an azimuth (hundredths of a degree) and are 40 apart; all ranges are
/// equal.
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

/// Position, intensity, ring and time of the points of a sweep.
fn points(sweep: &Sweep) -> Vec<([f32; 3], f32, u16, f32)> {
    sweep.points.iter().map(|p| (p.position, p.intensity, p.ring, p.seconds)).collect()
}

fn decode(source: &PacketSource, packets: &[(Vec<u8>, Time)]) -> (Vec<Measured>, Vec<(IssueKind, u64)>) {
    let (mut decoder, mut issues, mut measured) = (source.decoder(), IssueLog::default(), Vec::new());
    let mut clock = SensorTime::default();
    for (packet, time) in packets {
        decoder.push((packet, *time), &mut clock, &mut issues, &mut |m| measured.push(m));
    }
    measured.extend(decoder.finish());
    (measured, issues.counts().into_iter().collect())
}

fn sweeps(measured: Vec<Measured>) -> Vec<Sweep> {
    measured.into_iter().map(|m| if let Measured::Sweep(s) = m { s } else { panic!() }).collect()
}

fn counted(issues: &[(IssueKind, u64)], fault: IssueKind) -> u64 {
    issues.iter().find(|(of, _)| *of == fault).map_or(0, |(_, count)| *count)
}

#[test]
fn a_puck_measures_where_its_beams_point() {
    // The sensor's clock counts from the full hour; 1700000000 s is 20 min before one.
    let microseconds = (1_700_000_000_u64 % 3600 * 1_000_000) as u32;
    let packets = [
        (puck_packet(9000, 2500, microseconds, 0x37, 0x22), arrival()),
        (
            puck_packet(9480, 2500, microseconds + 1327, 0x37, 0x22),
            arrival() + Duration::from_seconds(0.0013),
        ),
    ];
    let (measured, issues) = decode(&PacketSource::Velodyne(None), &packets);
    assert!(issues.is_empty(), "{issues:?}");
    let sweeps = sweeps(measured);
    assert_eq!((sweeps.len(), sweeps[0].points.len()), (1, 2 * 12 * 32));
    assert_eq!(sweeps[0].stamp, arrival());
    let all = points(&sweeps[0]);
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
    let (measured, issues) = decode(&PacketSource::Velodyne(None), &packets);
    let sizes: Vec<usize> = sweeps(measured).iter().map(|s| s.points.len()).collect();
    assert_eq!(sizes, [75 * 384, 75 * 384, 10 * 384]);
    // That clock was not set.
    assert!(counted(&issues, IssueKind::SensorClockNotSet) == 1, "{issues:?}");
    let dual = [(puck_packet(0, 1000, 0, 0x39, 0x28), arrival())];
    let (measured, _) = decode(&PacketSource::Velodyne(None), &dual);
    let sweep = &sweeps(measured)[0];
    assert_eq!(sweep.points.len(), 6 * 32);
    // A VLP-32C counts in 4 mm.
    let [x, y, z] = points(sweep)[1].0;
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
    let (measured, issues) = decode(&PacketSource::Velodyne(Some(lasers)), &[(packet.clone(), arrival())]);
    let sweep = &sweeps(measured)[0];
    let lower = points(sweep)[32];
    assert_eq!(lower.2, 32);
    assert!((lower.0[0] - (2.5 * 0.32f32.cos() - 0.1 * 0.32f32.sin())).abs() < 1e-3, "{lower:?}");
    assert_eq!(counted(&issues, IssueKind::NoVelodyneCalibration), 0);
    let (_, issues) = decode(&PacketSource::Velodyne(None), &[(packet, arrival())]);
    assert_eq!(counted(&issues, IssueKind::NoVelodyneCalibration), 1);
    assert!(parse_calibration("lasers:\n- {laser_id: 99999}\n").is_none() && parse_calibration("").is_none());
}

fn header_of(profile: PacketProfile) -> PacketHeader {
    if profile == PacketProfile::FusaLowDataDual { PacketHeader::Fusa } else { PacketHeader::Standard }
}

fn ouster_packet(profile: PacketProfile, channels: usize, frame: u16, first: u16, range: u32) -> Vec<u8> {
    let is_legacy = profile == PacketProfile::Legacy;
    let mut packet = if is_legacy { Vec::new() } else { vec![0; 32] };
    if header_of(profile) == PacketHeader::Fusa {
        packet[4..8].copy_from_slice(&(70_000 + u32::from(frame)).to_le_bytes());
    } else if !is_legacy {
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
            let mut bytes = vec![0; profile.channel_bytes()];
            if profile.name().contains("RNG15") {
                bytes[..2].copy_from_slice(&((range / 8) as u16).to_le_bytes());
            } else {
                bytes[..4].copy_from_slice(&range.to_le_bytes());
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
    metadata.beam_origin = [0.02, 0.0];
    for profile in PacketProfile::ALL {
        let header = header_of(profile);
        let layout = PacketLayout { profile, header, channels: 64, columns: 16 };
        let packets: Vec<_> = [(7, 0), (7, 256), (8, 0)]
            .map(|(frame, first)| (ouster_packet(profile, 64, frame, first, 4000), arrival()))
            .to_vec();
        assert_eq!(packets[0].0.len(), layout.packet_bytes(), "{profile:?}");
        let source = PacketSource::OusterLidar(Box::new(metadata.clone()), layout);
        let (measured, issues) = decode(&source, &packets);
        let sweeps = sweeps(measured);
        assert_eq!(sweeps.iter().map(|s| s.points.len()).collect::<Vec<_>>(), [2048, 1024], "{profile:?}");
        assert!(counted(&issues, IssueKind::SensorClockNotSet) > 0);
        let all = points(&sweeps[0]);
        for ([x, y, z], ..) in &all {
            let z = z - 0.03618;
            let across = (x * x + y * y).sqrt() - 0.02;
            assert!(((across * across + z * z).sqrt() - 3.98).abs() < 2e-3, "{profile:?} {x} {y} {z}");
        }
        // Column 0 points along −x of the lidar's frame rotated by half a turn: the +x direction of the
        // sensor is at half a turn of the encoder.
        let ([x, y, _], _, ring, time) = all[1];
        assert!(x < 0.0 && y.abs() < 0.1 * x.abs() && ring == 62 && time == 0.0, "{x} {y}");
        // A quarter turn later, clockwise.
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
    assert_eq!(
        (metadata.altitudes.len(), metadata.columns_per_frame, metadata.beam_origin),
        (2, 512, [0.02, 0.0])
    );
    assert_eq!(metadata.profile, Some(PacketProfile::LowData));
    assert_eq!((metadata.header, metadata.serial), (Some(PacketHeader::Standard), None));
    let legacy = r#"{"beam_altitude_angles": [1.5], "beam_azimuth_angles": [0], "lidar_mode": "2048x10"}"#;
    assert_eq!(OusterMetadata::parse(legacy).unwrap().columns_per_frame, 2048);
    for wrong in ["", "{}", "[1]", r#"{"beam_altitude_angles": [1e9], "beam_azimuth_angles": [0]}"#] {
        assert!(OusterMetadata::parse(wrong).is_none());
    }
}

#[test]
fn imu_packets_are_in_si_units() {
    let mut packet = vec![0; 48];
    packet[16..24].copy_from_slice(&5_000_000_000_u64.to_le_bytes());
    packet[32..36].copy_from_slice(&1.0_f32.to_le_bytes());
    packet[36..40].copy_from_slice(&180.0_f32.to_le_bytes());
    let (measured, _) = decode(&PacketSource::OusterImu, &[(packet, arrival())]);
    let Measured::Imu(imu) = &measured[0] else { panic!() };
    assert_eq!(imu.linear_acceleration, [0.0, 0.0, 9.80665]);
    assert!((imu.angular_velocity[0] - std::f64::consts::PI).abs() < 1e-12);
    assert_eq!(imu.time, arrival());
}

/// An IMU packet with several samples 1 ms apart, the second marked as invalid.
fn samples_packet(count: u64) -> Vec<u8> {
    let mut packet = vec![0; 32 + 100];
    packet[0] = 2;
    packet[7..12].copy_from_slice(&122_247_000_785_u64.to_le_bytes()[..5]);
    for i in 0..count {
        packet.extend_from_slice(&(5_000_000_000 + i * 1_000_000).to_le_bytes());
        packet.extend_from_slice(&(i as u16 * 32).to_le_bytes());
        packet.extend_from_slice(&u16::from(i != 1).to_le_bytes());
        for value in [0.5, 0.0, 9.81, 0.25, 0.0, i as f32] {
            packet.extend_from_slice(&f32::to_le_bytes(value));
        }
    }
    packet.extend_from_slice(&[0; 32]);
    packet
}

#[test]
fn imu_packets_with_several_samples_are_in_si_units_already() {
    let packet = samples_packet(8);
    assert!(is_ouster_imu(&packet) && ouster_imu_serial(&packet) == Some(122_247_000_785));
    let (measured, issues) = decode(&PacketSource::OusterImu, &[(packet, arrival())]);
    assert_eq!((measured.len(), counted(&issues, IssueKind::InvalidOusterSample)), (7, 1));
    let samples: Vec<&ImuSample> =
        measured.iter().map(|m| if let Measured::Imu(s) = m { s } else { panic!() }).collect();
    assert_eq!(samples[6].linear_acceleration, [0.5, 0.0, f64::from(9.81_f32)]);
    assert_eq!(samples[6].angular_velocity, [0.25, 0.0, 7.0]);
    assert_eq!(samples[6].time - samples[0].time, Duration::from_seconds(0.007));
    // Lidar packets without a header have lengths that no such packet has, whatever their first bytes are.
    for channels in [16, 32, 64, 128] {
        let mut lidar = ouster_packet(PacketProfile::Legacy, channels, 1, 0, 1000);
        lidar[0] = 2;
        assert!(!is_ouster_imu(&lidar) && !is_other_ouster_data(&lidar));
    }
}

#[test]
fn packets_about_zones_are_left_out_silently_and_cut_ones_are_counted() {
    let layout = PacketLayout {
        profile: PacketProfile::SingleZones,
        header: PacketHeader::Standard,
        channels: 32,
        columns: 16,
    };
    let lidar = PacketSource::OusterLidar(Box::new(OusterMetadata::assumed(32, 1024)), layout);
    let mut zones = vec![0; 680];
    zones[0] = 3;
    for source in [lidar, PacketSource::OusterImu] {
        let (measured, issues) = decode(&source, &[(zones.clone(), arrival()), (vec![1; 100], arrival())]);
        let lost: u64 = issues.iter().map(|(_, count)| count).sum();
        assert!(measured.is_empty() && lost == 1, "{issues:?}");
    }
}

#[test]
fn beams_may_begin_above_the_origin_of_the_lidar() {
    let text = r#"{"beam_intrinsics": {"beam_altitude_angles": [90], "beam_azimuth_angles": [0],
        "lidar_origin_to_beam_origin_mm": 99,
        "beam_to_lidar_transform": [1, 0, 0, 30, 0, 1, 0, 0, 0, 0, 1, 40, 0, 0, 0, 1]},
        "lidar_intrinsics": {"lidar_to_sensor_transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
        "lidar_data_format": {"columns_per_frame": 512, "columns_per_packet": 16,
        "udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16"}}"#;
    let metadata = OusterMetadata::parse(text).unwrap();
    let packet = ouster_packet(PacketProfile::Single, 1, 1, 0, 5000);
    let layout = metadata.layout_of(&packet).unwrap();
    assert_eq!(metadata.packet_bytes(), Some(packet.len()));
    let source = PacketSource::OusterLidar(Box::new(metadata), layout);
    let (measured, _) = decode(&source, &[(packet, arrival())]);
    // The range of 5 m is measured from the origin of the lidar's frame and includes 50 mm to the origin of
    // the beams.
    let ([x, y, z], ..) = points(&sweeps(measured)[0])[0];
    assert!((x - 0.03).abs() < 1e-6 && y.abs() < 1e-6 && (z - 4.99).abs() < 1e-6, "{x} {y} {z}");
}

#[test]
fn settings_in_force_count_more_than_those_asked_for() {
    let text = r#"{"beam_altitude_angles": [1], "beam_azimuth_angles": [0], "prod_line": "OS-0-128",
        "config_params": {"columns_per_packet": 8, "udp_profile_lidar": "RNG15_RFL8_NIR8", "udp_port_lidar": 7502},
        "lidar_data_format": {"columns_per_packet": 16, "header_type": "FUSA",
        "udp_profile_lidar": "RNG15_RFL8_NIR8_ZONE16"},
        "sensor_info": {"prod_sn": "122247000785", "initialization_id": 390078}}"#;
    let metadata = OusterMetadata::parse(text).unwrap();
    assert_eq!((metadata.columns_per_packet, metadata.header), (16, Some(PacketHeader::Fusa)));
    assert_eq!(metadata.profile, Some(PacketProfile::LowDataZones));
    assert_eq!((metadata.serial, metadata.initialization), (Some(122_247_000_785), Some(390_078)));
    assert_eq!((metadata.lidar_port, metadata.beam_origin), (Some(7502), [0.001 * 27.67, 0.0]));
}

/// 400 packets, 1.327 ms apart; the sensor's clock is `ahead` seconds ahead of arrival for each packet.
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
fn times_continue_after_a_clock_jump() {
    let stamps = |packets: &[(Vec<u8>, Time)]| {
        let (measured, issues) = decode(&PacketSource::Velodyne(None), packets);
        (sweeps(measured).iter().map(|s| s.stamp).collect::<Vec<_>>(), issues)
    };
    let (expected, issues) = stamps(&pucks(|_| 0.0));
    assert!(expected.len() == 6 && issues.is_empty(), "{issues:?}");
    for jump in [5.0, -5.0, 1200.0, 2400.0, -1200.0] {
        let (stamps, issues) = stamps(&pucks(|i| if i < 200 { 0.0 } else { jump }));
        assert_eq!(stamps, expected, "{jump} s");
        assert_eq!(issues, [(IssueKind::SensorClockJumped, 1)], "{jump} s");
    }
    // One wrong time is two jumps: there and back.
    let (stamps, issues) = stamps(&pucks(|i| if i == 100 { 60.0 } else { 0.0 }));
    assert!(stamps == expected && issues == [(IssueKind::SensorClockJumped, 2)], "{issues:?}");
}

#[test]
fn recorders_that_hang_and_gaps_are_no_jumps_of_the_clock() {
    let with = |arrival_delay: &dyn Fn(usize) -> f64, keep: &dyn Fn(usize) -> bool| {
        let packets = pucks(|_| 0.0).into_iter().enumerate().filter(|(i, _)| keep(*i));
        let late = packets.map(|(i, (p, t))| (p, t + Duration::from_seconds(arrival_delay(i))));
        decode(&PacketSource::Velodyne(None), &late.collect::<Vec<_>>()).1
    };
    let issues = with(&|i| if (100..200).contains(&i) { 3.0 } else { 0.0 }, &|_| true);
    assert!(issues.is_empty(), "{issues:?}");
    // A pause of 40 min in both clocks.
    let pause = |i: u64| if i < 200 { 0.0 } else { 2400.0 };
    let packets = pucks(pause).into_iter().enumerate();
    let packets: Vec<_> =
        packets.map(|(i, (p, t))| (p, t + Duration::from_seconds(pause(i as u64)))).collect();
    let (measured, issues) = decode(&PacketSource::Velodyne(None), &packets);
    assert!(issues.is_empty(), "{issues:?}");
    let stamps: Vec<Time> = sweeps(measured).iter().map(|s| s.stamp).collect();
    assert!((stamps[stamps.len() - 1] - stamps[0]).seconds() > 2400.0);
}

#[test]
fn packets_that_come_twice_count_once() {
    let once = pucks(|_| 0.0);
    let twice: Vec<_> = once.iter().flat_map(|packet| [packet.clone(), packet.clone()]).collect();
    let (expected, _) = decode(&PacketSource::Velodyne(None), &once);
    let (measured, issues) = decode(&PacketSource::Velodyne(None), &twice);
    assert_eq!(measured, expected);
    assert_eq!(issues, [(IssueKind::RepeatedPacket, 400)]);
    assert_ne!(IssueKind::RepeatedPacket.severity(), Severity::Error);
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
            let layout = PacketLayout {
                profile: PacketProfile::LowData,
                header: PacketHeader::Standard,
                channels: 16,
                columns: 16,
            };
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
