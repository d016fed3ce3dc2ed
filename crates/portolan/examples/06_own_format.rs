//! A format of one's own mapped: a text with one scan a line, `SECONDS RANGE RANGE …`, a full turn of a planar lidar.
//!
//! `cargo run --release -p portolan --example 06_own_format`

use std::{error::Error, f32::consts::TAU, fmt::Write as _, io::Write as _};

use portolan::geometry::Time;
use portolan::job::{MapRequest, map, unobserved};
use portolan::recording::{
    Header, Issue, LaserScan, Message, MessageReader, RecordedMessage, Recording, RecordingError, TopicInfo,
};
use portolan::simulator::{ScenarioOptions, Simulation};
use portolan::worlds::two_d::Scene;

/// The text. One of many gigabytes would be read line by line.
struct Turns(String);

/// One pass over it.
struct TurnReader(std::vec::IntoIter<RecordedMessage>);

impl Recording for Turns {
    fn format(&self) -> String {
        "turns".to_owned()
    }
    fn topics(&self) -> Vec<TopicInfo> {
        let count = Some(self.0.lines().count() as u64);
        vec![TopicInfo { topic: "/scan".into(), type_name: "sensor_msgs/LaserScan".into(), count }]
    }
    fn time_range(&self) -> Option<(Time, Time)> {
        Some((scan(self.0.lines().next()?)?.log_time, scan(self.0.lines().last()?)?.log_time))
    }
    fn size_bytes(&self) -> u64 {
        self.0.len() as u64
    }
    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let lines = self.0.lines().filter(|_| self.topics().iter().any(wanted));
        Ok(Box::new(TurnReader(lines.filter_map(scan).collect::<Vec<_>>().into_iter())))
    }
}

impl MessageReader for TurnReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        Ok(self.0.next())
    }
    fn position_bytes(&self) -> u64 {
        0 // for progress only
    }
    fn issues(&self) -> Vec<Issue> {
        Vec::new() // lines that are no scans could be counted here
    }
}

/// A line as the message that says the same; without transforms the frame of the lidar is that of the robot.
fn scan(line: &str) -> Option<RecordedMessage> {
    let (seconds, ranges) = line.split_once(' ')?;
    let stamp = Time::from_unix_seconds(seconds.parse().ok()?);
    let ranges = ranges.split(' ').map(str::parse).collect::<Result<Vec<f32>, _>>().ok()?;
    let (angle_increment, time_increment) = (TAU / ranges.len() as f32, 0.1 / ranges.len() as f32);
    let header = Header { stamp, frame_id: "lidar".into() };
    let (angle_min, angle_max) = (-0.5 * TAU, 0.5 * TAU - angle_increment);
    let (scan_time, range_min, range_max, intensities) = (0.1, 0.1, 12.0, Vec::new());
    #[rustfmt::skip]
    let scan = LaserScan { header, angle_min, angle_max, angle_increment, time_increment, scan_time, range_min, range_max, ranges, intensities };
    Some(RecordedMessage { topic: "/scan".into(), log_time: stamp, message: Message::LaserScan(scan) })
}

/// What `cargo run` and the test of the examples call.
pub fn main() -> Result<(), Box<dyn Error>> {
    let options = ScenarioOptions { duration: Some(10.0), ..ScenarioOptions::new(Scene::Office, 1) };
    let (mut text, mut reader) = (String::new(), Simulation::new(options)?.read(&|_| true)?);
    while let Some(message) = reader.next_message()? {
        let Message::LaserScan(scan) = message.message else { continue };
        write!(text, "{:.6}", scan.header.stamp.unix_seconds())?;
        scan.ranges.iter().try_for_each(|range| write!(text, " {range:.3}"))?;
        text.push('\n');
    }
    let folder = tempfile::tempdir()?;
    let finished = map(&Turns(text), MapRequest::new(folder.path()), &mut unobserved)?;
    Ok(writeln!(std::io::stdout(), "{} files", finished.files.len())?)
}
