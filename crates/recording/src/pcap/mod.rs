//! Reads captures of the packets that lidars send over the network (`.pcap`, `.pcapng`).
//!
//! Sensors are found by their packets: data packets of Velodyne, and lidar and IMU packets of Ouster.
//! Parameters that are not in the packets are read from files beside the capture: metadata of an Ouster
//! (`.json`), and `NAME.yaml` (calibration of a Velodyne).

mod capture;
mod descriptions;
mod sensors;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod tests_ouster;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_issue::{Issue, IssueKind, IssueLog};
use portolan_lidar_packets::{Datagrams, SensorTime};

use crate::container::Source;
use crate::packets::{PacketMessages, type_name};
use crate::{MessageReader, RecordedMessage, Recording, RecordingError, TopicInfo};
use capture::CaptureReader;
use descriptions::Descriptions;
use sensors::{CapturedSensor, Kind, Senders, Sensors, Stream};

pub(crate) use capture::sniff;

/// Number of frames that are read to find the sensors.
const LOOK: usize = 20_000;

/// A capture.
struct Capture {
    source: Source,
    sensors: Sensors,
    /// Sizes of lidar packets according to metadata, bytes.
    lengths: BTreeSet<usize>,
    first: Option<Time>,
    size: u64,
    issues: Vec<Issue>,
}

/// Opens a capture and looks for sensors in it.
pub(crate) fn open(source: Source) -> Result<Box<dyn Recording>, RecordingError> {
    let path = source.name().to_owned();
    let unknown = |detail: String| RecordingError::UnknownFormat { path: path.clone(), detail };
    let mut reader =
        CaptureReader::open(&source)?.ok_or_else(|| unknown("it is not a network capture".to_owned()))?;
    let size = source.open()?.length();
    let mut issues = IssueLog::default();
    let mut datagrams = Datagrams::default();
    let mut senders = Senders::default();
    let descriptions = Descriptions::beside(source.file());
    let lengths = descriptions.packet_lengths();
    let (mut first, mut now, mut udp_frames) = (None, Time::UNIX_EPOCH, 0_u64);
    for _ in 0..LOOK {
        let Some(frame) = reader.next_frame(&mut issues)? else { break };
        first = first.or(frame.time);
        now = frame.time.unwrap_or(now);
        if let Some((endpoint, packet)) = datagrams.take(frame.link_type, frame.bytes, &mut issues) {
            udp_frames += 1;
            senders.add(endpoint, &packet, now, &lengths);
        }
    }
    // Issues are not kept here, because every pass over the capture counts them again.
    let mut issues = IssueLog::default();
    let sensors = senders.sensors(&descriptions, &mut issues);
    if sensors.by_sender.is_empty() {
        return Err(unknown(format!(
            "it is a network capture with {udp_frames} datagrams among its first {LOOK} frames, none of them \
             of a Velodyne (VLP-16, VLP-32C, HDL-32E, HDL-64E) or an Ouster; record the data port of the lidar"
        )));
    }
    Ok(Box::new(Capture { source, sensors, lengths, first, size, issues: issues.list() }))
}

impl Recording for Capture {
    fn format(&self) -> String {
        format!("network capture of {}", self.sensors.models)
    }

    fn topics(&self) -> Vec<TopicInfo> {
        let info = |sensor: &CapturedSensor| TopicInfo {
            topic: sensor.topic.clone(),
            type_name: type_name(&sensor.source).into(),
            count: None,
        };
        let mut topics: Vec<TopicInfo> = self.sensors.by_sender.values().map(info).collect();
        topics.sort_by(|a, b| a.topic.cmp(&b.topic));
        topics
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        // The end is only known after the whole capture was read.
        None
    }

    fn size_bytes(&self) -> u64 {
        self.size
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let chosen: Vec<Arc<str>> =
            self.topics().into_iter().filter(|t| wanted(t)).map(|t| t.topic).collect();
        let Some(reader) = CaptureReader::open(&self.source)? else {
            let detail = "it is no longer a network capture: the file has changed".to_owned();
            return Err(RecordingError::UnknownFormat { path: self.source.name().to_owned(), detail });
        };
        let is_chosen = |sensor: &CapturedSensor| chosen.contains(&sensor.topic);
        let sensors = || self.sensors.by_sender.iter().filter(|(_, sensor)| is_chosen(sensor));
        let decoder = |(stream, sensor): (&Stream, &CapturedSensor)| {
            let decoder = PacketMessages::new(&sensor.source, &sensor.frame);
            (*stream, ChosenSensor { topic: sensor.topic.clone(), clock: sensor.clock, decoder })
        };
        let mut issues = IssueLog::default();
        issues.merge(&self.issues);
        Ok(Box::new(CapturePass {
            reader,
            datagrams: Datagrams::default(),
            lengths: self.lengths.clone(),
            known: self.sensors.by_sender.keys().copied().collect(),
            kinds: sensors().map(|(_, sensor)| sensor.kind).collect(),
            chosen: sensors().map(decoder).collect(),
            clocks: self.sensors.clocks.clone(),
            ready: VecDeque::new(),
            now: self.first.unwrap_or(Time::UNIX_EPOCH),
            issues,
            ended: false,
        }))
    }
}

/// A sensor that is read.
struct ChosenSensor {
    topic: Arc<str>,
    clock: usize,
    decoder: PacketMessages,
}

/// One pass over a capture.
struct CapturePass {
    reader: CaptureReader,
    datagrams: Datagrams,
    /// All sensors of the capture, and the kinds of those that are read.
    known: BTreeSet<Stream>,
    kinds: BTreeSet<Kind>,
    chosen: BTreeMap<Stream, ChosenSensor>,
    lengths: BTreeSet<usize>,
    clocks: Vec<SensorTime>,
    ready: VecDeque<RecordedMessage>,
    /// Time of the last frame; it never decreases, so messages are in order.
    now: Time,
    issues: IssueLog,
    ended: bool,
}

impl CapturePass {
    /// Processes one frame; false at the end.
    fn step(&mut self) -> Result<bool, RecordingError> {
        let Some(frame) = self.reader.next_frame(&mut self.issues)? else { return Ok(false) };
        let time = frame.time.unwrap_or(self.now);
        let Some((endpoint, payload)) = self.datagrams.take(frame.link_type, frame.bytes, &mut self.issues)
        else {
            return Ok(true);
        };
        let stream = Stream::of(endpoint, &payload, &self.lengths);
        let known = stream.filter(|stream| self.known.contains(stream));
        if known.is_none() && stream.is_some_and(|stream| self.kinds.contains(&stream.kind)) {
            self.issues.add(IssueKind::RareSender);
            return Ok(true);
        }
        // A packet of no known format is damaged. It is given to the first decoder of its endpoint, which
        // counts it.
        let first = || self.known.range(Stream::least(endpoint)..).next().filter(|s| s.endpoint == endpoint);
        let sensor = known.or_else(|| first().copied()).and_then(|stream| self.chosen.get_mut(&stream));
        let Some(sensor) = sensor else { return Ok(true) };
        let Some(clock) = self.clocks.get_mut(sensor.clock) else { return Ok(true) };
        self.now = self.now.max(time);
        let (log_time, ready, topic) = (self.now, &mut self.ready, &sensor.topic);
        sensor.decoder.push((&payload, time), clock, &mut self.issues, &mut |message| {
            ready.push_back(RecordedMessage { topic: topic.clone(), log_time, message });
        });
        Ok(true)
    }

    fn end(&mut self) {
        self.ended = true;
        self.datagrams.finish(&mut self.issues);
        for sensor in self.chosen.values_mut() {
            if let Some(message) = sensor.decoder.finish() {
                let topic = sensor.topic.clone();
                self.ready.push_back(RecordedMessage { topic, log_time: self.now, message });
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

    fn issues(&self) -> Vec<Issue> {
        self.issues.list()
    }
}
