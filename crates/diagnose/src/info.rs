//! Describes the contents of a recording.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;

use portolan_geometry::{Dimension, Time};
use portolan_ingest::{
    IngestOptions, Inventory, Notice, PlannedOdometry, RangeStatistics, TopicSurvey, plan,
};
use portolan_issue::Issue;
use portolan_recording::{Recording, RecordingError};

/// One topic.
#[derive(Clone, Debug, serde::Serialize)]
pub struct TopicDescription {
    /// Name.
    pub topic: String,
    /// ROS type as `package/Type`.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Number of messages.
    pub count: u64,
    /// Messages per second.
    pub rate: Option<f64>,
    /// Frame of its messages.
    pub frame: Option<String>,
    /// Child frame of odometry, whose pose it measures.
    pub child_frame: Option<String>,
    /// Description of the sensor in words.
    pub sensor: Option<String>,
}

/// Sensors and settings that mapping would use.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PlanDescription {
    /// 2D or 3D.
    pub dimension: Dimension,
    /// The frame whose motion is mapped.
    pub tracking_frame: String,
    /// Topics of range sensors.
    pub range: Vec<String>,
    /// Topic of odometry, or the transforms it comes from.
    pub odometry: Option<String>,
    /// Topic of the IMU.
    pub imu: Option<String>,
    /// Choices that were made, and how to choose otherwise.
    pub notices: Vec<Notice>,
}

/// Contents of a recording.
#[derive(Clone, Debug, serde::Serialize)]
pub struct RecordingInfo {
    /// Name of the format.
    pub format: String,
    /// Bytes on disk.
    pub size_bytes: u64,
    /// Number of messages.
    pub messages: u64,
    /// Unix seconds of the first message, by time of recording.
    pub start_time: Option<String>,
    /// Unix seconds of the last message.
    pub end_time: Option<String>,
    /// Time between them, seconds.
    pub duration: f64,
    /// All topics in ascending order.
    pub topics: Vec<TopicDescription>,
    /// All frames in ascending order.
    pub frames: Vec<String>,
    /// The tree of transforms, one frame a line.
    pub transforms: String,
    /// Sensors and settings that mapping would use.
    pub plan: Option<PlanDescription>,
    /// Reason why it cannot be mapped.
    pub obstacle: Option<String>,
    /// Data that had to be repaired or left out for this description.
    pub issues: Vec<Issue>,
}

/// Describes a recording. Reads only its beginning if its index contains the rest, otherwise all of it.
/// `progress` receives the number of bytes read so far.
///
/// # Errors
/// If the recording cannot be read.
pub fn info(
    recording: &dyn Recording,
    options: &IngestOptions,
    progress: &mut dyn FnMut(u64),
) -> Result<RecordingInfo, RecordingError> {
    let inventory = Inventory::of(recording, options)?;
    let indexed = recording.topics().iter().all(|t| t.count.is_some());
    let is_large = recording.size_bytes() > READ_WHOLE;
    let (counts, range, mut issues) = match recording.time_range().filter(|_| indexed && is_large) {
        Some(range) => by_index(recording, range)?.map_or_else(|| count_messages(recording, progress), Ok)?,
        None => count_messages(recording, progress)?,
    };
    issues.extend(inventory.issues.iter().chain(&inventory.moving_issues).cloned());
    let duration = range.map_or(0.0, |(first, last)| last.seconds_since(first));
    let (plan, obstacle) = match describe_plan(&inventory, options) {
        Ok(plan) => (Some(plan), None),
        Err(obstacle) => (None, Some(obstacle)),
    };
    let describe = |survey: &TopicSurvey| describe(survey, counts.get(&survey.info.topic), duration);
    Ok(RecordingInfo {
        format: recording.format(),
        size_bytes: recording.size_bytes(),
        messages: counts.values().sum(),
        start_time: range.map(|(first, _)| first.unix_decimal()),
        end_time: range.map(|(_, last)| last.unix_decimal()),
        duration,
        topics: inventory.topics.iter().map(describe).collect(),
        frames: frames(&inventory),
        transforms: inventory.tree.to_text(),
        plan,
        obstacle,
        issues,
    })
}

/// Size below which a recording is read completely, bytes: damage in it is then found, and it takes a
/// second.
const READ_WHOLE: u64 = 256 << 20;

/// Counts from the index; none if the index, or the structure that leads to the messages, is damaged: then
/// only reading all messages shows what is left.
fn by_index(recording: &dyn Recording, range: (Time, Time)) -> Result<Option<Counts>, RecordingError> {
    let counts = recording.topics().into_iter().map(|t| (t.topic, t.count.unwrap_or(0))).collect();
    let mut reader = recording.read(&|_| false)?;
    while reader.next_message()?.is_some() {}
    let issues = reader.issues();
    Ok(issues.is_empty().then_some((counts, Some(range), issues)))
}

type Counts = (BTreeMap<Arc<str>, u64>, Option<(Time, Time)>, Vec<Issue>);

fn count_messages(
    recording: &dyn Recording,
    progress: &mut dyn FnMut(u64),
) -> Result<Counts, RecordingError> {
    let mut counts: BTreeMap<Arc<str>, u64> = BTreeMap::new();
    let mut range: Option<(Time, Time)> = None;
    let mut reader = recording.read(&|_| true)?;
    let mut messages = 0u64;
    while let Some(message) = reader.next_message()? {
        *counts.entry(message.topic).or_default() += 1;
        let (first, last) = range.unwrap_or((message.log_time, message.log_time));
        range = Some((first.min(message.log_time), last.max(message.log_time)));
        messages += 1;
        if messages.is_multiple_of(256) {
            progress(reader.position_bytes());
        }
    }
    Ok((counts, range, reader.issues()))
}

fn frames(inventory: &Inventory) -> Vec<String> {
    let mut frames: Vec<String> = inventory.tree.frames().map(str::to_owned).collect();
    for topic in &inventory.topics {
        frames.extend([&topic.frame, &topic.child_frame].into_iter().flatten().map(|f| f.to_string()));
    }
    frames.retain(|f| !f.is_empty());
    frames.sort();
    frames.dedup();
    frames
}

fn describe(survey: &TopicSurvey, count: Option<&u64>, duration: f64) -> TopicDescription {
    let count = count.copied().unwrap_or(survey.seen);
    let mean_rate = (count > 1 && duration > 0.0).then(|| (count - 1) as f64 / duration);
    TopicDescription {
        topic: survey.info.topic.to_string(),
        type_name: survey.info.type_name.to_string(),
        count,
        rate: mean_rate,
        frame: survey.frame.as_deref().map(str::to_owned),
        child_frame: survey.child_frame.as_deref().map(str::to_owned),
        sensor: survey.range.as_ref().map(range_in_words).or_else(|| {
            let imu = survey.imu.as_ref()?;
            Some(format!("{:.0} Hz, measures {:.2} m/s² (median)", imu.rate, imu.median_acceleration))
        }),
    }
}

fn range_in_words(range: &RangeStatistics) -> String {
    let mut text = format!("{} readings over {:.0}°", range.readings, range.field_of_view.to_degrees());
    if range.vertical_field_of_view > 0.01 {
        let _ = write!(text, " by {:.0}°", range.vertical_field_of_view.to_degrees());
    }
    let _ = write!(
        text,
        ", {:.1} Hz, half of the ranges below {:.1} m, largest {:.1} m",
        range.rate, range.median_range, range.max_range
    );
    match range.has_point_times() {
        true => {
            let _ = write!(text, ", {:.0} ms a sweep", 1e3 * range.sweep_duration);
        }
        false => text.push_str(", no times of points"),
    }
    text
}

fn describe_plan(inventory: &Inventory, options: &IngestOptions) -> Result<PlanDescription, String> {
    let plan = plan(inventory, options).map_err(|error| error.to_string())?;
    Ok(PlanDescription {
        dimension: plan.dimension,
        tracking_frame: plan.tracking_frame.clone(),
        range: plan.range.iter().map(|r| r.source.topic.to_string()).collect(),
        odometry: plan.odometry.as_ref().map(PlannedOdometry::name),
        imu: plan.imu.as_ref().map(|i| i.source.topic.to_string()),
        notices: plan.notices,
    })
}

impl RecordingInfo {
    /// The description as text for the user.
    pub fn to_text(&self) -> String {
        let mut text = format!("format:   {}\nsize:     {}\n", self.format, bytes(self.size_bytes));
        let _ = writeln!(text, "messages: {}", self.messages);
        if let (Some(start), Some(end)) = (&self.start_time, &self.end_time) {
            let _ = writeln!(text, "duration: {:.3} s, from {start} to {end}", self.duration);
        }
        text.push_str("topics:\n");
        let width =
            |f: fn(&TopicDescription) -> &String| self.topics.iter().map(|t| f(t).len()).max().unwrap_or(0);
        let (names, types) = (width(|t| &t.topic), width(|t| &t.type_name));
        for topic in &self.topics {
            let rate = topic.rate.map_or(String::new(), |r| format!("  {r:.1} Hz"));
            let frame = topic.frame.as_ref().map_or(String::new(), |f| format!("  in {f}"));
            let child = topic.child_frame.as_ref().map_or(String::new(), |f| format!(" of {f}"));
            let _ = writeln!(
                text,
                "  {:names$}  {:types$}  {:>8}{rate}{frame}{child}",
                topic.topic, topic.type_name, topic.count
            );
            if let Some(sensor) = &topic.sensor {
                let _ = writeln!(text, "  {:names$}  {sensor}", "");
            }
        }
        if !self.transforms.is_empty() {
            text.push_str("transforms:\n");
            self.transforms.lines().for_each(|line| {
                let _ = writeln!(text, "  {line}");
            });
        }
        self.write_plan(&mut text);
        for issue in &self.issues {
            let times = if issue.count > 1 { format!(" ({} times)", issue.count) } else { String::new() };
            let label = if issue.lost_data() { "lost" } else { "repaired" };
            let _ = writeln!(text, "{label}: {issue}{times}");
        }
        text
    }

    fn write_plan(&self, text: &mut String) {
        if let Some(obstacle) = &self.obstacle {
            let _ = writeln!(text, "mapping:  not possible: {obstacle}");
        }
        let Some(plan) = &self.plan else { return };
        let dimension = if plan.dimension == Dimension::TwoD { "in 2D" } else { "in 3D" };
        let _ = write!(text, "mapping:  {dimension} with {}", plan.range.join(", "));
        for (label, topic) in [("odometry", &plan.odometry), ("IMU", &plan.imu)] {
            if let Some(topic) = topic {
                let _ = write!(text, ", {label} {topic}");
            }
        }
        let _ = writeln!(text, "; tracking frame {}", plan.tracking_frame);
        for notice in &plan.notices {
            let change =
                if notice.change.is_empty() { String::new() } else { format!(" [{}]", notice.change) };
            let _ = writeln!(text, "  {}{change}", notice.text);
        }
    }
}

fn bytes(size: u64) -> String {
    match size {
        0..10_000 => format!("{size} bytes"),
        10_000..10_000_000 => format!("{:.1} kB", size as f64 / 1e3),
        _ => format!("{:.1} MB", size as f64 / 1e6),
    }
}
