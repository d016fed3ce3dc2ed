//! Reads synthetic captures, intact and damaged.

use std::sync::Arc;

use proptest::prelude::*;

use crate::{Message, RecordedMessage, open_bytes};
use portolan_issue::{Issue, IssueKind};

fn packet(azimuth: u16) -> Vec<u8> {
    let mut packet = Vec::new();
    for block in 0..12_u16 {
        packet.extend_from_slice(&[0xff, 0xee]);
        packet.extend_from_slice(&((azimuth + 40 * block) % 36_000).to_le_bytes());
        (0..32).for_each(|_| packet.extend_from_slice(&[0xe8, 0x03, 9]));
    }
    packet.extend_from_slice(&[0, 0, 0, 0, 0x37, 0x22]);
    packet
}

/// Ethernet frames of a datagram, in pieces of at most `piece` bytes (a multiple of 8).
pub(super) fn frames(payload: &[u8], number: u16, piece: usize) -> Vec<Vec<u8>> {
    let mut udp = vec![0x09, 0x40, 0x09, 0x40];
    udp.extend_from_slice(&((payload.len() + 8) as u16).to_be_bytes());
    udp.extend_from_slice(&[0, 0]);
    udp.extend_from_slice(payload);
    let count = udp.len().div_ceil(piece);
    let frame = |(i, part): (usize, &[u8])| {
        let mut frame = vec![1; 12];
        frame.extend_from_slice(&[0x81, 0x00, 0, 5, 0x08, 0x00]); // in a VLAN
        let flags = (i * piece / 8) as u16 | if i + 1 < count { 0x2000 } else { 0 };
        frame.extend_from_slice(&[0x45, 0]);
        frame.extend_from_slice(&((part.len() + 20) as u16).to_be_bytes());
        frame.extend_from_slice(&number.to_be_bytes());
        frame.extend_from_slice(&flags.to_be_bytes());
        frame.extend_from_slice(&[64, 17, 0, 0, 192, 168, 1, 201, 255, 255, 255, 255]);
        frame.extend_from_slice(part);
        frame
    };
    udp.chunks(piece).enumerate().map(frame).collect()
}

fn all_frames(piece: usize) -> Vec<Vec<u8>> {
    (0..90_u16).flat_map(|i| frames(&packet((i * 480) % 36_000), i, piece)).collect()
}

pub(super) fn classic(frames: &[Vec<u8>], is_big: bool, is_nano: bool) -> Vec<u8> {
    let word = |v: u32| if is_big { v.to_be_bytes() } else { v.to_le_bytes() };
    let mut bytes = word(if is_nano { 0xa1b2_3c4d } else { 0xa1b2_c3d4 }).to_vec();
    for v in [0x0004_0002, 0, 0, 65_535, 1] {
        bytes.extend(word(v));
    }
    for (i, frame) in frames.iter().enumerate() {
        let fraction = i as u32 * if is_nano { 1_000_000 } else { 1000 };
        for v in [1_700_000_000, fraction, frame.len() as u32, frame.len() as u32] {
            bytes.extend(word(v));
        }
        bytes.extend(frame);
    }
    bytes
}

fn next_generation(frames: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut block = |kind: u32, body: &[u8]| {
        let length = (12 + body.len().next_multiple_of(4)) as u32;
        bytes.extend(kind.to_le_bytes());
        bytes.extend(length.to_le_bytes());
        bytes.extend(body);
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes.extend(length.to_le_bytes());
    };
    block(0x0a0d_0d0a, &[0x4d, 0x3c, 0x2b, 0x1a, 1, 0, 0, 0, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]);
    // Times in nanoseconds.
    block(1, &[1, 0, 0, 0, 0, 0, 1, 0, 9, 0, 1, 0, 9, 0, 0, 0, 0, 0, 0, 0]);
    block(5, &[7; 16]);
    for (i, frame) in frames.iter().enumerate() {
        let nanoseconds = 1_700_000_000_000_000_000_u64 + i as u64 * 1_000_000;
        let mut body = 0_u32.to_le_bytes().to_vec();
        body.extend(((nanoseconds >> 32) as u32).to_le_bytes());
        body.extend((nanoseconds as u32).to_le_bytes());
        body.extend((frame.len() as u32).to_le_bytes());
        body.extend((frame.len() as u32).to_le_bytes());
        body.extend(frame);
        block(6, &body);
    }
    bytes
}

fn read(bytes: Vec<u8>) -> Result<(Vec<RecordedMessage>, Vec<Issue>), String> {
    let bytes: Arc<[u8]> = bytes.into();
    let recording = open_bytes("drive.pcap", bytes).map_err(|e| e.to_string())?;
    let mut reader = recording.read(&|_| true).map_err(|e| e.to_string())?;
    let mut messages = Vec::new();
    while let Some(message) = reader.next_message().map_err(|e| e.to_string())? {
        messages.push(message);
    }
    Ok((messages, reader.issues()))
}

#[test]
fn every_kind_of_capture_gives_the_same_clouds() {
    let whole = all_frames(1480);
    let captures = [
        classic(&whole, false, false),
        classic(&whole, true, false),
        classic(&whole, false, true),
        next_generation(&whole),
    ];
    let mut first = None;
    for capture in captures {
        let (messages, issues) = read(capture).unwrap();
        assert_eq!(messages.len(), 2);
        assert!(issues.iter().all(|r| !r.lost_data()), "{issues:?}");
        assert_eq!(&*messages[0].topic, "/velodyne_points");
        let clouds: Vec<Message> = messages.into_iter().map(|m| m.message).collect();
        assert_eq!(first.get_or_insert_with(|| clouds.clone()), &clouds);
    }
    let (messages, _) = read(classic(&all_frames(504), false, false)).unwrap();
    let Message::PointCloud2(cloud) = &messages[0].message else { panic!() };
    assert_eq!(cloud.width, 75 * 384);
}

#[test]
fn damage_is_counted() {
    let whole = classic(&all_frames(1480), false, false);
    let (messages, issues) = read(whole[..whole.len() - 7].to_vec()).unwrap();
    assert!(messages.len() == 2 && issues.iter().any(|r| r.lost_data() && r.kind == IssueKind::CutCapture));
    let mut lost_piece = all_frames(504);
    lost_piece.remove(10);
    let (_, issues) = read(classic(&lost_piece, false, false)).unwrap();
    assert!(issues.iter().any(|r| r.lost_data() && r.kind == IssueKind::IncompleteDatagram), "{issues:?}");
    let error = read(classic(&frames(b"hello", 1, 1480), false, false)).unwrap_err();
    assert!(error.contains("none of them"), "{error}");
}

#[test]
fn damage_beside_packets_costs_none_of_them() {
    let whole = next_generation(&all_frames(1480));
    let (expected, _) = read(whole.clone()).unwrap();
    // Order of blocks: section (28 bytes), interface (32), statistics (28), packets.
    let first_packet = 28 + 32 + 28;
    let packet_bytes = u32::from_le_bytes(whole[first_packet + 4..first_packet + 8].try_into().unwrap());
    let trailer = first_packet + packet_bytes as usize - 4;
    // The last bytes of the section repeat its length; the end option of the interface gets a length.
    for (at, value) in [(trailer, 0x55), (24, 0x55), (28 + 26, 0xff)] {
        let mut damaged = whole.clone();
        damaged[at] = value;
        let (messages, issues) = read(damaged).unwrap();
        assert!(issues.iter().all(|r| !r.lost_data()), "{at}: {issues:?}");
        let contents = |messages: &[RecordedMessage]| -> Vec<Message> {
            messages.iter().map(|m| m.message.clone()).collect()
        };
        assert_eq!(contents(&messages), contents(&expected), "{at}");
    }
}

#[test]
fn a_damaged_address_is_no_sensor() {
    let azimuth = |i: u16| (u32::from(i) * 480 % 36_000) as u16;
    let mut all: Vec<Vec<u8>> = (0..200).flat_map(|i| frames(&packet(azimuth(i)), i, 1480)).collect();
    // A source address that sorts before that of the lidar.
    let source = all[60].windows(4).position(|bytes| bytes == [192, 168, 1, 201]).unwrap();
    all[60][source] = 5;
    let (messages, issues) = read(classic(&all, false, false)).unwrap();
    assert!(messages.iter().all(|m| &*m.topic == "/velodyne_points"));
    let strays: Vec<_> = issues.iter().filter(|r| r.kind == IssueKind::RareSender).collect();
    assert!(strays.len() == 1 && strays[0].count == 1 && strays[0].lost_data(), "{issues:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(80))]
    #[test]
    fn damaged_captures_never_panic(
        kind in 0..3,
        cut in 0..60_000_usize,
        flips in prop::collection::vec((0..60_000_usize, any::<u8>()), 0..6),
    ) {
        let some = &all_frames(504)[..120];
        let mut bytes = match kind {
            0 => classic(some, false, false),
            1 => classic(some, true, true),
            _ => next_generation(some),
        };
        for (at, value) in flips {
            let at = at % bytes.len();
            bytes[at] ^= value;
        }
        bytes.truncate(cut.max(4));
        let _ = read(bytes);
    }
}
