//! The sensors of a capture, found by what they send.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_issue::IssueLog;
use portolan_lidar_packets::{
    Endpoint, IMU_PACKET_BYTES, Laser, OusterMetadata, PacketLayout, PacketSource, PacketStream, SensorTime,
    VelodyneModel, clocks_of, is_velodyne, parse_calibration,
};

use crate::packets::OUSTER_FRAME;

/// Longer files beside a capture are no descriptions of a sensor.
const MAX_DESCRIPTION: u64 = 1 << 22;
/// More senders than this are not distinguished.
const MAX_ENDPOINTS: usize = 256;
/// A sender with fewer packets than this part of those of the busiest of its kind is no sensor: its address
/// was damaged on the way.
const HARDLY_ANY: u64 = 100;

/// One sensor of a capture.
#[derive(Clone)]
pub(super) struct CapturedSensor {
    pub topic: Arc<str>,
    pub frame: String,
    pub kind: Kind,
    pub source: PacketSource,
    /// Number of its clock.
    pub clock: usize,
}

/// All sensors of a capture.
#[derive(Default)]
pub(super) struct Sensors {
    pub by_sender: BTreeMap<Endpoint, CapturedSensor>,
    pub clocks: Vec<SensorTime>,
    /// Their models, for people.
    pub models: String,
}

/// What a packet is one of, by its look.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Velodyne,
    OusterLidar,
    OusterImu,
}

impl Kind {
    /// None if a packet is of no sensor.
    pub fn of(packet: &[u8]) -> Option<Self> {
        match packet.len() {
            _ if is_velodyne(packet) => Some(Self::Velodyne),
            IMU_PACKET_BYTES => Some(Self::OusterImu),
            bytes => PacketLayout::guess(bytes).map(|_| Self::OusterLidar),
        }
    }

    /// Topic and frame of the first sensor of its kind.
    fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Velodyne => ("/velodyne_points", "velodyne"),
            Self::OusterLidar => ("/ouster/points", OUSTER_FRAME),
            Self::OusterImu => ("/ouster/imu", OUSTER_FRAME),
        }
    }
}

/// What was seen of a sender.
struct Sender {
    kind: Kind,
    packets: u64,
    largest_column: u16,
    /// Its first packet, and when that arrived.
    first: (Vec<u8>, Time),
}

/// Everything that sends packets of sensors.
#[derive(Default)]
pub(super) struct Senders {
    seen: BTreeMap<Endpoint, Sender>,
}

impl Senders {
    /// Takes a datagram into account.
    pub fn add(&mut self, endpoint: Endpoint, packet: &[u8], arrival: Time) {
        let Some(kind) = Kind::of(packet) else { return };
        if self.seen.len() >= MAX_ENDPOINTS && !self.seen.contains_key(&endpoint) {
            return;
        }
        let first = || Sender { kind, packets: 0, largest_column: 0, first: (packet.to_vec(), arrival) };
        let sender = self.seen.entry(endpoint).or_insert_with(first);
        sender.packets += 1;
        sender.largest_column = sender.largest_column.max(PacketLayout::largest_column(packet));
    }

    /// Gives every sensor a topic: the first of a kind without a number.
    pub fn sensors(&self, descriptions: &Descriptions, issues: &mut IssueLog) -> Sensors {
        let has_ouster = self.seen.values().any(|sender| sender.kind == Kind::OusterLidar);
        let mut found: Vec<(&Endpoint, &Sender, PacketSource)> = Vec::new();
        for (endpoint, sender) in self.seen.iter().filter(|(_, sender)| self.is_sensor(sender)) {
            let (packet, _) = &sender.first;
            let source = match sender.kind {
                Kind::Velodyne => Some(PacketSource::Velodyne(descriptions.calibration.clone())),
                Kind::OusterImu => has_ouster.then_some(PacketSource::OusterImu),
                Kind::OusterLidar => {
                    let metadata = descriptions.metadata.as_ref();
                    PacketSource::ouster_lidar(metadata, packet.len(), sender.largest_column, issues)
                }
            };
            found.extend(source.map(|source| (endpoint, sender, source)));
        }
        named(found)
    }

    fn is_sensor(&self, sender: &Sender) -> bool {
        let busiest = self.seen.values().filter(|other| other.kind == sender.kind).map(|s| s.packets).max();
        busiest.is_none_or(|busiest| sender.packets.saturating_mul(HARDLY_ANY) >= busiest)
    }
}

fn named(found: Vec<(&Endpoint, &Sender, PacketSource)>) -> Sensors {
    let streams: Vec<_> = found
        .iter()
        .map(|(endpoint, sender, source)| PacketStream::new(endpoint.source, source, &sender.first))
        .collect();
    let (numbers, clocks) = clocks_of(&streams);
    let mut models: Vec<&str> = found.iter().filter_map(|(_, sender, _)| model(sender)).collect();
    models.sort_unstable();
    models.dedup();
    let models = models.join(", ");
    let mut counts: BTreeMap<Kind, usize> = BTreeMap::new();
    let sensors = found.into_iter().zip(numbers).map(|((endpoint, sender, source), clock)| {
        let number = counts.entry(sender.kind).and_modify(|n| *n += 1).or_insert(1);
        let name = |stem: &str| if *number == 1 { stem.to_owned() } else { format!("{stem}_{number}") };
        let (topic, frame) = sender.kind.names();
        let (topic, frame) = (name(topic).into(), name(frame));
        (*endpoint, CapturedSensor { topic, frame, kind: sender.kind, source, clock })
    });
    Sensors { by_sender: sensors.collect(), clocks, models }
}

fn model(sender: &Sender) -> Option<&'static str> {
    match sender.kind {
        Kind::Velodyne => Some(VelodyneModel::of(&sender.first.0).0.name()),
        Kind::OusterLidar => Some("Ouster"),
        Kind::OusterImu => None,
    }
}

/// What lies beside a capture.
#[derive(Default)]
pub(super) struct Descriptions {
    metadata: Option<OusterMetadata>,
    calibration: Option<Vec<Laser>>,
}

impl Descriptions {
    /// What lies there under the capture's name.
    pub fn beside(capture: Option<&Path>) -> Self {
        let Some(capture) = capture else { return Self::default() };
        let text = |ending: &str| {
            let path = capture.with_extension(ending);
            let is_short = std::fs::metadata(&path).is_ok_and(|m| m.is_file() && m.len() <= MAX_DESCRIPTION);
            is_short.then(|| std::fs::read_to_string(&path).ok()).flatten()
        };
        Self {
            metadata: text("json").and_then(|text| OusterMetadata::parse(&text)),
            calibration: text("yaml").or_else(|| text("yml")).and_then(|text| parse_calibration(&text)),
        }
    }
}
