//! Packets of lidars, without a capture around them.
#![no_main]

use portolan_issue::IssueLog;

use libfuzzer_sys::fuzz_target;
use portolan_geometry::{Duration, Time};
use portolan_lidar_packets::{Datagrams, OusterMetadata, PacketSource, SensorTime, parse_calibration};

fuzz_target!(|input: (Vec<(i64, Vec<u8>)>, String, u32)| {
    let (packets, description, link_type) = input;
    let (mut issues, mut datagrams) = (IssueLog::default(), Datagrams::default());
    let metadata = OusterMetadata::parse(&description);
    let length = packets.first().map_or(0, |(_, bytes)| bytes.len());
    let lidar = PacketSource::ouster_lidar(metadata.as_ref(), length, u16::MAX, &mut issues);
    let velodyne = PacketSource::Velodyne(parse_calibration(&description));
    for source in [Some(velodyne), Some(PacketSource::OusterImu), lidar].into_iter().flatten() {
        let (mut decoder, mut clock) = (source.decoder(), SensorTime::default());
        for (ticks, bytes) in &packets {
            let arrival = Time::from_ros(1_700_000_000, 0) + Duration::from_ticks(*ticks % 10_000_000_000);
            decoder.push((bytes, arrival), &mut clock, &mut issues, &mut |_| {});
            datagrams.take(link_type, bytes, &mut issues);
        }
        decoder.finish();
    }
    datagrams.finish(&mut issues);
});
