//! Reads bags of raw packets (`velodyne_msgs/VelodyneScan`, Ouster's `PacketMsg`) as clouds.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_lidar_packets::{
    OusterMetadata, PacketHeader, PacketLayout, PacketSource, PacketStream, SensorTime, clocks_of,
    is_other_ouster_data, is_ouster_imu, ouster_imu_serial,
};

use super::{OUSTER_FRAME, PacketMessages, type_name};
use crate::{Message, MessageReader, PacketKind, RecordedMessage, Recording, RecordingError, TopicInfo};
use portolan_ros_messages::MessageKind;

/// Number of messages that are read to find out what the topics with packets contain.
const LOOK: usize = 400;

/// A recording whose packets are read as clouds and IMU samples.
struct Unpacked {
    inner: Box<dyn Recording>,
    sources: BTreeMap<Arc<str>, TopicOfPackets>,
    clocks: Vec<SensorTime>,
    issues: Vec<Issue>,
}

/// A topic whose packets can be decoded.
struct TopicOfPackets {
    source: PacketSource,
    frame: String,
    /// Index of its sensor's clock.
    clock: usize,
    /// Whether each packet becomes a message.
    is_one_to_one: bool,
}

/// Whether each message of a type is decoded to one cloud.
fn holds_cloud(type_name: &str) -> bool {
    matches!(
        MessageKind::from_type_name(type_name),
        Some(MessageKind::LivoxPoints | MessageKind::PointCloud1)
    )
}

fn holds_packets(type_name: &str) -> bool {
    matches!(type_name.rsplit('/').next(), Some("VelodyneScan" | "PacketMsg"))
}

/// The recording itself, or one whose packets are decoded to clouds.
pub(crate) fn unpacked(inner: Box<dyn Recording>) -> Result<Box<dyn Recording>, RecordingError> {
    let topics = inner.topics();
    if !topics.iter().any(|t| holds_packets(&t.type_name) || holds_cloud(&t.type_name)) {
        return Ok(inner);
    }
    let mut look = Look::default();
    let is_wanted = |t: &TopicInfo| holds_packets(&t.type_name) || is_metadata(t);
    let mut reader = inner.read(&is_wanted)?;
    let mut seen = 0;
    while let Some(message) = reader.next_message()? {
        if let Message::SensorPackets(packets) = &message.message {
            look.add(&message.topic, message.log_time, packets);
        }
        seen += 1;
        if seen >= LOOK {
            break;
        }
    }
    if look.metadata.is_empty() && topics.iter().any(is_metadata) {
        look.find_metadata(&*inner)?;
    }
    let mut issues = IssueLog::default();
    let (sources, clocks) = look.sources(&mut issues);
    Ok(Box::new(Unpacked { inner, sources, clocks, issues: issues.list() }))
}

fn is_metadata(topic: &TopicInfo) -> bool {
    &*topic.type_name == "std_msgs/String" && topic.topic.ends_with("metadata")
}

/// Packets and metadata seen in the first messages.
#[derive(Default)]
struct Look {
    topics: BTreeMap<Arc<str>, SeenTopic>,
    /// By topic.
    metadata: BTreeMap<Arc<str>, OusterMetadata>,
}

/// Properties of the packets of a topic.
struct SeenTopic {
    kind: PacketKind,
    /// The first packet and its time of arrival.
    first: (Vec<u8>, Time),
    largest_column: u16,
    frame: String,
}

/// Time of arrival of a packet: its stamp, else the log time.
fn arrival_of(stamp: Option<Time>, log_time: Time) -> Time {
    stamp.filter(|s| *s != Time::UNIX_EPOCH).unwrap_or(log_time)
}

/// The part of a topic's name that comes from its node.
fn node(topic: &str) -> &str {
    topic.rsplit_once('/').map_or("", |(node, _)| node)
}

impl Look {
    fn add(&mut self, topic: &Arc<str>, log_time: Time, message: &crate::SensorPackets) {
        let Some((stamp, first)) = message.packets.first() else { return };
        if message.kind == PacketKind::OusterMetadata {
            if let Some(metadata) = std::str::from_utf8(first).ok().and_then(OusterMetadata::parse) {
                self.metadata.insert(topic.clone(), metadata);
            }
            return;
        }
        if message.kind == PacketKind::Ouster && is_other_ouster_data(first) {
            return;
        }
        let seen = self.topics.entry(topic.clone()).or_insert_with(|| SeenTopic {
            kind: message.kind,
            first: (first.clone(), arrival_of(*stamp, log_time)),
            largest_column: 0,
            frame: message.header.as_ref().map_or("", |h| &h.frame_id).to_owned(),
        });
        seen.largest_column = seen.largest_column.max(PacketLayout::largest_column(first));
    }

    fn find_metadata(&mut self, inner: &dyn Recording) -> Result<(), RecordingError> {
        let mut reader = inner.read(&is_metadata)?;
        for _ in 0..LOOK {
            let Some(message) = reader.next_message()? else { break };
            if let Message::SensorPackets(packets) = &message.message {
                self.add(&message.topic, message.log_time, packets);
            }
        }
        Ok(())
    }

    /// Metadata of the same node, else of the same serial number, else the only metadata.
    fn metadata_of(&self, topic: &str, packet: &[u8]) -> Option<&OusterMetadata> {
        let serial = PacketHeader::of(packet).serial(packet);
        let same_node = || self.metadata.iter().find(|(name, _)| node(name) == node(topic));
        let same_serial = || self.metadata.iter().find(|(_, m)| m.serial.is_some() && m.serial == serial);
        let only = || self.metadata.iter().next().filter(|_| self.metadata.len() == 1);
        same_node().or_else(same_serial).or_else(only).map(|(_, metadata)| metadata)
    }

    fn sources(&self, issues: &mut IssueLog) -> (BTreeMap<Arc<str>, TopicOfPackets>, Vec<SensorTime>) {
        let mut found = Vec::new();
        for (topic, seen) in &self.topics {
            let packet = &seen.first.0;
            let source = match seen.kind {
                PacketKind::Velodyne => Some(PacketSource::Velodyne(None)),
                _ if is_ouster_imu(packet) => Some(PacketSource::OusterImu),
                _ => {
                    let metadata = self.metadata_of(topic, packet);
                    PacketSource::ouster_lidar(metadata, packet, seen.largest_column, issues)
                }
            };
            match source {
                Some(source) => found.push((topic, seen, source)),
                None => issues.add(
                    Issue::new(IssueKind::UnknownPacketSensor)
                        .of(topic.clone())
                        .with_number("bytes", packet.len()),
                ),
            }
        }
        let streams: Vec<_> = found
            .iter()
            .map(|(topic, seen, source)| PacketStream::new(node(topic), source, &seen.first))
            .collect();
        let (numbers, clocks) = clocks_of(&streams);
        let named = found.into_iter().zip(numbers).map(|((topic, seen, source), clock)| {
            let usual = if seen.kind == PacketKind::Velodyne { "velodyne" } else { OUSTER_FRAME };
            let frame = if seen.frame.is_empty() { usual.to_owned() } else { seen.frame.clone() };
            let is_one_to_one = match source {
                PacketSource::Velodyne(_) => true,
                PacketSource::OusterLidar(..) => false,
                PacketSource::OusterImu => ouster_imu_serial(&seen.first.0).is_none(),
            };
            (Arc::clone(topic), TopicOfPackets { source, frame, clock, is_one_to_one })
        });
        (named.collect(), clocks)
    }
}

impl Recording for Unpacked {
    fn format(&self) -> String {
        let packets = if self.sources.is_empty() { "" } else { " of sensor packets" };
        format!("{}{packets}", self.inner.format())
    }

    fn topics(&self) -> Vec<TopicInfo> {
        let mut topics = self.inner.topics();
        for info in &mut topics {
            if holds_cloud(&info.type_name) {
                info.type_name = "sensor_msgs/PointCloud2".into();
            }
            if let Some(topic) = self.sources.get(&info.topic) {
                info.type_name = type_name(&topic.source).into();
                if !topic.is_one_to_one {
                    info.count = None;
                }
            }
        }
        topics
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        self.inner.time_range()
    }

    fn size_bytes(&self) -> u64 {
        self.inner.size_bytes()
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let chosen: Vec<Arc<str>> =
            self.topics().into_iter().filter(|t| wanted(t)).map(|t| t.topic).collect();
        let inner = self.inner.read(&|t| chosen.contains(&t.topic))?;
        let mut issues = IssueLog::default();
        issues.merge(&self.issues);
        let decoders = self
            .sources
            .iter()
            .filter(|(topic, _)| chosen.contains(topic))
            .map(|(topic, known)| {
                (topic.clone(), (known.clock, PacketMessages::new(&known.source, &known.frame)))
            })
            .collect();
        Ok(Box::new(UnpackedReader {
            inner,
            decoders,
            clocks: self.clocks.clone(),
            ready: VecDeque::new(),
            issues,
            last: Time::MIN,
            ended: false,
        }))
    }
}

struct UnpackedReader {
    inner: Box<dyn MessageReader>,
    /// By topic: index of the clock, and the decoder of its packets.
    decoders: BTreeMap<Arc<str>, (usize, PacketMessages)>,
    clocks: Vec<SensorTime>,
    ready: VecDeque<RecordedMessage>,
    issues: IssueLog,
    last: Time,
    ended: bool,
}

impl UnpackedReader {
    fn take(&mut self, recorded: RecordedMessage) {
        let RecordedMessage { topic, log_time, message } = recorded;
        self.last = self.last.max(log_time);
        let Message::SensorPackets(packets) = message else {
            self.ready.push_back(RecordedMessage { topic, log_time, message });
            return;
        };
        let decoder = self.decoders.get_mut(&topic);
        let Some((clock, decoder)) = decoder.and_then(|(i, d)| Some((self.clocks.get_mut(*i)?, d))) else {
            // Metadata, or packets of an unknown sensor, which was counted already.
            let bytes = packets.packets.iter().map(|(_, bytes)| bytes.len()).sum();
            let message = Message::Other { type_name: packets.kind.type_name().into(), bytes };
            self.ready.push_back(RecordedMessage { topic, log_time, message });
            return;
        };
        for (stamp, bytes) in &packets.packets {
            let packet = (bytes.as_slice(), arrival_of(*stamp, log_time));
            decoder.push(packet, clock, &mut self.issues, &mut |message| {
                self.ready.push_back(RecordedMessage { topic: topic.clone(), log_time, message });
            });
        }
    }

    fn end(&mut self) {
        self.ended = true;
        for (topic, (_, decoder)) in &mut self.decoders {
            if let Some(message) = decoder.finish() {
                self.ready.push_back(RecordedMessage { topic: topic.clone(), log_time: self.last, message });
            }
        }
    }
}

impl MessageReader for UnpackedReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        loop {
            if let Some(message) = self.ready.pop_front() {
                return Ok(Some(message));
            }
            if self.ended {
                return Ok(None);
            }
            match self.inner.next_message()? {
                Some(message) => self.take(message),
                None => self.end(),
            }
        }
    }

    fn position_bytes(&self) -> u64 {
        self.inner.position_bytes()
    }

    fn issues(&self) -> Vec<Issue> {
        let mut issues = self.issues.clone();
        issues.merge(&self.inner.issues());
        issues.list()
    }
}
