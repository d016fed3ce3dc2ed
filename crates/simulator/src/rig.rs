//! Common part of the simulations in 2D and 3D: a motion, sensors and faults, made into a recording.

use std::sync::Arc;

use portolan_geometry::{Duration, Rigid3, Time};
use portolan_recording::{Message, MessageReader, RecordedMessage, TopicInfo, TransformStamped};

use crate::motion::{Motion, Rolling};
use crate::sensors::{
    Clock, Fault, FaultFilter, FaultTarget, ImuOptions, ImuStream, MessageStream, OdometryOptions,
    OdometryStream, Schedule,
};
use crate::streams::{
    AheadStream, Merged, MergedReader, ROBOT_FRAME, STATIC_TRANSFORMS, TransformStream, sensor_transform,
};

/// A topic that a simulation can make, before any message is made.
pub(crate) struct Channel {
    pub info: TopicInfo,
    /// Approximate size of a message in a ROS bag, bytes.
    pub message_bytes: u64,
    source: Source,
}

/// Source of the messages of a topic.
#[derive(Clone, Copy)]
pub(crate) enum Source {
    Transforms,
    Lidar(usize),
    Imu,
    Odometry,
    Gnss,
    Landmarks,
}

impl Source {
    /// The sensor whose faults can be put into its messages; none if it has no faults.
    fn target(self) -> Option<FaultTarget> {
        match self {
            Self::Lidar(_) => Some(FaultTarget::Scan),
            Self::Imu => Some(FaultTarget::Imu),
            Self::Odometry => Some(FaultTarget::Odometry),
            Self::Transforms | Self::Gnss | Self::Landmarks => None,
        }
    }
}

/// Options that both kinds of simulations have.
pub(crate) struct Request<'a> {
    pub seed: u64,
    pub faults: &'a [Fault],
    pub imu: Option<&'a ImuOptions>,
    pub odometry: Option<&'a OdometryOptions>,
}

/// A motion with its clock.
#[derive(Debug)]
pub(crate) struct Timeline<M> {
    pub motion: Arc<M>,
    pub clock: Clock,
    /// Length of the recording, seconds.
    pub duration: f64,
}

impl<M> Timeline<M> {
    pub fn new(motion: M, start: Time, duration: f64) -> Self {
        Self { motion: Arc::new(motion), clock: Clock { start }, duration }
    }
}

/// One lidar.
pub(crate) struct RigLidar<'a> {
    pub topic: &'a Arc<str>,
    pub type_name: &'static str,
    pub frame: &'a str,
    pub base_from_lidar: Rigid3,
    pub schedule: &'a Schedule,
    pub message_bytes: u64,
    /// Duration of a scan or sweep, seconds.
    pub sweep_time: f64,
    /// Number of messages that are made ahead of the reader, in parallel.
    pub ahead: u64,
}

/// A topic of a sensor that only one kind of simulation has: topic, type, messages a second, bytes of a message.
pub(crate) type OtherSensor<'a> = (&'a str, &'static str, f64, u64, Source);

/// A motion with sensors.
pub(crate) trait Rig: Send + Sync + Sized + 'static {
    type Motion: Motion + Rolling + 'static;

    fn request(&self) -> Request<'_>;
    fn timeline(&self) -> &Timeline<Self::Motion>;
    fn lidar_count(&self) -> usize;
    fn lidar(&self, index: usize) -> Option<RigLidar<'_>>;
    /// Message number `number` of a lidar, without faults.
    fn lidar_message(&self, index: usize, number: u64) -> Option<Message>;

    /// Sensors that only one kind of simulation has.
    fn other_sensors(&self) -> Vec<OtherSensor<'_>> {
        Vec::new()
    }

    /// Frames of those sensors, and their poses on the platform.
    fn other_frames(&self) -> Vec<(&str, Rigid3)> {
        Vec::new()
    }

    /// The messages of one of those sensors.
    fn open_other(&self, _source: Source) -> Option<Box<dyn MessageStream>> {
        None
    }

    fn schedule(&self, rate: f64) -> Schedule {
        Schedule::new(rate, self.timeline().duration, 0.0)
    }

    /// All topics, in ascending order.
    fn channels(&self) -> Vec<Channel> {
        let request = self.request();
        let mut channels = Vec::new();
        let mut add = |topic: &str, type_name: &str, count: u64, message_bytes: u64, source: Source| {
            let info = TopicInfo { topic: topic.into(), type_name: type_name.into(), count: Some(count) };
            channels.push(Channel { info, message_bytes, source });
        };
        let transforms = self.static_transforms().len() as u64;
        if transforms > 0 {
            add(STATIC_TRANSFORMS, "tf2_msgs/TFMessage", 1, 100 * transforms, Source::Transforms);
        }
        for (index, lidar) in (0..self.lidar_count()).filter_map(|i| Some((i, self.lidar(i)?))) {
            let count = self.count_outside_gaps(lidar.schedule, Source::Lidar(index));
            add(lidar.topic, lidar.type_name, count, lidar.message_bytes, Source::Lidar(index));
        }
        let count = |rate: f64, source: Source| self.count_outside_gaps(&self.schedule(rate), source);
        if let Some(imu) = request.imu {
            add(&imu.topic, "sensor_msgs/Imu", count(imu.rate, Source::Imu), 340, Source::Imu);
        }
        if let Some(wheels) = request.odometry {
            let count = count(wheels.rate, Source::Odometry);
            add(&wheels.topic, "nav_msgs/Odometry", count, 740, Source::Odometry);
        }
        for (topic, type_name, rate, bytes, source) in self.other_sensors() {
            add(topic, type_name, count(rate, source), bytes, source);
        }
        channels.sort_by(|a, b| a.info.topic.cmp(&b.info.topic));
        channels
    }

    /// The faults of a topic, if it can have any.
    fn fault_filter(&self, source: Source) -> Option<FaultFilter> {
        let request = self.request();
        let gravity = request.imu.map_or(0.0, |imu| imu.gravity);
        // The fault `dies` concerns the last lidar only.
        let lives = matches!(source, Source::Lidar(index) if index + 1 < self.lidar_count());
        let faults = request.faults.iter().filter(|f| !(lives && matches!(f, Fault::Death { .. })));
        let faults: Vec<Fault> = faults.copied().collect();
        source.target().map(|target| FaultFilter::new(&faults, target, gravity))
    }

    fn count_outside_gaps(&self, schedule: &Schedule, source: Source) -> u64 {
        let has_gaps = self
            .request()
            .faults
            .iter()
            .any(|fault| matches!(fault, Fault::Gap { .. } | Fault::Death { .. }));
        let Some(filter) = self.fault_filter(source).filter(|_| has_gaps) else { return schedule.count() };
        let is_kept = |index: &u64| !filter.is_gap(schedule.time_of(*index).seconds());
        (0..schedule.count()).filter(is_kept).count() as u64
    }

    /// The transforms from the platform to its sensors, without those that a fault removes.
    fn static_transforms(&self) -> Vec<TransformStamped> {
        let request = self.request();
        let is_missing = |target| request.faults.contains(&Fault::MissingTransform { target });
        let mut transforms = Vec::new();
        let mut add = |frame: &str, base_from_sensor: &Rigid3| {
            transforms.push(sensor_transform(self.timeline().clock.start, frame, base_from_sensor));
        };
        if !is_missing(FaultTarget::Scan) {
            for lidar in (0..self.lidar_count()).filter_map(|index| self.lidar(index)) {
                add(lidar.frame, &lidar.base_from_lidar);
            }
        }
        if let Some(imu) = request.imu.filter(|_| !is_missing(FaultTarget::Imu)) {
            add(&imu.frame, &imu.base_from_imu);
        }
        for (frame, base_from_sensor) in self.other_frames() {
            add(frame, &base_from_sensor);
        }
        transforms
    }
}

/// The messages of a source; none if the rig does not have it.
fn open<R: Rig>(rig: &Arc<R>, source: Source) -> Option<Box<dyn MessageStream>> {
    let Request { seed, imu, odometry, .. } = rig.request();
    let (motion, clock) = (Arc::clone(&rig.timeline().motion), rig.timeline().clock);
    let stream: Box<dyn MessageStream> = match source {
        Source::Transforms => Box::new(TransformStream::new(rig.static_transforms(), clock.start)),
        Source::Lidar(index) => lidar_stream(Arc::clone(rig), index)?,
        Source::Imu => {
            let schedule = rig.schedule(imu?.rate);
            Box::new(ImuStream::new(imu?.clone(), motion, clock, schedule, seed))
        }
        Source::Odometry => {
            let schedule = rig.schedule(odometry?.rate);
            Box::new(OdometryStream::new(odometry?.clone(), ROBOT_FRAME, motion, clock, schedule, seed))
        }
        other => rig.open_other(other)?,
    };
    Some(stream)
}

/// Scans or sweeps, some of them made ahead, in parallel.
fn lidar_stream<R: Rig>(rig: Arc<R>, index: usize) -> Option<Box<dyn MessageStream>> {
    let lidar = rig.lidar(index)?;
    let (topic, count, ahead) = (Arc::clone(lidar.topic), lidar.schedule.count(), lidar.ahead);
    let sweep_time = Duration::from_seconds(lidar.sweep_time);
    Some(Box::new(AheadStream::new(count, ahead, move |number| {
        let message = rig.lidar_message(index, number)?;
        // It can be recorded when its last beam has come back.
        let log_time = message.header()?.stamp + sweep_time;
        Some(RecordedMessage { topic: Arc::clone(&topic), log_time, message })
    })))
}

/// One pass over the wanted topics.
pub(crate) fn read<R: Rig>(rig: &Arc<R>, wanted: &dyn Fn(&TopicInfo) -> bool) -> Box<dyn MessageReader> {
    let channels = rig.channels().into_iter().filter(|channel| wanted(&channel.info));
    let streams = channels.filter_map(|channel| {
        let stream = open(rig, channel.source)?;
        let filter = rig.fault_filter(channel.source);
        Some(Merged::start(stream, filter, rig.timeline().clock, channel.message_bytes))
    });
    Box::new(MergedReader::new(streams.collect()))
}

/// Times at this rate from the start to the end of a recording.
pub(crate) fn moments(start: Time, duration: f64, rate: f64) -> impl Iterator<Item = Time> {
    let rate = rate.clamp(1e-3, 1e4);
    let count = (duration * rate + 1e-6).floor() as u64;
    (0..=count).map(move |i| start + Duration::from_ticks((i as f64 * 1e7 / rate).round() as i64))
}

/// Public interface that both kinds of simulations share.
macro_rules! simulation {
    ($simulation:ident, $options:ty) => {
        impl $simulation {
            /// The options.
            pub fn options(&self) -> &$options {
                &self.inner.options
            }

            /// Length of the recording, seconds.
            pub fn duration(&self) -> f64 {
                self.inner.timeline.duration
            }

            /// True time at the start.
            pub fn start_time(&self) -> portolan_geometry::Time {
                self.inner.timeline.clock.start
            }

            /// True time at the end.
            pub fn end_time(&self) -> portolan_geometry::Time {
                self.inner
                    .timeline
                    .clock
                    .moment(portolan_geometry::Duration::from_seconds(self.inner.timeline.duration))
            }

            /// Pose, velocities and accelerations at a time; none outside the recording.
            pub fn motion_at(&self, time: portolan_geometry::Time) -> Option<$crate::motion::MotionState> {
                use $crate::motion::Motion as _;
                let is_within = (self.start_time()..=self.end_time()).contains(&time);
                is_within.then(|| self.inner.timeline.motion.state(self.inner.timeline.clock.seconds(time)))
            }

            /// True poses of `base_link` in the map, `rate` per second, from the start to the end.
            pub fn truth(
                &self,
                rate: f64,
            ) -> impl Iterator<Item = (portolan_geometry::Time, portolan_geometry::Rigid3)> + '_ {
                $crate::rig::moments(self.start_time(), self.duration(), rate)
                    .filter_map(|time| self.truth_at(time).map(|pose| (time, pose)))
            }

            /// Writes the truth in TUM format: `time x y z qx qy qz qw`, one pose a line.
            ///
            /// # Errors
            /// If writing fails.
            pub fn write_truth_tum(&self, out: &mut dyn std::io::Write, rate: f64) -> std::io::Result<()> {
                $crate::truth::write_tum(out, self.truth(rate))
            }

            /// Writes all messages to a bag or MCAP file, and gives their number. The caller finishes the
            /// file.
            ///
            /// # Errors
            /// If a message cannot be written.
            pub fn write_messages(
                &self,
                writer: &mut dyn portolan_recording::RecordingWriter,
            ) -> Result<u64, portolan_recording::RecordingError> {
                let mut reader = portolan_recording::Recording::read(self, &|_| true)?;
                let mut count = 0;
                while let Some(message) = reader.next_message()? {
                    writer.write(&message)?;
                    count += 1;
                }
                Ok(count)
            }
        }

        impl portolan_recording::Recording for $simulation {
            fn format(&self) -> String {
                let options = self.options();
                format!("simulation of scene \"{}\" with seed {}", options.scene, options.seed)
            }

            fn topics(&self) -> Vec<portolan_recording::TopicInfo> {
                use $crate::rig::Rig as _;
                self.inner.channels().into_iter().map(|channel| channel.info).collect()
            }

            fn time_range(&self) -> Option<(portolan_geometry::Time, portolan_geometry::Time)> {
                Some((self.start_time(), self.end_time()))
            }

            fn size_bytes(&self) -> u64 {
                use $crate::rig::Rig as _;
                let channels = self.inner.channels();
                channels.iter().map(|c| c.info.count.unwrap_or(0) * c.message_bytes).sum()
            }

            fn read(
                &self,
                wanted: &dyn Fn(&portolan_recording::TopicInfo) -> bool,
            ) -> Result<Box<dyn portolan_recording::MessageReader>, portolan_recording::RecordingError> {
                Ok($crate::rig::read(&self.inner, wanted))
            }
        }
    };
}
pub(crate) use simulation;
