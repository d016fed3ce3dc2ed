//! Captures of the packets that lidars send over the network (`.pcap`, `.pcapng`).
//!
//! Sensors are found by their packets: Velodyne's data packets, and Ouster's lidar and IMU packets. What a
//! sensor cannot tell in its packets is read from files beside the capture with its name: `NAME.json`
//! (metadata of an Ouster) and `NAME.yaml` (calibration of a Velodyne).

mod capture;
mod datagram;

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::Arc;

use portolan_geometry::Time;

use crate::container::Source;
use crate::packets::{
    IMU_PACKET_BYTES, Laser, OUSTER_FRAME, OusterMetadata, PacketDecoder, PacketLayout, PacketSource,
    VelodyneModel, is_velodyne, ouster_source, parse_calibration,
};
use crate::repairs::RepairLog;
use crate::{MessageReader, RecordedMessage, Recording, RecordingError, Repair, TopicInfo};
use capture::CaptureReader;
use datagram::{Datagrams, Endpoint};

pub(crate) use capture::sniff;

/// So many frames are looked at to find the sensors.
const LOOK: usize = 20_000;
/// Longer files beside a capture are no descriptions of a sensor.
const MAX_DESCRIPTION: u64 = 1 << 22;
/// More senders than this are not told apart.
const MAX_ENDPOINTS: usize = 256;

/// One sensor of a capture.
#[derive(Clone)]
struct CapturedSensor {
    topic: Arc<str>,
    frame: String,
    source: PacketSource,
}

/// A capture.
struct Capture {
    source: Source,
    sensors: Arc<BTreeMap<Endpoint, CapturedSensor>>,
    models: String,
    first: Option<Time>,
    size: u64,
    repairs: Vec<Repair>,
}

/// Opens a capture and looks for sensors in it.
pub(crate) fn open(source: Source) -> Result<Box<dyn Recording>, RecordingError> {
    let path = source.name().to_owned();
    let unknown = |detail: String| RecordingError::UnknownFormat { path: path.clone(), detail };
    let mut reader = CaptureReader::open(&source)?.ok_or_else(|| unknown("it is no capture".to_owned()))?;
    let size = source.open()?.length();
    let mut repairs = RepairLog::default();
    let mut datagrams = Datagrams::default();
    // Per sender: length of its packets, whether it is a Velodyne, model, largest column.
    let mut seen: BTreeMap<Endpoint, (usize, Option<VelodyneModel>, u16)> = BTreeMap::new();
    let (mut first, mut udp_frames) = (None, 0_u64);
    for _ in 0..LOOK {
        let Some(frame) = reader.next_frame(&mut repairs)? else { break };
        first = first.or(frame.time);
        let Some((endpoint, payload)) = datagrams.take(frame.link_type, frame.bytes, &mut repairs) else {
            continue;
        };
        udp_frames += 1;
        let model = is_velodyne(&payload).then(|| VelodyneModel::of(&payload).0);
        let is_sensor = model.is_some()
            || payload.len() == IMU_PACKET_BYTES
            || PacketLayout::guess(payload.len()).is_some();
        if is_sensor && (seen.len() < MAX_ENDPOINTS || seen.contains_key(&endpoint)) {
            let entry = seen.entry(endpoint).or_insert((payload.len(), model, 0));
            entry.2 = entry.2.max(PacketLayout::largest_column(&payload));
        }
    }
    let descriptions = Descriptions::beside(source.file());
    // What was wrong will be counted again by every pass.
    let mut repairs = RepairLog::default();
    let (sensors, models) = name_sensors(&seen, &descriptions, &mut repairs);
    if sensors.is_empty() {
        return Err(unknown(format!(
            "it is a capture of the network with {udp_frames} datagrams among its first {LOOK} frames, none of them \
             of a Velodyne (VLP-16, VLP-32C, HDL-32E, HDL-64E) or an Ouster; record the data port of the lidar"
        )));
    }
    let sensors = Arc::new(sensors);
    Ok(Box::new(Capture { source, sensors, models, first, size, repairs: repairs.list() }))
}

/// What lies beside a capture.
#[derive(Default)]
struct Descriptions {
    metadata: Option<OusterMetadata>,
    calibration: Option<Vec<Laser>>,
}

impl Descriptions {
    fn beside(capture: Option<&Path>) -> Self {
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

/// Gives every sensor a topic: the first of a kind without a number.
fn name_sensors(
    seen: &BTreeMap<Endpoint, (usize, Option<VelodyneModel>, u16)>,
    descriptions: &Descriptions,
    repairs: &mut RepairLog,
) -> (BTreeMap<Endpoint, CapturedSensor>, String) {
    let has_ouster = seen.values().any(|(bytes, model, _)| model.is_none() && *bytes != IMU_PACKET_BYTES);
    let mut sensors = BTreeMap::new();
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let mut models: Vec<&str> = Vec::new();
    for (endpoint, (bytes, model, largest)) in seen {
        let (stem, frame, source) = match model {
            Some(model) => {
                models.push(model.name());
                let source = PacketSource::Velodyne(descriptions.calibration.clone());
                ("/velodyne_points", "velodyne", Some(source))
            }
            None if *bytes == IMU_PACKET_BYTES => {
                ("/ouster/imu", OUSTER_FRAME, has_ouster.then_some(PacketSource::OusterImu))
            }
            None => {
                models.push("Ouster");
                let source = ouster_source(descriptions.metadata.as_ref(), *bytes, *largest, repairs);
                ("/ouster/points", OUSTER_FRAME, source)
            }
        };
        let Some(source) = source else { continue };
        let number = counts.entry(stem).and_modify(|n| *n += 1).or_insert(1);
        let name = |stem: &str| if *number == 1 { stem.to_owned() } else { format!("{stem}_{number}") };
        let sensor = CapturedSensor { topic: name(stem).into(), frame: name(frame), source };
        sensors.insert(*endpoint, sensor);
    }
    models.sort_unstable();
    models.dedup();
    (sensors, models.join(", "))
}

impl Recording for Capture {
    fn format(&self) -> String {
        format!("network capture of {}", self.models)
    }

    fn topics(&self) -> Vec<TopicInfo> {
        let info = |sensor: &CapturedSensor| TopicInfo {
            topic: sensor.topic.clone(),
            type_name: sensor.source.type_name().into(),
            count: None,
        };
        let mut topics: Vec<TopicInfo> = self.sensors.values().map(info).collect();
        topics.sort_by(|a, b| a.topic.cmp(&b.topic));
        topics
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        // The end is known only after everything was read.
        None
    }

    fn size_bytes(&self) -> u64 {
        self.size
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let chosen: Vec<Arc<str>> =
            self.topics().into_iter().filter(|t| wanted(t)).map(|t| t.topic).collect();
        let Some(reader) = CaptureReader::open(&self.source)? else {
            let detail = "it is no capture any more".to_owned();
            return Err(RecordingError::UnknownFormat { path: self.source.name().to_owned(), detail });
        };
        let sensors = self.sensors.iter().filter(|(_, sensor)| chosen.contains(&sensor.topic));
        let decoders = sensors.map(|(endpoint, sensor)| {
            (*endpoint, (sensor.topic.clone(), sensor.source.decoder(&sensor.frame)))
        });
        let mut repairs = RepairLog::default();
        repairs.merge(&self.repairs);
        Ok(Box::new(CapturePass {
            reader,
            datagrams: Datagrams::default(),
            decoders: decoders.collect(),
            ready: VecDeque::new(),
            now: self.first.unwrap_or(Time::UNIX_EPOCH),
            repairs,
            ended: false,
        }))
    }
}

/// One pass over a capture.
struct CapturePass {
    reader: CaptureReader,
    datagrams: Datagrams,
    decoders: BTreeMap<Endpoint, (Arc<str>, PacketDecoder)>,
    ready: VecDeque<RecordedMessage>,
    /// Never goes back, so that messages come in order.
    now: Time,
    repairs: RepairLog,
    ended: bool,
}

impl CapturePass {
    /// Takes one frame in; false at the end.
    fn step(&mut self) -> Result<bool, RecordingError> {
        let Some(frame) = self.reader.next_frame(&mut self.repairs)? else { return Ok(false) };
        let time = frame.time.unwrap_or(self.now);
        let Some((endpoint, payload)) = self.datagrams.take(frame.link_type, frame.bytes, &mut self.repairs)
        else {
            return Ok(true);
        };
        let Some((topic, decoder)) = self.decoders.get_mut(&endpoint) else { return Ok(true) };
        self.now = self.now.max(time);
        let (log_time, ready) = (self.now, &mut self.ready);
        decoder.push(&payload, time, &mut self.repairs, &mut |message| {
            ready.push_back(RecordedMessage { topic: topic.clone(), log_time, message });
        });
        Ok(true)
    }

    fn end(&mut self) {
        self.ended = true;
        self.datagrams.finish(&mut self.repairs);
        for (topic, decoder) in self.decoders.values_mut() {
            if let Some(message) = decoder.finish() {
                self.ready.push_back(RecordedMessage { topic: topic.clone(), log_time: self.now, message });
            }
        }
    }
}

impl MessageReader for CapturePass {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        loop {
            if let Some(message) = self.ready.pop_front() {
                return Ok(Some(message));
            }
            if self.ended {
                return Ok(None);
            }
            if !self.step()? {
                self.end();
            }
        }
    }

    fn position_bytes(&self) -> u64 {
        self.reader.position()
    }

    fn repairs(&self) -> Vec<Repair> {
        self.repairs.list()
    }
}
