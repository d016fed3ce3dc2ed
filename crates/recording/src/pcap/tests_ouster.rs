//! Reads synthetic captures of Ouster sensors with metadata beside them.

use std::path::Path;

use super::tests::{classic, frames};
use crate::{Message, open};
use portolan_issue::{Issue, IssueKind};

/// Metadata of a sensor with 16 beams at one altitude angle; without a serial number in the legacy layout.
fn metadata(serial: u64, start: u32, altitude: f64) -> String {
    let angles = |value: f64| format!("{:?}", vec![value; 16]);
    let profile = if serial == 0 { "LEGACY" } else { "RNG19_RFL8_SIG16_NIR16" };
    format!(
        r#"{{"beam_intrinsics": {{"beam_altitude_angles": {}, "beam_azimuth_angles": {}}},
        "lidar_data_format": {{"columns_per_frame": 512, "columns_per_packet": 16, "udp_profile_lidar": "{profile}"}},
        "sensor_info": {{"prod_sn": "{serial}", "initialization_id": {start}}}}}"#,
        angles(altitude),
        angles(0.0)
    )
}

/// A lidar packet of 16 beams, all ranges 10 m; without a serial number in the legacy layout.
fn lidar(serial: u64, start: u32, first: u16) -> Vec<u8> {
    let mut packet = if serial == 0 { Vec::new() } else { vec![0; 32] };
    if serial != 0 {
        packet[0] = 1;
        packet[4..7].copy_from_slice(&start.to_le_bytes()[..3]);
        packet[7..12].copy_from_slice(&serial.to_le_bytes()[..5]);
    }
    for column in first..first + 16 {
        packet.extend_from_slice(&(u64::from(column) * 100_000).to_le_bytes());
        packet.extend_from_slice(&column.to_le_bytes());
        packet.extend_from_slice(if serial == 0 { &[0; 6] } else { &[1, 0] });
        for _ in 0..16 {
            packet.extend_from_slice(&10_000_u32.to_le_bytes());
            packet.extend_from_slice(&[0; 8]);
        }
        packet.extend_from_slice(if serial == 0 { &[0xff; 4] } else { &[] });
    }
    packet.extend(vec![0; if serial == 0 { 0 } else { 32 }]);
    packet
}

/// Reads a capture of packets beside files: the altitude angle of the first point by topic, and the issues.
fn read(name: &str, packets: &[Vec<u8>], files: &[(&str, String)]) -> (Vec<(String, i32)>, Vec<Issue>) {
    let folder = tempfile::tempdir().unwrap();
    for (file, text) in files {
        std::fs::write(folder.path().join(file), text).unwrap();
    }
    let all: Vec<Vec<u8>> = (0_u16..).zip(packets).flat_map(|(i, packet)| frames(packet, i, 1480)).collect();
    let capture = folder.path().join(Path::new(name));
    std::fs::write(&capture, classic(&all, false, false)).unwrap();
    let recording = open(&capture).unwrap();
    let mut reader = recording.read(&|_| true).unwrap();
    let mut altitudes = Vec::new();
    while let Some(message) = reader.next_message().unwrap() {
        let Message::PointCloud2(cloud) = message.message else { continue };
        let value = |at: usize| f32::from_le_bytes(cloud.data[at..at + 4].try_into().unwrap());
        let altitude = (value(8) - 0.036).atan2(value(0).hypot(value(4))).to_degrees();
        altitudes.push((message.topic.to_string(), altitude.round() as i32));
    }
    altitudes.sort();
    (altitudes, reader.issues())
}

fn count(issues: &[Issue], kind: IssueKind) -> u64 {
    issues.iter().filter(|issue| issue.kind == kind).map(|issue| issue.count).sum()
}

const ONE: u64 = 122_247_000_785;
const OTHER: u64 = 122_239_000_672;

#[test]
fn metadata_of_the_serial_number_are_right_whatever_their_name() {
    let files = [
        ("drive.json", metadata(OTHER, 7, 5.0)),
        ("any.json", metadata(ONE, 8, 10.0)),
        ("some.json", metadata(ONE, 7, 15.0)),
    ];
    let (altitudes, issues) = read("drive.pcap", &[lidar(ONE, 7, 0)], &files);
    assert_eq!(altitudes, [("/ouster/points".to_owned(), 15)]);
    let reported: Vec<&Issue> = issues.iter().filter(|i| i.kind == IssueKind::OusterMetadataFound).collect();
    assert!(reported.len() == 1 && reported[0].text().contains("some.json"), "{issues:?}");
    // Neither of two files from other starts of the sensor can be chosen.
    let (_, issues) = read("drive.pcap", &[lidar(ONE, 9, 0)], &files[1..]);
    assert_eq!(count(&issues, IssueKind::NoOusterMetadata), 1, "{issues:?}");
}

#[test]
fn sensors_that_send_to_the_same_port_are_distinguished() {
    let packets = [lidar(ONE, 7, 0), lidar(OTHER, 3, 0), lidar(ONE, 7, 16), lidar(OTHER, 3, 16)];
    let files = [("drive_0.json", metadata(ONE, 7, 10.0)), ("drive_1.json", metadata(OTHER, 3, 5.0))];
    let (altitudes, issues) = read("drive.pcap", &packets, &files);
    assert_eq!(altitudes, [("/ouster/points".to_owned(), 5), ("/ouster/points_2".to_owned(), 10)]);
    assert!(issues.iter().all(|issue| !issue.lost_data()), "{issues:?}");
}

#[test]
fn metadata_with_the_name_of_the_capture_are_used_with_a_warning() {
    let files = [("drive.json", metadata(OTHER, 7, 5.0)), ("drive_2.json", metadata(OTHER + 1, 7, 5.0))];
    let (altitudes, issues) = read("drive.pcap", &[lidar(ONE, 7, 0)], &files);
    assert_eq!((altitudes[0].1, count(&issues, IssueKind::OtherOusterMetadata)), (5, 1), "{issues:?}");
    // Metadata of another sensor in the capture are not used, nor are those whose file name is only similar.
    let both = [lidar(ONE, 7, 0), lidar(OTHER, 7, 0)];
    let (_, issues) = read("drive.pcap", &both, &files[..1]);
    assert_eq!(count(&issues, IssueKind::NoOusterMetadata), 1, "{issues:?}");
    let (_, issues) = read("drive.pcap", &[lidar(ONE, 7, 0)], &files[1..]);
    assert_eq!(count(&issues, IssueKind::NoOusterMetadata), 1, "{issues:?}");
}

#[test]
fn without_serial_numbers_names_decide() {
    let packets = [lidar(0, 0, 0)];
    type Files = [(&'static str, f64)];
    let cases: [(&Files, Option<i32>); 8] = [
        (&[("OS-1-16_run.json", 5.0), ("OS-1-16_run_0.json", 10.0)], Some(5)),
        (&[("OS-1-16_run_0.json", 10.0), ("OS-1-16.json", 5.0)], Some(10)),
        (&[("OS-1-16.json", 5.0), ("OS-1.json", 10.0)], Some(5)),
        (&[("OS-1-16_config.json", 5.0), ("OS-0-16_config.json", 10.0)], Some(5)),
        // Two files that are equivalent, and two that are not.
        (&[("OS-1-16_run_0.json", 5.0), ("OS-1-16_run_1.json", 5.0)], Some(5)),
        (&[("OS-1-16_run_0.json", 5.0), ("OS-1-16_run_1.json", 10.0)], None),
        // One common word is no match.
        (&[("OS-2-16.json", 5.0)], None),
        (&[("metadata.json", 5.0)], None),
    ];
    for (files, expected) in cases {
        let texts: Vec<_> = files.iter().map(|(name, altitude)| (*name, metadata(0, 0, *altitude))).collect();
        let (altitudes, issues) = read("OS-1-16_run.pcap", &packets, &texts);
        let is_nominal = count(&issues, IssueKind::NoOusterMetadata) == 1;
        assert_eq!((!is_nominal).then(|| altitudes[0].1), expected, "{files:?} {issues:?}");
    }
}

#[test]
fn packets_of_sensors_with_a_header_are_imu_zones_or_damaged() {
    let header = |kind: u8, bytes: usize| {
        let mut packet = vec![0; bytes];
        packet[0] = kind;
        packet[7..12].copy_from_slice(&ONE.to_le_bytes()[..5]);
        packet
    };
    let mut imu = header(2, 32 + 100 + 2 * 36 + 32);
    imu[132 + 10] = 1;
    imu[132 + 36 + 10] = 1;
    let files = [("drive.json", metadata(ONE, 7, 10.0))];
    let (_, issues) = read("drive.pcap", &[lidar(ONE, 7, 0), imu.clone(), header(3, 680)], &files);
    assert!(issues.iter().all(|issue| !issue.lost_data()), "{issues:?}");
    let (_, issues) = read("drive.pcap", &[lidar(ONE, 7, 0), header(1, 900)], &files);
    assert_eq!(count(&issues, IssueKind::WrongOusterLength), 1, "{issues:?}");
    // IMU packets with a header are recognised without a lidar.
    let (altitudes, issues) = read("drive.pcap", &[imu, header(3, 680)], &files);
    assert!(altitudes.is_empty() && issues.iter().all(|issue| !issue.lost_data()), "{issues:?}");
}
