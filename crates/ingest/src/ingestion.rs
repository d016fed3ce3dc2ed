//! Reads a recording as measurements in the tracking frame.

mod messages;
mod setup;

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::{Duration, GeodeticPosition, Quaternion, Rigid3, Time};
use portolan_issue::{Issue, IssueKind, IssueLog, Severity};
use portolan_recording::{Message, RecordedMessage, Recording, RecordingError, TopicInfo};
use portolan_sensor::{FixedRatioSampler, Measurement, SensorId};

use crate::azimuth_time::{AzimuthTimes, Turn};
use crate::beam_elevation::Raise;
use crate::beam_smoothing::BeamSmoothing;
use crate::clock::{Ascending, Order, SensorClock};
use crate::convert::{Frames, LocalFixes, SatelliteFix};
use crate::even_stamps::{EvenStamps, StampPolicy, disturbed_beginnings};
use crate::held_pose::HeldPose;
use crate::laser::BeamDirections;
use crate::options::IngestOptions;
use crate::plan::{ImuScale, PlanError, PlannedSensor, SensorPlan, SensorStatistics, plan};
use crate::point_time::PointTime;
use crate::read_ahead::ReadAhead;
use crate::recording_clock::RecordingClock;
use crate::repeats::read_without_repeats;
use crate::stuck_sample::StuckSample;
use crate::survey::{Inventory, is_tf};
use crate::sweep_stamps::SweepStamps;
use crate::tf::{TfError, TfInput};
use crate::turn_clock::TurnClock;

/// Reasons why a recording cannot be turned into measurements.
#[derive(Debug, thiserror::Error)]
pub enum IngestError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// No plan could be made.
    #[error(transparent)]
    Plan(#[from] PlanError),
}

/// Use of a topic.
#[derive(Clone, Debug)]
enum Role {
    Range {
        point_time: Option<PointTime>,
        by_azimuth: Option<TimesByAzimuth>,
        /// Set where points have times of their own that count from the stamp.
        sweep_stamps: Option<SweepStamps>,
        coordinates: Coordinates,
        /// Seconds from the first beam of a laser scan to the last, where the messages are wrong about it.
        scan_duration: Option<f64>,
        /// Set where readings are noisy.
        smoothing: Option<BeamSmoothing>,
        directions: Box<BeamDirections>,
    },
    Imu {
        scale: ImuScale,
        /// Rotates its measurements in the tracking frame.
        correction: Quaternion,
        stuck: StuckSample,
    },
    Odometry {
        /// Set where odometry repeats poses although the robot moves.
        held: Option<HeldPose>,
    },
    NavSat,
    FixedFramePose,
    Landmarks,
}

/// Conversion of the coordinates of clouds in the frame of their sensor.
#[derive(Clone, Copy, Debug)]
struct Coordinates {
    /// Metres in one of their units.
    length_unit: f32,
    /// Raises or lowers the beams, if their elevations are wrong.
    raise: Option<Raise>,
}

/// How points get times from their azimuth.
#[derive(Clone, Debug)]
struct TimesByAzimuth {
    meaning: AzimuthTimes,
    clock: TurnClock,
    /// Whether stamps are used unchanged.
    keeps_stamps: bool,
    turn: Option<Turn>,
}

/// State of a sensor while the recording is read.
struct Sensor {
    id: SensorId,
    topic: Arc<str>,
    role: Role,
    clock: SensorClock,
    even_stamps: EvenStamps,
    order: Ascending,
}

/// Odometry that comes as transforms.
struct TransformOdometry {
    planned: PlannedSensor,
    parent: Arc<str>,
    held: Option<HeldPose>,
    order: Ascending,
}

/// Samplers of the five kinds of sensors, as Cartographer has them.
struct Samplers {
    range: FixedRatioSampler,
    odometry: FixedRatioSampler,
    fixed_frame_pose: FixedRatioSampler,
    imu: FixedRatioSampler,
    landmarks: FixedRatioSampler,
}

/// Measurements of a recording, in the order of the recording.
///
/// Memory stays independent of the length of the recording: messages wait for their transforms for 1 s
/// at most.
pub struct Ingestion {
    plan: SensorPlan,
    source: ReadAhead,
    sensors: BTreeMap<Arc<str>, Vec<Sensor>>,
    transform_odometry: Option<TransformOdometry>,
    samplers: Samplers,
    fixes: LocalFixes,
    subdivisions: usize,
    with_intensities: bool,
    ignore_out_of_order: bool,
    start: Time,
    end: Time,
    /// Measurements that are ready, in reverse order.
    ready: Vec<(SensorId, Measurement)>,
    log_time: Option<Time>,
    recording_clock: RecordingClock,
    /// Stamp that a message came with minus the one that is used.
    stamp_correction: Duration,
    recorded_times: BTreeMap<Time, Time>,
    ended: bool,
    issues: IssueLog,
    size_bytes: u64,
}

impl Ingestion {
    /// Looks at the recording, makes a plan and starts to read.
    ///
    /// # Errors
    /// If the recording cannot be read, or no plan can be made.
    pub fn new(recording: &dyn Recording, options: &IngestOptions) -> Result<Self, IngestError> {
        let inventory = Inventory::of(recording, options)?;
        let plan = plan(&inventory, options)?;
        Self::with_plan(recording, &inventory, plan, options)
    }

    /// Starts to read as planned.
    ///
    /// # Errors
    /// If the recording cannot be read, or a sampling ratio is not within 0 to 1.
    pub fn with_plan(
        recording: &dyn Recording,
        inventory: &Inventory,
        plan: SensorPlan,
        options: &IngestOptions,
    ) -> Result<Self, IngestError> {
        let samplers = Samplers::new(&options.sampling)?;
        let start = inventory.first_time.map_or(Time::MIN, |first| first + options.skip);
        let disturbed = match options.stamps {
            StampPolicy::AsIs => BTreeMap::new(),
            _ => disturbed_beginnings(recording, &setup::topics_of_scans(inventory, &plan), start)?,
        };
        let sensors = setup::sensors(&plan, options.stamps, &disturbed);
        let transform_odometry = plan.odometry.as_ref().and_then(|odometry| {
            Some(TransformOdometry {
                planned: odometry.source.clone(),
                parent: odometry.transforms_from.clone()?,
                held: plan.longest_odometry_hold.map(HeldPose::new),
                order: Ascending::default(),
            })
        });
        let needs_tf = options.use_recorded_transforms
            && (transform_odometry.is_some() || setup::moves(inventory, &plan));
        let wanted = |t: &TopicInfo| sensors.contains_key(&t.topic) || (needs_tf && is_tf(&t.type_name));
        let reader = read_without_repeats(recording, &wanted)?;
        let tf = TfInput::new(&options.map_frame);
        let mut issues = IssueLog::default();
        issues.merge(&inventory.issues);
        if !needs_tf {
            // Otherwise they are read again and counted later.
            issues.merge(&inventory.moving_issues);
        }
        for range in plan.range.iter().filter(|range| range.times_are_uncertain) {
            issues.add(Issue::new(IssueKind::PointTimesInDoubt).of(Arc::clone(&range.source.topic)));
        }
        Ok(Self {
            plan,
            source: ReadAhead::new(reader, inventory.tree.clone(), tf, needs_tf),
            sensors,
            transform_odometry,
            samplers,
            fixes: LocalFixes::default(),
            subdivisions: options.num_subdivisions_per_laser_scan.max(1),
            with_intensities: options.with_intensities,
            ignore_out_of_order: options.ignore_out_of_order,
            start: if options.skip > Duration::ZERO { start } else { Time::MIN },
            end: options.length.map_or(Time::MAX, |length| start + length),
            ready: Vec::new(),
            log_time: None,
            recording_clock: RecordingClock::default(),
            stamp_correction: Duration::ZERO,
            recorded_times: BTreeMap::new(),
            ended: false,
            issues,
            size_bytes: recording.size_bytes(),
        })
    }

    /// The plan in use.
    pub fn plan(&self) -> &SensorPlan {
        &self.plan
    }

    /// Properties of the sensors that the defaults of mapping depend on.
    pub fn statistics(&self) -> SensorStatistics {
        self.plan.statistics()
    }

    /// All sensors in ascending order, as the collator expects them.
    pub fn sensors(&self) -> Vec<SensorId> {
        self.plan.sensors()
    }

    /// The next measurement, `None` at the end. An error ends the reading.
    ///
    /// # Errors
    /// If the recording cannot be read.
    pub fn next_measurement(&mut self) -> Result<Option<(SensorId, Measurement)>, RecordingError> {
        loop {
            if let Some(measurement) = self.ready.pop() {
                return Ok(Some(measurement));
            }
            match self.source.next()?.filter(|message| message.log_time <= self.end) {
                Some(message) => {
                    self.log_time = Some(message.log_time);
                    if message.log_time >= self.start {
                        self.take(message);
                    }
                }
                None if self.ended => return Ok(None),
                None => {
                    self.ended = true;
                    self.take_waiting(Time::MAX);
                }
            }
            self.ready.reverse();
        }
    }

    /// Range data whose stamps were changed: their times as used, and as recorded.
    pub fn recorded_times(&self) -> &BTreeMap<Time, Time> {
        &self.recorded_times
    }

    /// Time of recording of the message the last measurement came from.
    pub fn log_time(&self) -> Option<Time> {
        self.log_time
    }

    /// Bytes of the recording consumed, and all of them.
    pub fn progress(&self) -> (u64, u64) {
        (self.source.position_bytes(), self.size_bytes)
    }

    /// Everything that was repaired or left out so far, those of the format included.
    pub fn issues(&self) -> Vec<Issue> {
        let mut issues = self.issues.clone();
        issues.merge(&self.source.issues());
        issues.append(self.source.tf.issues());
        issues.list()
    }

    /// The newest satellite fix, if it has this time: the fix of the measurement that was just returned.
    pub fn satellite_fix(&self, time: Time) -> Option<SatelliteFix> {
        self.fixes.newest().filter(|fix| fix.time == time)
    }

    /// Origin of the frame of satellite fixes: the first fix.
    pub fn nav_sat_origin(&self) -> Option<GeodeticPosition> {
        self.fixes.origin()
    }

    fn take(&mut self, message: RecordedMessage) {
        if let Message::Tf(transforms) = &message.message {
            self.take_transforms(transforms);
            return;
        }
        if let Some(jump) = self.recording_clock.take(message.log_time) {
            self.issues.add(jump);
        }
        self.take_waiting(message.log_time);
        // Removed from the map meanwhile, because they write to the rest of the ingestion.
        let Some(mut sensors) = self.sensors.remove(&message.topic) else { return };
        for sensor in &mut sensors {
            self.take_message(sensor, &message);
        }
        self.sensors.insert(message.topic, sensors);
    }

    /// Processes messages that have waited too long for later stamps, given the current time of recording.
    fn take_waiting(&mut self, now: Time) {
        if !self.sensors.values().flatten().any(|sensor| sensor.even_stamps.has_waited_long(now)) {
            return;
        }
        let mut all = std::mem::take(&mut self.sensors);
        for sensor in all.values_mut().flatten() {
            self.take_evened(sensor, now);
        }
        self.sensors = all;
    }

    /// Returns `tracking_from_frame`; if it is unknown, counts the message as lost.
    fn tracking_from(&mut self, topic: &Arc<str>, frame: &str, time: Time) -> Option<Rigid3> {
        let frames = Frames { tree: &self.source.tree, tracking: &self.plan.tracking_frame };
        let issue = match frames.tracking_from(frame, time) {
            Ok(pose) => return Some(pose),
            Err(TfError::NotAtThisTime { child, parent, .. }) => {
                Issue::new(IssueKind::UnknownPoseAtTime).with("child", child).with("parent", parent)
            }
            Err(error) => Issue::new(IssueKind::UnknownFrame).with("error", error),
        };
        self.issues.add(issue.of(Arc::clone(topic)).at(time));
        None
    }

    fn is_later(&mut self, order: &mut Ascending, topic: &Arc<str>, time: Time) -> bool {
        let kind = match order.check(time) {
            Order::Later => return true,
            Order::Same => IssueKind::RepeatedStamp,
            Order::Backward => IssueKind::StampBackward,
        };
        let severity = if self.ignore_out_of_order { Severity::Info } else { kind.severity() };
        self.issues.add(Issue::new(kind).of(Arc::clone(topic)).at(time).with_severity(severity));
        false
    }

    fn count(&mut self, topic: &Arc<str>, time: Time, kind: IssueKind, count: u64) {
        self.issues.add(Issue::new(kind).of(Arc::clone(topic)).at(time).times(count));
    }
}

impl Iterator for Ingestion {
    type Item = Result<(SensorId, Measurement), RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_measurement().transpose()
    }
}

#[cfg(test)]
mod tests;
