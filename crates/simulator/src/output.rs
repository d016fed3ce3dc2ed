//! The simulation as a recording: messages made while they are read, in order, in bounded memory.

use std::sync::Arc;

use portolan_geometry::{Duration, Rigid3, Time};
use portolan_recording::{
    Message, MessageReader, RecordedMessage, Recording, RecordingError, RecordingWriter, TopicInfo,
    TransformStamped,
};

use crate::Simulation;
use crate::sensors::{Fault, FaultFilter, FaultTarget, ImuStream, MessageStream, OdometryStream, Schedule};
use crate::simulation::Inner;
use crate::streams::{
    AheadStream, Merged, MergedReader, ROBOT_FRAME, STATIC_TRANSFORMS, TransformStream, sensor_transform,
};

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
            let count = self.count_outside_gaps(schedule, FaultTarget::Scan, index);
            let values = if lidar.options.intensities { 2 } else { 1 };
            let bytes = 80 + 4 * (lidar.options.beams * values) as u64;
            add(&lidar.topic, "sensor_msgs/LaserScan", count, bytes, Source::Lidar(index));
        }
        if let Some(odometry) = &self.options.odometry {
            let count = self.count_outside_gaps(&self.schedule(odometry.rate), FaultTarget::Odometry, 0);
            add(&odometry.topic, "nav_msgs/Odometry", count, 740, Source::Odometry);
        }
        if let Some(imu) = &self.options.imu {
            let count = self.count_outside_gaps(&self.schedule(imu.rate), FaultTarget::Imu, 0);
            add(&imu.topic, "sensor_msgs/Imu", count, 340, Source::Imu);
        }
        channels.sort_by(|a, b| a.info.topic.cmp(&b.info.topic));
        channels
    }

    fn schedule(&self, rate: f64) -> Schedule {
        Schedule::new(rate, self.duration, 0.0)
    }

    fn fault_filter(&self, target: FaultTarget, lidar: usize) -> FaultFilter {
        let gravity = self.options.imu.as_ref().map_or(0.0, |imu| imu.gravity);
        // Only the last lidar dies.
        let lives = target == FaultTarget::Scan && lidar + 1 < self.lidars.len();
        let faults = self.options.faults.iter().filter(|f| !(lives && matches!(f, Fault::Death { .. })));
        FaultFilter::new(&faults.copied().collect::<Vec<_>>(), target, gravity)
    }

    fn count_outside_gaps(&self, schedule: &Schedule, target: FaultTarget, lidar: usize) -> u64 {
        if !self.options.faults.iter().any(|fault| matches!(fault, Fault::Gap { .. } | Fault::Death { .. })) {
            return schedule.count();
        }
        let filter = self.fault_filter(target, lidar);
        (0..schedule.count()).filter(|index| !filter.is_gap(schedule.time_of(*index).seconds())).count()
            as u64
    }

    /// The transforms from the robot to its sensors that are not missing on purpose.
    fn static_transforms(&self) -> Vec<TransformStamped> {
        let is_missing = |target| self.options.faults.contains(&Fault::MissingTransform { target });
        let mut transforms = Vec::new();
        let mut add = |frame: &str, base_from_sensor: &Rigid3| {
            transforms.push(sensor_transform(self.clock.start, frame, base_from_sensor));
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
        let streams = channels.map(|channel| {
            let (stream, target) = open(&self.inner, channel.source);
            let lidar = if let Source::Lidar(index) = channel.source { index } else { 0 };
            let filter = target.map(|target| self.inner.fault_filter(target, lidar));
            Merged::start(stream, filter, self.inner.clock, channel.message_bytes)
        });
        Ok(Box::new(MergedReader::new(streams.collect())))
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

fn open(inner: &Arc<Inner>, source: Source) -> (Box<dyn MessageStream>, Option<FaultTarget>) {
    let (walk, clock, seed) = (Arc::clone(&inner.walk), inner.clock, inner.options.seed);
    match source {
        Source::Transforms => {
            (Box::new(TransformStream::new(inner.static_transforms(), inner.clock.start)), None)
        }
        Source::Lidar(lidar) => (lidar_stream(Arc::clone(inner), lidar), Some(FaultTarget::Scan)),
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

/// Scans, some made ahead in parallel.
fn lidar_stream(inner: Arc<Inner>, index: usize) -> Box<dyn MessageStream> {
    let (lidar, schedule) = &inner.lidars[index];
    let (count, sweep) = (schedule.count(), Duration::from_seconds(lidar.sweep_time()));
    let ahead = (BEAMS_AHEAD / lidar.options.beams).clamp(1, 256) as u64;
    Box::new(AheadStream::new(count, ahead, move |number| {
        let (lidar, schedule) = &inner.lidars[index];
        let scan = inner.scan(lidar, schedule, number);
        // A scan can be recorded when its last beam has come back.
        let log_time = scan.header.stamp + sweep;
        RecordedMessage { topic: Arc::clone(&lidar.topic), log_time, message: Message::LaserScan(scan) }
    }))
}
