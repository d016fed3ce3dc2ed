//! The simulation as a recording: messages made while they are read, in order, in bounded memory.

use std::collections::VecDeque;
use std::sync::Arc;

use portolan_geometry::{Duration, Rigid3, Time};
use portolan_recording::{
    Header, Message, MessageReader, Pose, RecordedMessage, Recording, RecordingError, RecordingWriter,
    Repair, TfMessage, TopicInfo, TransformStamped,
};
use rayon::prelude::*;

use crate::Simulation;
use crate::sensors::{
    Clock, Fault, FaultFilter, FaultTarget, ImuStream, MessageStream, OdometryStream, Schedule,
};
use crate::simulation::Inner;

/// Topic of the transforms between the robot and its sensors.
const STATIC_TRANSFORMS: &str = "/tf_static";
const ROBOT_FRAME: &str = "base_link";
/// Beams that are made ahead of the reader at most, in all.
const BEAMS_AHEAD: usize = 1 << 15;

/// A topic that the simulation can make, before anything is made.
struct Channel {
    info: TopicInfo,
    /// Bytes per message when written in a ROS bag, about.
    message_bytes: u64,
    source: Source,
}

#[derive(Clone, Copy)]
enum Source {
    Transforms,
    Imu,
    Odometry,
    Lidar(usize),
}

impl Inner {
    /// All topics, ascending.
    fn channels(&self) -> Vec<Channel> {
        let mut channels = Vec::new();
        let mut add = |topic: &str, type_name: &str, count: u64, message_bytes: u64, source: Source| {
            let info = TopicInfo { topic: topic.into(), type_name: type_name.into(), count: Some(count) };
            channels.push(Channel { info, message_bytes, source });
        };
        let transforms = self.static_transforms().len() as u64;
        if transforms > 0 {
            add(STATIC_TRANSFORMS, "tf2_msgs/TFMessage", 1, 100 * transforms, Source::Transforms);
        }
        for (index, (lidar, schedule)) in self.lidars.iter().enumerate() {
            let count = self.count_outside_gaps(schedule, FaultTarget::Scan);
            let values = if lidar.options.intensities { 2 } else { 1 };
            let bytes = 80 + 4 * (lidar.options.beams * values) as u64;
            add(&lidar.topic, "sensor_msgs/LaserScan", count, bytes, Source::Lidar(index));
        }
        if let Some(odometry) = &self.options.odometry {
            let count = self.count_outside_gaps(&self.schedule(odometry.rate), FaultTarget::Odometry);
            add(&odometry.topic, "nav_msgs/Odometry", count, 740, Source::Odometry);
        }
        if let Some(imu) = &self.options.imu {
            let count = self.count_outside_gaps(&self.schedule(imu.rate), FaultTarget::Imu);
            add(&imu.topic, "sensor_msgs/Imu", count, 340, Source::Imu);
        }
        channels.sort_by(|a, b| a.info.topic.cmp(&b.info.topic));
        channels
    }

    fn schedule(&self, rate: f64) -> Schedule {
        Schedule::new(rate, self.duration, 0.0)
    }

    fn fault_filter(&self, target: FaultTarget) -> FaultFilter {
        let gravity = self.options.imu.as_ref().map_or(0.0, |imu| imu.gravity);
        FaultFilter::new(&self.options.faults, target, gravity)
    }

    fn count_outside_gaps(&self, schedule: &Schedule, target: FaultTarget) -> u64 {
        if !self.options.faults.iter().any(|fault| matches!(fault, Fault::Gap { .. })) {
            return schedule.count();
        }
        let filter = self.fault_filter(target);
        (0..schedule.count()).filter(|index| !filter.is_gap(schedule.time_of(*index).seconds())).count()
            as u64
    }

    /// The transforms from the robot to its sensors that are not missing on purpose.
    fn static_transforms(&self) -> Vec<TransformStamped> {
        let is_missing = |target| self.options.faults.contains(&Fault::MissingTransform { target });
        let mut transforms = Vec::new();
        let mut add = |frame: &str, base_from_sensor: &Rigid3| {
            transforms.push(TransformStamped {
                header: Header { stamp: self.clock.start, frame_id: ROBOT_FRAME.into() },
                child_frame_id: frame.into(),
                transform: pose_message(base_from_sensor),
            });
        };
        if !is_missing(FaultTarget::Scan) {
            for (lidar, _) in &self.lidars {
                add(&lidar.options.frame, &lidar.options.base_from_lidar());
            }
        }
        if let Some(imu) = self.options.imu.as_ref().filter(|_| !is_missing(FaultTarget::Imu)) {
            add(&imu.frame, &imu.base_from_imu);
        }
        transforms
    }
}

fn pose_message(pose: &Rigid3) -> Pose {
    let q = pose.rotation.quaternion();
    Pose { position: pose.translation.vector.into(), orientation_xyzw: [q.i, q.j, q.k, q.w] }
}

impl Recording for Simulation {
    fn format(&self) -> String {
        let options = self.options();
        format!("simulation of scene \"{}\" with seed {}", options.scene, options.seed)
    }

    fn topics(&self) -> Vec<TopicInfo> {
        self.inner.channels().into_iter().map(|channel| channel.info).collect()
    }

    fn time_range(&self) -> Option<(Time, Time)> {
        Some((self.start_time(), self.end_time()))
    }

    fn size_bytes(&self) -> u64 {
        let channels = self.inner.channels();
        channels.iter().map(|c| c.info.count.unwrap_or(0) * c.message_bytes).sum()
    }

    fn read(&self, wanted: &dyn Fn(&TopicInfo) -> bool) -> Result<Box<dyn MessageReader>, RecordingError> {
        let channels = self.inner.channels().into_iter().filter(|channel| wanted(&channel.info));
        let merged = channels.map(|channel| Merged::start(&self.inner, &channel)).collect();
        Ok(Box::new(SimulationReader { merged, position_bytes: 0 }))
    }
}

impl Simulation {
    /// Writes all messages to a bag or MCAP file; how many. The caller finishes the file.
    pub fn write_messages(&self, writer: &mut dyn RecordingWriter) -> Result<u64, RecordingError> {
        let mut reader = self.read(&|_| true)?;
        let mut count = 0;
        while let Some(message) = reader.next_message()? {
            writer.write(&message)?;
            count += 1;
        }
        Ok(count)
    }
}

/// One pass over the messages of a simulation.
struct SimulationReader {
    /// In ascending order of topic; ties in time go to the first.
    merged: Vec<Merged>,
    position_bytes: u64,
}

/// One topic with its next message.
struct Merged {
    stream: Box<dyn MessageStream>,
    filter: Option<FaultFilter>,
    clock: Clock,
    message_bytes: u64,
    next: Option<RecordedMessage>,
}

impl Merged {
    fn start(inner: &Arc<Inner>, channel: &Channel) -> Self {
        let (stream, target) = open(inner, channel.source);
        let filter = target.map(|target| inner.fault_filter(target));
        let message_bytes = channel.message_bytes;
        let mut merged = Self { stream, filter, clock: inner.clock, message_bytes, next: None };
        merged.advance();
        merged
    }

    /// Replaces the next message by the one after it and gives it back.
    fn advance(&mut self) -> Option<RecordedMessage> {
        let after = loop {
            let Some(message) = self.stream.next_message() else { break None };
            let Some(filter) = &mut self.filter else { break Some(message) };
            // True time of the measurement: the stamp, before any faults.
            let seconds = message.message.header().map_or(0.0, |header| self.clock.seconds(header.stamp));
            if let Some(spoiled) = filter.apply(message, seconds) {
                break Some(spoiled);
            }
        };
        std::mem::replace(&mut self.next, after)
    }
}

fn open(inner: &Arc<Inner>, source: Source) -> (Box<dyn MessageStream>, Option<FaultTarget>) {
    let (walk, clock, seed) = (Arc::clone(&inner.walk), inner.clock, inner.options.seed);
    match source {
        Source::Transforms => (Box::new(TransformStream::new(inner)), None),
        Source::Lidar(lidar) => {
            (Box::new(LidarStream::new(Arc::clone(inner), lidar)), Some(FaultTarget::Scan))
        }
        Source::Odometry => {
            let options = inner.options.odometry.clone().unwrap_or_default();
            let schedule = inner.schedule(options.rate);
            let stream = OdometryStream::new(options, ROBOT_FRAME, walk, clock, schedule, seed);
            (Box::new(stream), Some(FaultTarget::Odometry))
        }
        Source::Imu => {
            let options = inner.options.imu.clone().unwrap_or_default();
            let schedule = inner.schedule(options.rate);
            (Box::new(ImuStream::new(options, walk, clock, schedule, seed)), Some(FaultTarget::Imu))
        }
    }
}

impl MessageReader for SimulationReader {
    fn next_message(&mut self) -> Result<Option<RecordedMessage>, RecordingError> {
        let with_next = self.merged.iter_mut().filter(|merged| merged.next.is_some());
        let earliest = with_next.min_by_key(|merged| merged.next.as_ref().map(|next| next.log_time));
        let Some(earliest) = earliest else { return Ok(None) };
        self.position_bytes += earliest.message_bytes;
        Ok(earliest.advance())
    }

    fn position_bytes(&self) -> u64 {
        self.position_bytes
    }

    fn repairs(&self) -> Vec<Repair> {
        Vec::new()
    }
}

/// The static transforms as one message at the start.
struct TransformStream {
    message: Option<RecordedMessage>,
}

impl TransformStream {
    fn new(inner: &Inner) -> Self {
        let transforms = TfMessage { is_static: true, transforms: inner.static_transforms() };
        let message = RecordedMessage {
            topic: STATIC_TRANSFORMS.into(),
            log_time: inner.clock.start,
            message: Message::Tf(transforms),
        };
        Self { message: Some(message) }
    }
}

impl MessageStream for TransformStream {
    fn next_message(&mut self) -> Option<RecordedMessage> {
        self.message.take()
    }
}

/// Scans, some made ahead in parallel. Each has random numbers of its own, so it does not matter by
/// which thread it is made.
struct LidarStream {
    inner: Arc<Inner>,
    lidar: usize,
    next: u64,
    ready: VecDeque<RecordedMessage>,
}

impl LidarStream {
    fn new(inner: Arc<Inner>, lidar: usize) -> Self {
        Self { inner, lidar, next: 0, ready: VecDeque::new() }
    }

    fn make_ahead(&mut self) {
        let (lidar, schedule) = &self.inner.lidars[self.lidar];
        let ahead = (BEAMS_AHEAD / lidar.options.beams).clamp(1, 256) as u64;
        let end = schedule.count().min(self.next + ahead);
        let sweep = Duration::from_seconds(lidar.sweep_time());
        let make = |index: u64| {
            let scan = self.inner.scan(lidar, schedule, index);
            // A scan can be recorded when its last beam has come back.
            let log_time = scan.header.stamp + sweep;
            RecordedMessage { topic: Arc::clone(&lidar.topic), log_time, message: Message::LaserScan(scan) }
        };
        let made: Vec<RecordedMessage> = (self.next..end).into_par_iter().map(make).collect();
        self.ready.extend(made);
        self.next = end;
    }
}

impl MessageStream for LidarStream {
    fn next_message(&mut self) -> Option<RecordedMessage> {
        if self.ready.is_empty() {
            self.make_ahead();
        }
        self.ready.pop_front()
    }
}
