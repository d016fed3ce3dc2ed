//! Finds the sensors of a capture by their packets.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_issue::IssueLog;
use portolan_lidar_packets::{
    Endpoint, PacketHeader, PacketLayout, PacketSource, PacketStream, SensorTime, VelodyneModel, clocks_of,
    is_ouster_imu, is_velodyne, ouster_imu_serial,
};

use super::descriptions::{Descriptions, Seen};
use crate::packets::OUSTER_FRAME;

/// Maximum number of senders; further ones are ignored.
const MAX_ENDPOINTS: usize = 256;
/// A sender is not a sensor if it has fewer packets than the busiest sender of its kind divided by this: its
/// address was damaged in transit.
const HARDLY_ANY: u64 = 100;

/// One sensor of a capture.
#[derive(Clone)]
pub(super) struct CapturedSensor {
    pub topic: Arc<str>,
    pub frame: String,
    pub kind: Kind,
    pub source: PacketSource,
    /// Index of its clock.
    pub clock: usize,
}

/// All sensors of a capture.
#[derive(Default)]
pub(super) struct Sensors {
    pub by_sender: BTreeMap<Stream, CapturedSensor>,
    pub clocks: Vec<SensorTime>,
    /// Names of their models, for messages.
    pub models: String,
}

/// Kind of a packet, recognised by its format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Velodyne,
    OusterLidar,
    OusterImu,
}

/// Packets of one kind from one sensor. Several sensors may send to the same port, even from the same
/// address.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Stream {
    pub endpoint: Endpoint,
    pub kind: Kind,
    /// The serial number; the length of the packets for lidar packets without one.
    which: u64,
}

impl Stream {
    /// None if a packet is not from a sensor. `lengths` are sizes of lidar packets according to metadata.
    pub fn of(endpoint: Endpoint, packet: &[u8], lengths: &BTreeSet<usize>) -> Option<Self> {
        let (kind, which) = if is_velodyne(packet) {
            (Kind::Velodyne, 0)
        } else if is_ouster_imu(packet) {
            (Kind::OusterImu, ouster_imu_serial(packet).unwrap_or(0))
        } else {
            let serial = match PacketLayout::guess(packet) {
                Some(layout) => layout.serial(packet),
                None if lengths.contains(&packet.len()) => PacketHeader::of(packet).serial(packet),
                None => return None,
            };
            (Kind::OusterLidar, serial.unwrap_or(packet.len() as u64))
        };
        Some(Self { endpoint, kind, which })
    }

    /// The lower bound of all streams of an endpoint.
    pub fn least(endpoint: Endpoint) -> Self {
        Self { endpoint, kind: Kind::Velodyne, which: 0 }
    }
}

impl Kind {
    /// Topic and frame of the first sensor of a kind.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Velodyne => ("/velodyne_points", "velodyne"),
            Self::OusterLidar => ("/ouster/points", OUSTER_FRAME),
            Self::OusterImu => ("/ouster/imu", OUSTER_FRAME),
        }
    }
}

/// Properties of a sender.
struct Sender {
    packets: u64,
    largest_column: u16,
    /// Its first packet and the packet's time of arrival.
    first: (Vec<u8>, Time),
}

/// All senders of packets of sensors.
#[derive(Default)]
pub(super) struct Senders {
    seen: BTreeMap<Stream, Sender>,
}

impl Senders {
    /// Adds a datagram.
    pub fn add(&mut self, endpoint: Endpoint, packet: &[u8], arrival: Time, lengths: &BTreeSet<usize>) {
        let Some(stream) = Stream::of(endpoint, packet, lengths) else { return };
        if self.seen.len() >= MAX_ENDPOINTS && !self.seen.contains_key(&stream) {
            return;
        }
        let first = || Sender { packets: 0, largest_column: 0, first: (packet.to_vec(), arrival) };
        let sender = self.seen.entry(stream).or_insert_with(first);
        sender.packets += 1;
        sender.largest_column = sender.largest_column.max(PacketLayout::largest_column(packet));
    }

    /// Gives every sensor a topic; the first of a kind has no number.
    pub fn sensors(&self, descriptions: &Descriptions, issues: &mut IssueLog) -> Sensors {
        let is_lidar = |stream: &Stream| stream.kind == Kind::OusterLidar;
        let has_ouster = self.seen.keys().any(is_lidar);
        let sensors = || self.seen.iter().filter(|(stream, sender)| self.is_sensor(stream, sender));
        let lidars: Vec<Seen<'_>> = sensors()
            .filter(|(stream, _)| is_lidar(stream))
            .map(|(stream, sender)| seen(stream, sender))
            .collect();
        let mut found: Vec<(&Stream, &Sender, PacketSource)> = Vec::new();
        for (stream, sender) in sensors() {
            let (packet, _) = &sender.first;
            let source = match stream.kind {
                Kind::Velodyne => Some(PacketSource::Velodyne(descriptions.calibration.clone())),
                // IMU packets with one sample can only be recognised by their length, so there must be an
                // Ouster lidar, too.
                Kind::OusterImu => {
                    (has_ouster || ouster_imu_serial(packet).is_some()).then_some(PacketSource::OusterImu)
                }
                Kind::OusterLidar => {
                    let metadata = descriptions.metadata_of(&seen(stream, sender), &lidars, issues);
                    PacketSource::ouster_lidar(metadata, packet, sender.largest_column, issues)
                }
            };
            found.extend(source.map(|source| (stream, sender, source)));
        }
        named(found)
    }

    fn is_sensor(&self, stream: &Stream, sender: &Sender) -> bool {
        let of_kind = self.seen.iter().filter(|(other, _)| other.kind == stream.kind);
        let busiest = of_kind.map(|(_, other)| other.packets).max();
        busiest.is_none_or(|busiest| sender.packets.saturating_mul(HARDLY_ANY) >= busiest)
    }
}

fn seen<'a>(stream: &Stream, sender: &'a Sender) -> Seen<'a> {
    Seen { packet: &sender.first.0, port: stream.endpoint.port, largest_column: sender.largest_column }
}

fn named(found: Vec<(&Stream, &Sender, PacketSource)>) -> Sensors {
    let streams: Vec<_> = found
        .iter()
        .map(|(stream, sender, source)| PacketStream::new(stream.endpoint.source, source, &sender.first))
        .collect();
    let (numbers, clocks) = clocks_of(&streams);
    let mut models: Vec<&str> =
        found.iter().filter_map(|(stream, sender, _)| model(stream, sender)).collect();
    models.sort_unstable();
    models.dedup();
    let models = models.join(", ");
    let mut counts: BTreeMap<Kind, usize> = BTreeMap::new();
    let sensors = found.into_iter().zip(numbers).map(|((stream, _, source), clock)| {
        let number = counts.entry(stream.kind).and_modify(|n| *n += 1).or_insert(1);
        let name = |stem: &str| if *number == 1 { stem.to_owned() } else { format!("{stem}_{number}") };
        let (topic, frame) = stream.kind.names();
        let (topic, frame) = (name(topic).into(), name(frame));
        (*stream, CapturedSensor { topic, frame, kind: stream.kind, source, clock })
    });
    Sensors { by_sender: sensors.collect(), clocks, models }
}

fn model(stream: &Stream, sender: &Sender) -> Option<&'static str> {
    let packet = &sender.first.0;
    match stream.kind {
        Kind::Velodyne => Some(VelodyneModel::of(packet).0.name()),
        Kind::OusterLidar => Some("Ouster"),
        Kind::OusterImu => ouster_imu_serial(packet).map(|_| "Ouster"),
    }
}
