//! What a recording holds, from one pass over all of it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_recording::{Message, TfInput, TfTree, open};
use serde::Serialize;

use super::recording_text::sensor;
use crate::error::CliError;
use crate::progress::Progress;

/// Parent frame whose children are results of mapping, not input.
const MAP_FRAME: &str = "map";
/// More frames than this on one topic are only counted as "more".
const MAX_FRAMES: usize = 16;

/// Summary of a recording.
#[derive(Serialize)]
pub struct RecordingReport {
    pub path: String,
    pub format: String,
    /// Bytes on disk.
    pub size: u64,
    /// Messages that could be read.
    pub messages: u64,
    /// Unix seconds of the first and the last message, by time of recording.
    pub start_time: Option<String>,
    pub end_time: Option<String>,
    /// Seconds.
    pub duration: f64,
    pub topics: Vec<TopicReport>,
    /// The tree of transforms, one frame a line.
    pub transforms: String,
    pub repairs: Vec<RepairReport>,
}

/// One topic.
#[derive(Serialize)]
pub struct TopicReport {
    pub topic: String,
    #[serde(rename = "type")]
    pub type_name: String,
    pub count: u64,
    /// Messages per second between the first and the last.
    pub rate: Option<f64>,
    /// Frames of the messages' headers.
    pub frames: Vec<String>,
    /// What the sensor is like, from its first message.
    pub sensor: Option<String>,
}

/// Something that was repaired or lost while reading.
#[derive(Serialize)]
pub struct RepairReport {
    pub what: String,
    pub count: u64,
    pub lost_data: bool,
}

#[derive(Default)]
struct Topic {
    type_name: Option<Arc<str>>,
    count: u64,
    times: Option<(Time, Time)>,
    frames: BTreeSet<Arc<str>>,
    sensor: Option<String>,
}

impl Topic {
    fn add(&mut self, time: Time, message: &Message) {
        self.count += 1;
        let (first, last) = self.times.unwrap_or((time, time));
        self.times = Some((first.min(time), last.max(time)));
        if let Some(header) = message.header()
            && !self.frames.contains(&header.frame_id)
            && self.frames.len() < MAX_FRAMES
        {
            self.frames.insert(Arc::clone(&header.frame_id));
        }
        if self.count == 1 {
            self.sensor = sensor(message);
        }
    }

    fn finish(self, name: &str) -> TopicReport {
        let seconds = self.times.map_or(0.0, |(first, last)| last.seconds_since(first));
        TopicReport {
            topic: name.to_owned(),
            type_name: self.type_name.as_deref().unwrap_or("unknown").to_owned(),
            count: self.count,
            rate: (self.count > 1 && seconds > 0.0).then(|| (self.count - 1) as f64 / seconds),
            frames: self.frames.iter().map(ToString::to_string).collect(),
            sensor: self.sensor,
        }
    }
}

/// Reads a whole recording and sums it up.
pub fn read(path: &Path, quiet: bool) -> Result<RecordingReport, CliError> {
    let recording = open(path)?;
    let mut topics: BTreeMap<Arc<str>, Topic> = BTreeMap::new();
    for info in recording.topics() {
        topics.entry(info.topic).or_default().type_name = Some(info.type_name);
    }
    let (mut tree, mut tf) = (TfTree::new(), TfInput::new(MAP_FRAME));
    let mut progress = Progress::start("read", recording.size_bytes(), quiet);
    let mut reader = recording.read(&|_| true)?;
    let (mut messages, mut times) = (0, None);
    while let Some(recorded) = reader.next_message()? {
        messages += 1;
        let time = recorded.log_time;
        let (first, last) = times.unwrap_or((time, time));
        times = Some((time.min(first), time.max(last)));
        if let Message::Tf(message) = &recorded.message {
            tf.insert(&mut tree, message);
            if messages % 4096 == 0 {
                // Only the shape of the tree is told; memory stays bounded.
                tree.forget_before(time);
            }
        }
        let topic = topics.entry(recorded.topic).or_default();
        topic.type_name.get_or_insert_with(|| recorded.message.type_name().into());
        topic.add(time, &recorded.message);
        if progress.is_due() {
            progress.update(reader.position_bytes(), recording.size_bytes(), format!("{messages} messages"));
        }
    }
    progress.finish();
    let repairs = reader.repairs().into_iter();
    Ok(RecordingReport {
        path: path.display().to_string(),
        format: recording.format(),
        size: recording.size_bytes(),
        messages,
        start_time: times.map(|(start, _)| start.unix_decimal()),
        end_time: times.map(|(_, end)| end.unix_decimal()),
        duration: times.map_or(0.0, |(start, end)| end.seconds_since(start)),
        topics: topics.into_iter().map(|(name, topic)| topic.finish(&name)).collect(),
        transforms: tree.to_text(),
        repairs: repairs
            .map(|r| RepairReport { what: r.what, count: r.count, lost_data: r.lost_data })
            .collect(),
    })
}
