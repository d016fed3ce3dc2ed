//! What is wrong with a recording, from one pass over all of it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use portolan_geometry::Time;
use portolan_recording::{Message, RecordedMessage, Repair, TfInput, TfMessage, TfTree, frame_name, open};

use super::finding::{Finding, Findings, Kind, Severity};
use super::stream::Stream;
use super::values;
use crate::error::CliError;
use crate::progress::Progress;

const DISCONNECTED: Kind = Kind {
    name: "disconnected",
    severity: Severity::Error,
    effect: "measurements in this frame cannot be brought together with the others and are not used",
    advice: "record /tf_static, give a robot description with --urdf, or leave the sensor out",
};
const MAP_OUTPUT: Kind = Kind {
    name: "map output",
    severity: Severity::Warning,
    effect: "that is the output of a mapping program; these transforms are not used",
    advice: "nothing; record without them to keep the recording small",
};
const SEVERAL_TOPICS: Kind = Kind {
    name: "several topics",
    severity: Severity::Warning,
    effect: "the same sensor may be used twice",
    advice: "name the topic to use, for example with --scan",
};
const NO_RANGES: Kind = Kind {
    name: "no ranges",
    severity: Severity::Error,
    effect: "there is nothing to make a map of",
    advice: "record a topic of type sensor_msgs/LaserScan, MultiEchoLaserScan or PointCloud2",
};
const COMMON_OFFSET: Kind = Kind {
    name: "common offset",
    severity: Severity::Warning,
    effect: "none, because all sensors are alike; poses get the times of the stamps",
    advice: "nothing, unless the poses are to be compared with something on another clock",
};
const DIFFERENT_CLOCKS: Kind = Kind {
    name: "different clocks",
    severity: Severity::Warning,
    effect: "measurements of these sensors are brought together at different moments",
    advice: "synchronise the clocks of the sensors",
};
const VERY_DIFFERENT_CLOCKS: Kind =
    Kind { name: "very different clocks", severity: Severity::Error, ..DIFFERENT_CLOCKS };
/// Parent frame whose children are results of mapping.
const MAP_FRAME: &str = "map";

/// Reads a whole recording and tells all findings.
pub fn check(path: &Path, quiet: bool) -> Result<Vec<Finding>, CliError> {
    let recording = open(path)?;
    let mut check = Check::default();
    let mut progress = Progress::start("check", recording.size_bytes(), quiet);
    let mut reader = recording.read(&|_| true)?;
    while let Some(message) = reader.next_message()? {
        check.add(&message);
        if progress.is_due() {
            let seconds = check.first_time.map_or(0.0, |first| message.log_time.seconds_since(first));
            progress.update(
                reader.position_bytes(),
                recording.size_bytes(),
                format!("{seconds:.0} s checked"),
            );
        }
    }
    progress.finish();
    Ok(check.finish(&reader.repairs()))
}

/// What has been seen of a recording so far.
struct Check {
    findings: Findings,
    streams: BTreeMap<Arc<str>, Stream>,
    /// Topics on which each frame was seen.
    topics_of_frame: BTreeMap<Arc<str>, BTreeSet<Arc<str>>>,
    /// Frames of odometry's poses and of sensors.
    frames: BTreeSet<String>,
    tree: TfTree,
    tf: TfInput,
    first_time: Option<Time>,
    messages: u64,
}

impl Default for Check {
    fn default() -> Self {
        Self {
            findings: Findings::default(),
            streams: BTreeMap::new(),
            topics_of_frame: BTreeMap::new(),
            frames: BTreeSet::new(),
            tree: TfTree::new(),
            tf: TfInput::new(MAP_FRAME),
            first_time: None,
            messages: 0,
        }
    }
}

impl Check {
    fn add(&mut self, recorded: &RecordedMessage) {
        self.messages += 1;
        self.first_time.get_or_insert(recorded.log_time);
        match &recorded.message {
            Message::Tf(message) => self.add_transforms(message, recorded.log_time),
            message @ (Message::LaserScan(_)
            | Message::MultiEchoLaserScan(_)
            | Message::PointCloud2(_)
            | Message::Imu(_)
            | Message::Odometry(_)) => self.add_measurement(recorded, message),
            _ => {}
        }
    }

    fn add_transforms(&mut self, message: &TfMessage, log_time: Time) {
        for transform in &message.transforms {
            if frame_name(&transform.header.frame_id) == MAP_FRAME {
                let child = frame_name(&transform.child_frame_id);
                let what = || format!("there are transforms from \"{MAP_FRAME}\" to \"{child}\"");
                self.findings.add(&MAP_OUTPUT, child, what);
            }
        }
        self.tf.insert(&mut self.tree, message);
        if self.messages.is_multiple_of(4096) {
            // Only connections are of interest; memory stays bounded.
            self.tree.forget_before(log_time);
        }
    }

    fn add_measurement(&mut self, recorded: &RecordedMessage, message: &Message) {
        let Some(header) = message.header() else { return };
        let frame = match message {
            Message::Odometry(odometry) => &odometry.child_frame_id,
            _ => &header.frame_id,
        };
        if !self.topics_of_frame.get(frame).is_some_and(|topics| topics.contains(&recorded.topic)) {
            self.frames.insert(frame_name(frame).to_owned());
            if !matches!(message, Message::Odometry(_)) {
                self.topics_of_frame
                    .entry(Arc::clone(frame))
                    .or_default()
                    .insert(Arc::clone(&recorded.topic));
            }
        }
        let stream = self.streams.entry(Arc::clone(&recorded.topic)).or_default();
        stream.add(recorded, header, message, &mut self.findings);
        values::check(&recorded.topic, message, &mut self.findings);
    }

    fn finish(mut self, repairs: &[Repair]) -> Vec<Finding> {
        self.check_frames();
        self.check_clocks();
        if !self.streams.values().any(Stream::is_range) {
            self.findings.add(&NO_RANGES, "", || "there is no laser scan and no point cloud".to_owned());
        }
        let mut findings = self.findings;
        for (topic, stream) in &self.streams {
            stream.finish(topic, &mut findings);
        }
        repairs.iter().for_each(|repair| findings.push(repaired(repair)));
        findings.finish()
    }

    /// All sensors should be stamped by clocks that agree, whatever the recorder's clock is.
    fn check_clocks(&mut self) {
        let mut lags: Vec<(f64, &Arc<str>)> =
            self.streams.iter().filter_map(|(topic, stream)| Some((stream.mean_lag()?, topic))).collect();
        lags.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (Some((least, early)), Some((most, late))) = (lags.first(), lags.last()) else { return };
        let kind = match most - least {
            difference if difference > 0.5 => &VERY_DIFFERENT_CLOCKS,
            difference if difference > 0.1 => &DIFFERENT_CLOCKS,
            _ if least.abs() > 0.5 => {
                let what = || format!("stamps are {least:.3} s before the times of recording");
                return self.findings.add(&COMMON_OFFSET, "", what);
            }
            _ => return,
        };
        let what = || {
            format!("{late} is stamped {most:.3} s before it was recorded, but {early} {least:.3} s before")
        };
        self.findings.add(kind, "", what);
    }

    /// Every frame must be connected with the first sensor frame, and come on one topic.
    fn check_frames(&mut self) {
        for (frame, topics) in self.topics_of_frame.iter().filter(|(_, topics)| topics.len() > 1) {
            let names: Vec<&str> = topics.iter().map(|topic| &**topic).collect();
            let what = || format!("frame \"{frame}\" is sent on several topics: {}", names.join(", "));
            self.findings.add(&SEVERAL_TOPICS, frame, what);
        }
        // The frame with the most company is the one that the others are to be connected with.
        let company = |frame: &String| self.frames.iter().filter(|f| self.tree.connected(frame, f)).count();
        let Some(main) = self.frames.iter().max_by_key(|f| (company(f), std::cmp::Reverse(*f))).cloned()
        else {
            return;
        };
        for frame in self.frames.iter().filter(|frame| !self.tree.connected(&main, frame)) {
            let what = || format!("no transform connects \"{frame}\" with \"{main}\"");
            self.findings.add(&DISCONNECTED, frame, what);
        }
    }
}

fn repaired(repair: &Repair) -> Finding {
    let (severity, effect, advice) = match repair.lost_data {
        true => (
            Severity::Error,
            "what could not be read is missing in the map",
            "take an undamaged copy of the file if there is one; the rest can be mapped",
        ),
        false => {
            (Severity::Warning, "nothing is lost; it is repaired in the same way while mapping", "nothing")
        }
    };
    Finding { severity, what: repair.what.clone(), count: repair.count, effect, advice }
}
