//! Bags of raw packets (`velodyne_msgs/VelodyneScan`, Ouster's `PacketMsg`), read as clouds.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use portolan_geometry::Time;

use super::ouster::USUAL_COLUMNS;
use super::{IMU_PACKET_BYTES, OUSTER_FRAME, OusterMetadata, PacketDecoder, PacketLayout, PacketSource};
use crate::codec::MessageKind;
use crate::repairs::RepairLog;
use crate::{
    Message, MessageReader, PacketKind, RecordedMessage, Recording, RecordingError, Repair, TopicInfo,
};

/// So many messages are looked at to find out what a topic of packets holds.
const LOOK: usize = 400;

/// A recording whose packets are read as clouds and IMU samples.
struct Unpacked {
    inner: Box<dyn Recording>,
    sources: Sources,
    repairs: Vec<Repair>,
}

/// Per topic of packets: what they are, and their frame.
type Sources = Arc<BTreeMap<Arc<str>, (PacketSource, String)>>;

/// Types whose messages are decoded as clouds, each by itself.
fn holds_cloud(type_name: &str) -> bool {
    MessageKind::from_type_name(type_name) == Some(MessageKind::LivoxPoints)
}

fn holds_packets(type_name: &str) -> bool {
    matches!(type_name.rsplit('/').next(), Some("VelodyneScan" | "PacketMsg"))
}

/// The recording itself, or one that shows its packets as clouds.
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
            look.add(&message.topic, packets);
        }
        seen += 1;
        if seen >= LOOK {
            break;
        }
    }
    if look.metadata.is_empty() && topics.iter().any(is_metadata) {
        look.find_metadata(&*inner)?;
    }
    let mut repairs = RepairLog::default();
    let sources = look.sources(&mut repairs);
    Ok(Box::new(Unpacked { inner, sources: Arc::new(sources), repairs: repairs.list() }))
}

fn is_metadata(topic: &TopicInfo) -> bool {
    &*topic.type_name == "std_msgs/String" && topic.topic.ends_with("metadata")
}

/// What was seen of the packets.
#[derive(Default)]
struct Look {
    /// By topic: kind, length of the packets, largest number of a column, frame.
    topics: BTreeMap<Arc<str>, (PacketKind, usize, u16, String)>,
    /// By topic.
    metadata: BTreeMap<Arc<str>, OusterMetadata>,
}

impl Look {
    fn add(&mut self, topic: &Arc<str>, message: &crate::SensorPackets) {
        let first = message.packets.first().map(|(_, bytes)| bytes.as_slice()).unwrap_or_default();
        if message.kind == PacketKind::OusterMetadata {
            if let Some(metadata) = std::str::from_utf8(first).ok().and_then(OusterMetadata::parse) {
                self.metadata.insert(topic.clone(), metadata);
            }
            return;
        }
        let frame = message.header.as_ref().map_or("", |h| &h.frame_id).to_owned();
        let entry = self.topics.entry(topic.clone()).or_insert((message.kind, first.len(), 0, frame));
        entry.2 = entry.2.max(PacketLayout::largest_column(first));
    }

    fn find_metadata(&mut self, inner: &dyn Recording) -> Result<(), RecordingError> {
        let mut reader = inner.read(&is_metadata)?;
        for _ in 0..LOOK {
            let Some(message) = reader.next_message()? else { break };
            if let Message::SensorPackets(packets) = &message.message {
                self.add(&message.topic, packets);
            }
        }
        Ok(())
    }

    /// Metadata of the same node, or of the only one.
    fn metadata_of(&self, topic: &str) -> Option<&OusterMetadata> {
        let node = |topic: &str| topic.rsplit_once('/').map(|(node, _)| node.to_owned());
        let same_node = self.metadata.iter().find(|(name, _)| node(name) == node(topic));
        same_node.or_else(|| self.metadata.iter().next().filter(|_| self.metadata.len() == 1)).map(|(_, m)| m)
    }

    fn sources(&self, repairs: &mut RepairLog) -> BTreeMap<Arc<str>, (PacketSource, String)> {
        let mut sources = BTreeMap::new();
        for (topic, (kind, bytes, largest, frame)) in &self.topics {
            let source = match kind {
                PacketKind::Velodyne => Some(PacketSource::Velodyne(None)),
                _ if *bytes == IMU_PACKET_BYTES => Some(PacketSource::OusterImu),
                _ => ouster_source(self.metadata_of(topic), *bytes, *largest, repairs),
            };
            let Some(source) = source else {
                repairs.lost(format!(
                    "{topic}: packets of {bytes} bytes are of no known sensor and were left out"
                ));
                continue;
            };
            let usual = if *kind == PacketKind::Velodyne { "velodyne" } else { OUSTER_FRAME };
            let frame = if frame.is_empty() { usual.to_owned() } else { frame.clone() };
            sources.insert(topic.clone(), (source, frame));
        }
        sources
    }
}

/// The lidar of an Ouster, from what it tells or from the length of its packets.
pub(crate) fn ouster_source(
    metadata: Option<&OusterMetadata>,
    bytes: usize,
    largest_column: u16,
    repairs: &mut RepairLog,
) -> Option<PacketSource> {
    if let Some(metadata) = metadata {
        let layout = |profile| PacketLayout {
            profile,
            channels: metadata.altitudes.len(),
            columns: metadata.columns_per_packet,
        };
        let told = metadata.profile.into_iter().chain(super::ouster_metadata::PacketProfile::ALL);
        let fitting = told.map(layout).find(|layout| layout.packet_bytes() == bytes);
        if let Some(layout) = fitting {
            return Some(PacketSource::OusterLidar(Box::new(metadata.clone()), layout));
        }
        repairs.repaired("the metadata of an Ouster do not fit its packets and were not used");
    }
    let layout = PacketLayout::guess(bytes)?;
    repairs.repaired(
        "an Ouster without its metadata was read with nominal angles of beams; put its metadata (.json) beside \
         the capture under the same name",
    );
    let columns = usize::from(largest_column).max(USUAL_COLUMNS).next_power_of_two().clamp(512, 4096);
    let metadata = OusterMetadata::assumed(layout.channels, columns);
    Some(PacketSource::OusterLidar(Box::new(metadata), layout))
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
            if let Some((source, _)) = self.sources.get(&info.topic) {
                info.type_name = source.type_name().into();
                if matches!(source, PacketSource::OusterLidar(..)) {
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
        let mut repairs = RepairLog::default();
        repairs.merge(&self.repairs);
        let decoders = self
            .sources
            .iter()
            .filter(|(topic, _)| chosen.contains(topic))
            .map(|(topic, (source, frame))| (topic.clone(), source.decoder(frame)))
            .collect();
        Ok(Box::new(UnpackedReader {
            inner,
            decoders,
            ready: VecDeque::new(),
            repairs,
            last: Time::MIN,
            ended: false,
        }))
    }
}

struct UnpackedReader {
    inner: Box<dyn MessageReader>,
    decoders: BTreeMap<Arc<str>, PacketDecoder>,
    ready: VecDeque<RecordedMessage>,
    repairs: RepairLog,
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
        let Some(decoder) = self.decoders.get_mut(&topic) else {
            // Of no known sensor, which was counted, or metadata.
            let bytes = packets.packets.iter().map(|(_, bytes)| bytes.len()).sum();
            let message = Message::Other { type_name: packets.kind.type_name().into(), bytes };
            self.ready.push_back(RecordedMessage { topic, log_time, message });
            return;
        };
        for (stamp, bytes) in &packets.packets {
            let arrival = stamp.filter(|s| *s != Time::UNIX_EPOCH).unwrap_or(log_time);
            decoder.push(bytes, arrival, &mut self.repairs, &mut |message| {
                self.ready.push_back(RecordedMessage { topic: topic.clone(), log_time, message });
            });
        }
    }

    fn end(&mut self) {
        self.ended = true;
        for (topic, decoder) in &mut self.decoders {
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

    fn repairs(&self) -> Vec<Repair> {
        let mut repairs = self.repairs.clone();
        repairs.merge(&self.inner.repairs());
        repairs.list()
    }
}
