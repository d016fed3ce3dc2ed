//! The simulation in space as a recording.

use std::sync::Arc;

use portolan_geometry::{Duration, Rigid3, Time};
use portolan_recording::{
    Message, MessageReader, RecordedMessage, Recording, RecordingError, TopicInfo, TransformStamped,
};

use crate::Simulation3d;
use crate::sensors::{
    Fault, FaultFilter, FaultTarget, GnssStream, ImuStream, LandmarkStream, MessageStream, OdometryStream,
    Schedule,
};
use crate::simulation3d::Inner3d;
use crate::streams::{
    AheadStream, Merged, MergedReader, ROBOT_FRAME, STATIC_TRANSFORMS, TransformStream, sensor_transform,
};

/// Points that are made ahead of the reader at most, in all.
const POINTS_AHEAD: usize = 1 << 19;

/// A topic that the simulation can make, before anything is made.
struct Channel {
    info: TopicInfo,
    message_bytes: u64,
    source: Source,
}

#[derive(Clone, Copy)]
enum Source {
    Transforms,
    Lidar(usize),
    Imu,
    Odometry,
    Gnss,
    Landmarks,
}

impl Source {
    fn target(self) -> Option<FaultTarget> {
        match self {
            Self::Lidar(_) => Some(FaultTarget::Scan),
            Self::Imu => Some(FaultTarget::Imu),
            Self::Odometry => Some(FaultTarget::Odometry),
            Self::Transforms | Self::Gnss | Self::Landmarks => None,
        }
    }
}

impl Inner3d {
    /// All topics, ascending.
    fn channels(&self) -> Vec<Channel> {
        let o = &self.options;
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
            let count = self.count_outside_gaps(schedule, Source::Lidar(index));
            add(&lidar.topic, "sensor_msgs/PointCloud2", count, lidar.message_bytes(), Source::Lidar(index));
        }
        let count = |rate: f64, source: Source| self.count_outside_gaps(&self.schedule(rate), source);
        if let Some(imu) = &o.imu {
            add(&imu.topic, "sensor_msgs/Imu", count(imu.rate, Source::Imu), 340, Source::Imu);
        }
        if let Some(wheels) = &o.odometry {
            let count = count(wheels.rate, Source::Odometry);
            add(&wheels.topic, "nav_msgs/Odometry", count, 740, Source::Odometry);
        }
        if let Some(gnss) = &o.gnss {
            add(&gnss.topic, "sensor_msgs/NavSatFix", count(gnss.rate, Source::Gnss), 130, Source::Gnss);
        }
        if let Some(marks) = &o.landmarks {
            let count = count(marks.rate, Source::Landmarks);
            add(&marks.topic, "cartographer_ros_msgs/LandmarkList", count, 200, Source::Landmarks);
        }
        channels.sort_by(|a, b| a.info.topic.cmp(&b.info.topic));
        channels
    }

    fn schedule(&self, rate: f64) -> Schedule {
        Schedule::new(rate, self.duration, 0.0)
    }

    /// The faults of a topic, if it can have any.
    fn fault_filter(&self, source: Source) -> Option<FaultFilter> {
        let gravity = self.options.imu.as_ref().map_or(0.0, |imu| imu.gravity);
        let lives = matches!(source, Source::Lidar(index) if index + 1 < self.lidars.len());
        let faults = self.options.faults.iter().filter(|f| !(lives && matches!(f, Fault::Death { .. })));
        let faults: Vec<Fault> = faults.copied().collect();
        source.target().map(|target| FaultFilter::new(&faults, target, gravity))
    }

    fn count_outside_gaps(&self, schedule: &Schedule, source: Source) -> u64 {
        let has_gaps =
            self.options.faults.iter().any(|fault| matches!(fault, Fault::Gap { .. } | Fault::Death { .. }));
        let Some(filter) = self.fault_filter(source).filter(|_| has_gaps) else { return schedule.count() };
        let stays = |index: &u64| !filter.is_gap(schedule.time_of(*index).seconds());
        (0..schedule.count()).filter(stays).count() as u64
    }

    /// The transforms from the carrier to its sensors that are not missing on purpose.
    fn static_transforms(&self) -> Vec<TransformStamped> {
        let o = &self.options;
        let is_missing = |target| o.faults.contains(&Fault::MissingTransform { target });
        let mut transforms = Vec::new();
        let mut add = |frame: &str, base_from_sensor: &Rigid3| {
            transforms.push(sensor_transform(self.clock.start, frame, base_from_sensor));
        };
        if !is_missing(FaultTarget::Scan) {
            for lidar in &o.lidars {
                add(&lidar.frame, &lidar.base_from_lidar);
            }
        }
        if let Some(imu) = o.imu.as_ref().filter(|_| !is_missing(FaultTarget::Imu)) {
            add(&imu.frame, &imu.base_from_imu);
        }
        if let Some(gnss) = &o.gnss {
            add(&gnss.frame, &gnss.base_from_antenna);
        }
        transforms
    }
}

impl Recording for Simulation3d {
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
        let streams = channels.filter_map(|channel| {
            let stream = open(&self.inner, channel.source)?;
            let filter = self.inner.fault_filter(channel.source);
            Some(Merged::start(stream, filter, self.inner.clock, channel.message_bytes))
        });
        Ok(Box::new(MergedReader::new(streams.collect())))
    }
}

fn open(inner: &Arc<Inner3d>, source: Source) -> Option<Box<dyn MessageStream>> {
    let o = &inner.options;
    let (motion, world) = (Arc::clone(&inner.motion), Arc::clone(&inner.world));
    let (clock, seed) = (inner.clock, o.seed);
    let stream: Box<dyn MessageStream> = match source {
        Source::Transforms => Box::new(TransformStream::new(inner.static_transforms(), inner.clock.start)),
        Source::Lidar(index) => sweeps(Arc::clone(inner), index),
        Source::Imu => {
            let imu = o.imu.clone()?;
            let schedule = inner.schedule(imu.rate);
            Box::new(ImuStream::new(imu, motion, clock, schedule, seed))
        }
        Source::Odometry => {
            let wheels = o.odometry.clone()?;
            let schedule = inner.schedule(wheels.rate);
            Box::new(OdometryStream::new(wheels, ROBOT_FRAME, motion, clock, schedule, seed))
        }
        Source::Gnss => {
            let gnss = o.gnss.clone()?;
            let when = (clock, inner.schedule(gnss.rate));
            Box::new(GnssStream::new(gnss, (world, motion), when, seed))
        }
        Source::Landmarks => {
            let marks = o.landmarks.clone()?;
            let when = (clock, inner.schedule(marks.rate));
            Box::new(LandmarkStream::new(marks, (world, motion, Arc::clone(&inner.marks)), when, seed))
        }
    };
    Some(stream)
}

/// Sweeps, some made ahead in parallel.
fn sweeps(inner: Arc<Inner3d>, index: usize) -> Box<dyn MessageStream> {
    let (lidar, schedule) = &inner.lidars[index];
    let (count, sweep_time) = (schedule.count(), Duration::from_seconds(lidar.sweep_time()));
    let share = POINTS_AHEAD / inner.lidars.len().max(1);
    let ahead = (share / lidar.points_per_sweep()).clamp(2, 256) as u64;
    Box::new(AheadStream::new(count, ahead, move |number| {
        let (lidar, schedule) = &inner.lidars[index];
        let cloud = inner.sweep(lidar, schedule, number);
        // A sweep can be recorded when its last beam has come back.
        let log_time = cloud.header.stamp + sweep_time;
        RecordedMessage { topic: Arc::clone(&lidar.topic), log_time, message: Message::PointCloud2(cloud) }
    }))
}
