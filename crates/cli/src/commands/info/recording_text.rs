//! The summary of a recording as text.

use portolan_geometry::Time;
use portolan_recording::Message;

use super::describe::{duration, size, table, utc};
use super::recording::{RecordingReport, TopicReport};

/// What a sensor is like, from one of its messages.
pub fn sensor(message: &Message) -> Option<String> {
    let scanner = |beams: usize, angles: (f32, f32), range_max: f32| {
        format!("{beams} beams over {:.0}°, to {range_max} m", (angles.1 - angles.0).abs().to_degrees())
    };
    match message {
        Message::LaserScan(m) => Some(scanner(m.ranges.len(), (m.angle_min, m.angle_max), m.range_max)),
        Message::MultiEchoLaserScan(m) => {
            let text = scanner(m.ranges.len(), (m.angle_min, m.angle_max), m.range_max);
            Some(format!("{text}, several echoes"))
        }
        Message::PointCloud2(m) => {
            let names: Vec<&str> = m.fields.iter().map(|field| field.name.as_str()).collect();
            Some(format!("{} points of {}", u64::from(m.width) * u64::from(m.height), names.join(" ")))
        }
        Message::Odometry(m) => Some(format!("of {}", m.child_frame_id)),
        _ => None,
    }
}

impl RecordingReport {
    /// For people.
    pub fn text(&self) -> String {
        let mut text = format!("{}: {}, {}\n", self.path, self.format, size(self.size));
        let date = |time: &Option<String>| {
            time.as_deref().and_then(Time::from_unix_decimal).map_or_else(String::new, utc)
        };
        match (&self.start_time, &self.end_time) {
            (Some(start), Some(end)) => text.push_str(&format!(
                "{} messages in {}, {} to {} UTC ({start} to {end})\n",
                self.messages,
                duration(self.duration),
                date(&self.start_time),
                date(&self.end_time)
            )),
            _ => text.push_str("no messages\n"),
        }
        let heading = ["topic", "type", "count", "rate", "frames", "sensor"].map(str::to_owned).to_vec();
        let mut rows = vec![heading];
        rows.extend(self.topics.iter().map(row));
        text.push_str(&table(&rows));
        if !self.transforms.is_empty() {
            text.push_str("transforms\n");
            self.transforms.lines().for_each(|line| text.push_str(&format!("  {line}\n")));
        }
        if !self.repairs.is_empty() {
            text.push_str("while reading\n");
        }
        for repair in &self.repairs {
            let verdict = if repair.lost_data { "lost" } else { "repaired" };
            text.push_str(&format!("  {verdict}, {} times: {}\n", repair.count, repair.what));
        }
        text
    }
}

fn row(topic: &TopicReport) -> Vec<String> {
    let frames = if topic.frames.is_empty() { "-".to_owned() } else { topic.frames.join(" ") };
    vec![
        topic.topic.clone(),
        topic.type_name.clone(),
        topic.count.to_string(),
        topic.rate.map_or_else(|| "-".to_owned(), |rate| format!("{rate:.2} Hz")),
        if frames.trim().is_empty() { "(no name)".to_owned() } else { frames },
        topic.sensor.clone().unwrap_or_default(),
    ]
}
