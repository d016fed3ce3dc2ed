//! Surveys the beginning of a recording: topics, frames, rates, clocks and properties of the sensors.

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::{Duration, Time};
use portolan_issue::Issue;
use portolan_numeric::median;
use portolan_recording::{Message, Recording, RecordingError, TopicInfo};

use crate::options::IngestOptions;
use crate::point_time::PointTime;
use crate::repeats::read_without_repeats;
use crate::statistics::{ImuSampler, ImuStatistics, RangeSampler, RangeStatistics};
use crate::tf::{TfInput, TfTree, frame_name};

/// Duration of the recording after which the survey ends.
const LOOK: Duration = Duration::from_ticks(20 * 10_000_000);
/// Duration after which the survey ends if it has seen enough scans or clouds.
const SHORT_LOOK: Duration = Duration::from_ticks(2 * 10_000_000);
/// Number of scans that is enough.
const ENOUGH_SCANS: u64 = 40;
/// Number of clouds that is enough.
const ENOUGH_CLOUDS: u64 = 15;
/// Maximum number of clouds that are awaited until the skew is determined, as the sensor may stand at first.
const MOST_CLOUDS: u64 = 100;
/// Maximum number of messages of the survey.
const MAX_MESSAGES: u64 = 200_000;
/// Maximum number of messages read for topics that begin later.
const MAX_LATE_MESSAGES: u64 = 2000;
/// Maximum number of intervals and lags kept for each topic.
const MAX_SAMPLES: usize = 2000;

/// What is known about one topic.
#[derive(Clone, Debug)]
pub struct TopicSurvey {
    /// Name, type and number of messages.
    pub info: TopicInfo,
    /// Messages seen in the first look.
    pub seen: u64,
    /// Frame of the first message.
    pub frame: Option<Arc<str>>,
    /// Child frame of the first odometry message.
    pub child_frame: Option<Arc<str>>,
    /// Median interval between stamps, seconds.
    pub interval: Option<f64>,
    /// Median of the time of recording minus stamp; zero if stamps are not set.
    pub lag: Option<Duration>,
    /// Properties of the range sensor.
    pub range: Option<RangeStatistics>,
    /// Meaning of the times of points.
    pub point_time: Option<PointTime>,
    /// Metres in one unit of the coordinates of clouds: 0.001 where they are in millimetres.
    pub length_unit: f32,
    /// Whether clouds have a field of times at all, whatever its values.
    pub has_time_field: bool,
    /// Properties of the IMU.
    pub imu: Option<ImuStatistics>,
}

/// Survey of a recording, made before it is read as a whole.
#[derive(Clone, Debug)]
pub struct Inventory {
    /// All topics in ascending order.
    pub topics: Vec<TopicSurvey>,
    /// Static transforms of the whole recording and of the robot description, moving ones of the first
    /// look.
    pub tree: TfTree,
    /// Faults of static transforms and of the robot description.
    pub issues: Vec<Issue>,
    /// Faults of the moving transforms of the first look.
    pub moving_issues: Vec<Issue>,
    /// First time of recording.
    pub first_time: Option<Time>,
}

#[derive(Default)]
struct TopicLook {
    seen: u64,
    frame: Option<Arc<str>>,
    child_frame: Option<Arc<str>>,
    last_stamp: Option<Time>,
    intervals: Vec<f64>,
    lags: Vec<f64>,
    unset: u64,
    range: Option<RangeSampler>,
    imu: Option<ImuSampler>,
}

/// Whether messages of the type are used.
pub(crate) fn is_understood(type_name: &str) -> bool {
    is_range(type_name)
        || is_tf(type_name)
        || matches!(
            type_name,
            "sensor_msgs/Imu"
                | "nav_msgs/Odometry"
                | "sensor_msgs/NavSatFix"
                | "geometry_msgs/PoseStamped"
                | "cartographer_ros_msgs/LandmarkList"
        )
}

/// Whether messages of the type hold distances.
pub(crate) fn is_range(type_name: &str) -> bool {
    matches!(
        type_name,
        "sensor_msgs/LaserScan" | "sensor_msgs/MultiEchoLaserScan" | "sensor_msgs/PointCloud2"
    )
}

/// Whether messages of the type are transforms.
pub fn is_tf(type_name: &str) -> bool {
    matches!(type_name, "tf2_msgs/TFMessage" | "tf/tfMessage")
}

impl Inventory {
    /// Surveys at most the first 20 s, and all static transforms.
    ///
    /// # Errors
    /// If the recording cannot be read.
    pub fn of(recording: &dyn Recording, options: &IngestOptions) -> Result<Self, RecordingError> {
        let mut tree = TfTree::new();
        let mut tf = TfInput::new(&options.map_frame);
        if let Some(description) = &options.description {
            description.insert_into(&mut tree).into_iter().for_each(|issue| tf.add(issue));
        }
        if options.use_recorded_transforms {
            read_static_transforms(recording, &mut tree, &mut tf)?;
        }
        let mut moving_tf = TfInput::new(&options.map_frame);
        let mut survey = Look::new(recording);
        let use_tf = options.use_recorded_transforms;
        let wanted = |t: &TopicInfo| is_understood(&t.type_name) && (use_tf || !is_tf(&t.type_name));
        let mut reader = read_without_repeats(recording, &wanted)?;
        while let Some(message) = reader.next_message()? {
            if let Message::Tf(transforms) = &message.message
                && !transforms.is_static
            {
                moving_tf.insert(&mut tree, transforms);
            }
            if survey.add(&message.topic, message.log_time, &message.message) {
                break;
            }
        }
        survey.find_late_topics(recording)?;
        let mut inventory = survey.finish(tree, &tf);
        inventory.moving_issues = moving_tf.issues().list();
        Ok(inventory)
    }

    /// The survey of one topic; a leading slash makes no difference.
    pub fn topic(&self, name: &str) -> Option<&TopicSurvey> {
        let plain = |name: &str| name.trim_start_matches('/').to_owned();
        self.topics.iter().find(|t| *t.info.topic == *name).or_else(|| {
            let name = plain(name);
            self.topics.iter().find(|t| plain(&t.info.topic) == name)
        })
    }
}

fn read_static_transforms(
    recording: &dyn Recording,
    tree: &mut TfTree,
    tf: &mut TfInput,
) -> Result<(), RecordingError> {
    let is_static = |t: &TopicInfo| is_tf(&t.type_name) && t.topic.ends_with("tf_static");
    if !recording.topics().iter().any(is_static) {
        return Ok(());
    }
    let mut reader = recording.read(&is_static)?;
    while let Some(message) = reader.next_message()? {
        if let Message::Tf(transforms) = &message.message {
            tf.insert(tree, transforms);
        }
    }
    Ok(())
}

/// Survey in progress.
struct Look {
    topics: Vec<TopicInfo>,
    looks: BTreeMap<Arc<str>, TopicLook>,
    first_time: Option<Time>,
    messages: u64,
}

impl Look {
    fn new(recording: &dyn Recording) -> Self {
        let topics = recording.topics();
        let looks = topics.iter().map(|t| (t.topic.clone(), TopicLook::default())).collect();
        Self { topics, looks, first_time: None, messages: 0 }
    }

    /// Adds a message; returns whether the survey has seen enough.
    fn add(&mut self, topic: &Arc<str>, log_time: Time, message: &Message) -> bool {
        let first = *self.first_time.get_or_insert(log_time);
        let elapsed = log_time - first;
        self.messages += 1;
        let look = self.looks.entry(topic.clone()).or_default();
        look.seen += 1;
        look.add(log_time, message);
        self.messages.is_multiple_of(16) && self.is_enough(elapsed)
    }

    fn is_enough(&self, elapsed: Duration) -> bool {
        if elapsed > LOOK || self.messages > MAX_MESSAGES {
            return true;
        }
        let enough = |t: &TopicInfo| {
            let wanted =
                if &*t.type_name == "sensor_msgs/PointCloud2" { ENOUGH_CLOUDS } else { ENOUGH_SCANS };
            let look = self.looks.get(&t.topic);
            let seen = look.map_or(0, |l| l.seen);
            let undecided = look.and_then(|l| l.range.as_ref()).is_some_and(RangeSampler::is_undecided);
            let wanted = if undecided { MOST_CLOUDS } else { wanted };
            !is_range(&t.type_name) || seen >= wanted.min(t.count.unwrap_or(u64::MAX))
        };
        elapsed > SHORT_LOOK && self.topics.iter().all(enough)
    }

    /// Looks for the first messages of topics that have not appeared yet, and reads only those topics.
    fn find_late_topics(&mut self, recording: &dyn Recording) -> Result<(), RecordingError> {
        let is_late = |t: &TopicInfo, looks: &BTreeMap<Arc<str>, TopicLook>| {
            is_understood(&t.type_name)
                && !is_tf(&t.type_name)
                && t.count != Some(0)
                && looks.get(&t.topic).is_none_or(|l| l.seen == 0)
        };
        if !self.topics.iter().any(|t| is_late(t, &self.looks)) {
            return Ok(());
        }
        let mut reader = read_without_repeats(recording, &|t| is_late(t, &self.looks))?;
        for _ in 0..MAX_LATE_MESSAGES {
            let Some(message) = reader.next_message()? else { break };
            self.add(&message.topic, message.log_time, &message.message);
            if self.messages.is_multiple_of(16) && !self.topics.iter().any(|t| is_late(t, &self.looks)) {
                break;
            }
        }
        Ok(())
    }

    fn finish(mut self, tree: TfTree, tf: &TfInput) -> Inventory {
        let topics = self.topics.into_iter().map(|info| {
            let look = self.looks.remove(&info.topic).unwrap_or_default();
            look.finish(info)
        });
        Inventory {
            topics: topics.collect(),
            tree,
            issues: tf.issues().list(),
            moving_issues: Vec::new(),
            first_time: self.first_time,
        }
    }
}

impl TopicLook {
    fn add(&mut self, log_time: Time, message: &Message) {
        match message {
            Message::LaserScan(_) | Message::MultiEchoLaserScan(_) | Message::PointCloud2(_) => {
                self.add_range(message);
            }
            Message::Imu(imu) => self.imu.get_or_insert_default().add(imu),
            Message::Odometry(odometry) => {
                self.child_frame.get_or_insert_with(|| frame_name(&odometry.child_frame_id).into());
            }
            _ => {}
        }
        let Some(header) = message.header() else { return };
        self.frame.get_or_insert_with(|| frame_name(&header.frame_id).into());
        if header.stamp == Time::UNIX_EPOCH {
            self.unset += 1;
        } else if self.lags.len() < MAX_SAMPLES {
            self.lags.push((log_time - header.stamp).seconds());
        }
        if let Some(last) = self.last_stamp.replace(header.stamp)
            && header.stamp > last
            && self.intervals.len() < MAX_SAMPLES
        {
            self.intervals.push(header.stamp.seconds_since(last));
        }
    }

    fn add_range(&mut self, message: &Message) {
        let sampler = self.range.get_or_insert_default();
        if sampler.is_full() {
            return;
        }
        match message {
            Message::LaserScan(scan) => sampler.add_scan(scan),
            Message::MultiEchoLaserScan(scan) => sampler.add_echoes(scan),
            Message::PointCloud2(cloud) => sampler.add_cloud(cloud),
            _ => {}
        }
    }

    fn finish(mut self, info: TopicInfo) -> TopicSurvey {
        let interval = median(&mut self.intervals);
        let unset = self.unset > self.lags.len() as u64;
        let lag = if unset { Some(0.0) } else { median(&mut self.lags) };
        TopicSurvey {
            info,
            seen: self.seen,
            frame: self.frame,
            child_frame: self.child_frame,
            interval,
            lag: lag.map(Duration::from_seconds),
            point_time: self.range.as_ref().and_then(|r| r.point_time(interval)),
            length_unit: self.range.as_ref().map_or(1.0, RangeSampler::length_unit),
            has_time_field: self.range.as_ref().is_some_and(RangeSampler::has_time_field),
            range: self.range.map(|r| r.finish(interval)),
            imu: self.imu.map(|i| i.finish(interval)),
        }
    }
}
