//! Compares scans of a planar scanner with the other sensors before mapping begins: whether odometry agrees
//! with the motion from scans, the offset between their stamps, how long a scan takes, and how noisy its
//! ranges are.

use std::collections::BTreeMap;
use std::sync::Arc;

use portolan_geometry::{Duration, Rigid2, Rigid3, Time, TransformBuffer, Vector3, yaw};
use portolan_ingest::{
    HeldPose, Inventory, PlannedOdometry, PlannedRange, PlannedSensor, RangeNoiseEstimator, SensorPlan,
    StampJitter, is_tf, pose_of, read_without_repeats,
};
use portolan_recording::{
    Message, Odometry, Recording, RecordingError, StampPattern, TfMessage, TopicInfo, TransformStamped,
};

use crate::beam_times::{ScanDuration, scan_duration};
use crate::clock_offset::ImuMounting;
use crate::finding::Findings;
use crate::odometry::OdometryChecks;
use crate::odometry_fault::OdometryFault;
use crate::odometry_held::OdometryHold;
use crate::rotation::{Turn, sure_offset};
use crate::scan_gyroscope::ScanGyroscope;
use crate::scan_motion::{ScanMotions, TimedMotion};
use crate::scan_turns::ScanTurns;
use crate::stamp_jitter::stamp_jitter;

/// Part of the recording that is used: its first ten minutes.
const LOOK: Duration = Duration::from_ticks(600 * 10_000_000);

/// Minimum cosine between the axis of a level scanner and the vertical.
const LEVEL: f64 = 0.9;

/// An offset between the stamps of two sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorDelay {
    /// Time by which scans are stamped too late against the other sensor, seconds.
    pub seconds: f64,
    /// Standard deviation of it, seconds.
    pub sigma: f64,
}

/// Results of comparing scans with the other sensors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScanComparison {
    /// Offset of the clock of odometry; none unless it certainly is wrong.
    pub delay: Option<SensorDelay>,
    /// Fault of the motions of odometry, if certain.
    pub fault: Option<OdometryFault>,
    /// How odometry holds motions back, if certain.
    pub hold: Option<OdometryHold>,
    /// Rotations of odometry without the repeated poses.
    pub(crate) turns_without_repeats: Option<Vec<Turn>>,
    /// Offset of the clock of the IMU; none unless it certainly is wrong.
    pub imu_delay: Option<SensorDelay>,
    /// How the IMU rotates, where it certainly disagrees with scans.
    pub imu_fault: Option<ImuMounting>,
    /// Topics of scanners with the measured duration of their scans, where it certainly differs from the
    /// reported one.
    pub durations: Vec<(Arc<str>, ScanDuration)>,
    /// Topics of scanners with the standard deviation of their ranges, metres.
    pub noises: Vec<(Arc<str>, f64)>,
    /// Topics whose stamps jitter, and their jitter: those of a scanner, and of odometry with the same
    /// stamps.
    pub jitters: Vec<(Vec<Arc<str>>, StampJitter)>,
}

/// Minimum fraction of the stamps of odometry that are also those of a scanner, if both come in one message.
const SHARED_STAMPS: f64 = 0.9;

/// Compares the scans of each scanner of the plan with each other, and those of the first with odometry and
/// IMU, in the first ten minutes. Sensors that are not in the plan have no results.
///
/// # Errors
/// The recording cannot be read.
pub fn compare_scans(
    recording: &dyn Recording,
    inventory: &Inventory,
    plan: &SensorPlan,
) -> Result<ScanComparison, RecordingError> {
    let Compared { mut wheels, gyroscope, mut scanners } = read_compared(recording, plan)?;
    let noises = scanners.iter().filter_map(Scanner::range_noise).collect();
    // With disturbed stamps, the only result about motion is whether odometry has none.
    let mut jitters = Vec::new();
    for scanner in scanners.iter_mut().filter(|scanner| !scanner.has_disturbed_stamps()) {
        let Some(jitter) = scanner.remove_jitter() else { continue };
        let mut topics = vec![scanner.planned.source.topic.clone()];
        let in_messages = plan.odometry.as_ref().and_then(PlannedOdometry::topic);
        topics.extend(in_messages.filter(|_| wheels.have_stamps_of(scanner)).cloned());
        if topics.len() > 1 {
            wheels.retime(&scanner.times);
        }
        jitters.push((topics, jitter));
    }
    let orderly = scanners.iter().filter(|scanner| !scanner.has_disturbed_stamps());
    let durations: Vec<_> = orderly.filter_map(Scanner::wrong_duration).collect();
    let mut all = ScanComparison::default();
    if let Some(scanner) = scanners.into_iter().next() {
        let found = durations.iter().find(|(topic, _)| *topic == scanner.planned.source.topic);
        let seconds = found.map(|(_, found)| found.seconds).or(scanner.planned.scan_duration);
        let seconds = seconds.unwrap_or(scanner.reported_duration);
        if let Some(gyroscope) = gyroscope.filter(|_| !scanner.has_disturbed_stamps()) {
            let turns = scanner.turns_in_the_middle(seconds);
            let (fault, delay) = gyroscope.compare(inventory, (&scanner.planned.source, &turns));
            (all.imu_fault, all.imu_delay) = (fault, delay);
        }
        if let Some(odometry) = plan.odometry.as_ref().map(|odometry| &odometry.source) {
            all = wheels.compare(inventory, odometry, (scanner, seconds), all);
        }
    }
    Ok(ScanComparison { durations, noises, jitters, ..all })
}

/// Sensors that are compared, with their measurements.
struct Compared<'a> {
    wheels: Wheels<'a>,
    gyroscope: Option<ScanGyroscope<'a>>,
    scanners: Vec<Scanner<'a>>,
}

/// Reads the measurements of the sensors of a plan at the beginning of a recording.
fn read_compared<'a>(
    recording: &dyn Recording,
    plan: &'a SensorPlan,
) -> Result<Compared<'a>, RecordingError> {
    let mut wheels = Wheels { planned: plan.odometry.as_ref(), ..Wheels::default() };
    let mut gyroscope = plan.imu.as_ref().map(ScanGyroscope::new);
    let mut scanners: Vec<Scanner> = plan.range.iter().map(Scanner::new).collect();
    let is_wanted = |topic: &TopicInfo| {
        plan.odometry.as_ref().is_some_and(|odometry| match odometry.topic() {
            Some(of_odometry) => *of_odometry == topic.topic,
            None => is_tf(&topic.type_name),
        }) || plan.imu.as_ref().is_some_and(|imu| imu.source.topic == topic.topic)
            || plan.range.iter().any(|range| range.source.topic == topic.topic)
    };
    let mut reader = read_without_repeats(recording, &is_wanted)?;
    let mut first = None;
    while let Some(message) = reader.next_message()? {
        if message.log_time - *first.get_or_insert(message.log_time) > LOOK {
            break;
        }
        wheels.add(&message.topic, &message.message);
        if let Some(gyroscope) = gyroscope.as_mut().filter(|g| g.planned.source.topic == message.topic) {
            gyroscope.add(&message.message);
        }
        for scanner in scanners.iter_mut().filter(|s| s.planned.source.topic == message.topic) {
            scanner.add(&message.message);
        }
    }
    Ok(Compared { wheels, gyroscope, scanners })
}

/// Measurements of a scanner.
struct Scanner<'a> {
    planned: &'a PlannedRange,
    turns: ScanTurns,
    motions: ScanMotions,
    noise: RangeNoiseEstimator,
    stamps: Vec<Time>,
    /// Times of measurement of scans by their stamps, where stamps jitter.
    times: BTreeMap<Time, Time>,
    /// Time from the first beam to the last as reported by the last scan, seconds.
    reported_duration: f64,
}

impl<'a> Scanner<'a> {
    fn new(planned: &'a PlannedRange) -> Self {
        let (turns, motions) = (ScanTurns::default(), ScanMotions::default());
        let noise = RangeNoiseEstimator::default();
        let (stamps, times) = (Vec::new(), BTreeMap::new());
        Self { planned, turns, motions, noise, stamps, times, reported_duration: 0.0 }
    }

    fn add(&mut self, message: &Message) {
        let Message::LaserScan(scan) = message else { return };
        self.stamps.push(scan.header.stamp);
        self.turns.add(scan.header.stamp, scan);
        self.motions.add(scan.header.stamp, scan);
        self.noise.add(scan);
        let reported = f64::from(scan.time_increment) * scan.ranges.len().saturating_sub(1) as f64;
        self.reported_duration = if reported.is_finite() && reported > 0.0 { reported } else { 0.0 };
    }

    /// Returns the jitter of stamps, if there is any; results are then relative to the times of measurement.
    fn remove_jitter(&mut self) -> Option<StampJitter> {
        let (jitter, times) = stamp_jitter(&self.stamps, &self.motions)?;
        self.times = self.stamps.iter().copied().zip(times.iter().copied()).collect();
        for (scan, time) in self.motions.scans.iter_mut().zip(&times) {
            scan.time = *time;
        }
        retime(&mut self.turns.turns, &self.times);
        Some(jitter)
    }

    /// Rotations between the times at which scans were measured, for scans of this duration, seconds: on
    /// average, a scan is measured in its middle. Scans begin at their stamps, whichever beam comes first.
    fn turns_in_the_middle(&self, seconds: f64) -> Vec<Turn> {
        let middle = Duration::from_seconds(0.5 * seconds.abs());
        self.turns.turns.iter().map(|(from, to, turn)| (*from + middle, *to + middle, *turn)).collect()
    }

    fn has_disturbed_stamps(&self) -> bool {
        StampPattern::of(&self.stamps).is_some_and(|pattern| pattern.is_disturbed())
    }

    fn range_noise(&self) -> Option<(Arc<str>, f64)> {
        Some((self.planned.source.topic.clone(), self.noise.sigma()?))
    }

    /// Duration of a scan, where the user has not given it and it certainly differs from the reported one.
    fn wrong_duration(&self) -> Option<(Arc<str>, ScanDuration)> {
        if self.planned.scan_duration.is_some() {
            return None;
        }
        let found = scan_duration(&self.motions, self.reported_duration)?;
        let interval = 1.0 / self.planned.statistics.rate;
        let is_wrong = found.is_other_than(self.reported_duration, interval);
        is_wrong.then(|| (self.planned.source.topic.clone(), found))
    }
}

/// Measurements of odometry.
#[derive(Default)]
struct Wheels<'a> {
    planned: Option<&'a PlannedOdometry>,
    checks: OdometryChecks,
    poses: Vec<(Time, Rigid3)>,
}

impl Wheels<'_> {
    fn add(&mut self, topic: &str, message: &Message) {
        match message {
            Message::Odometry(odometry) => self.add_odometry(topic, odometry),
            Message::Tf(transforms) => self.add_transforms(topic, transforms),
            _ => {}
        }
    }

    fn add_transforms(&mut self, topic: &str, transforms: &TfMessage) {
        let Some(PlannedOdometry { source, transforms_from: Some(parent) }) = self.planned else { return };
        let is_odometry = |transform: &&TransformStamped| {
            transform.header.frame_id == *parent && transform.child_frame_id == source.frame
        };
        for transform in transforms.transforms.iter().filter(is_odometry) {
            let odometry = Odometry {
                header: transform.header.clone(),
                child_frame_id: transform.child_frame_id.clone(),
                pose: transform.transform,
                pose_covariance: Vec::new(),
                linear_velocity: [0.0; 3],
                angular_velocity: [0.0; 3],
                twist_covariance: Vec::new(),
            };
            self.add_odometry(topic, &odometry);
        }
    }

    fn add_odometry(&mut self, topic: &str, odometry: &Odometry) {
        self.checks.add(topic, odometry, &mut Findings::default());
        let stamp = odometry.header.stamp;
        // Poses that go back in time are left out: they would have to be sorted in.
        if self.poses.last().is_none_or(|(latest, _)| *latest < stamp)
            && let Some((pose, _)) = pose_of(&odometry.pose)
        {
            self.poses.push((stamp, pose));
        }
    }

    /// Whether poses come in the messages of a scanner.
    fn have_stamps_of(&self, scanner: &Scanner) -> bool {
        let shared = self.poses.iter().filter(|(stamp, _)| scanner.times.contains_key(stamp)).count();
        shared as f64 > SHARED_STAMPS * self.poses.len() as f64
    }

    /// Replaces the stamps of poses and rotations by these times of measurement.
    fn retime(&mut self, times: &BTreeMap<Time, Time>) {
        retime(&mut self.checks.turns, times);
        self.poses.iter_mut().for_each(|(time, _)| *time = times.get(time).copied().unwrap_or(*time));
    }

    /// Leaves out poses that repeat because motions are held back.
    fn leave_out_repeats(&mut self, hold: OdometryHold) {
        let mut repeats = HeldPose::new(hold.longest);
        self.poses.retain(|(time, pose)| !repeats.is_repeat(*time, pose));
        let turns = self.poses.windows(2).filter_map(|two| match two {
            [(from, first), (to, second)] => Some((*from, *to, yaw(&(first.inverse() * second).rotation))),
            _ => None,
        });
        self.checks.turns = turns.collect();
    }

    /// Compares clock and motions with those of scans of this duration, seconds; adds the results to the
    /// known ones.
    fn compare(
        &mut self,
        inventory: &Inventory,
        odometry: &PlannedSensor,
        (scanner, seconds): (Scanner, f64),
        known: ScanComparison,
    ) -> ScanComparison {
        let is_disturbed = scanner.has_disturbed_stamps();
        let source = &scanner.planned.source;
        let odometry_from_scanner = inventory.tree.lookup_static(&odometry.frame, &source.frame);
        let odometry_from_scanner = odometry_from_scanner.unwrap_or_else(Rigid3::identity);
        let up = (odometry_from_scanner.rotation * Vector3::z()).z;
        let mut turns = scanner.turns_in_the_middle(seconds);
        let mut motions: Vec<TimedMotion> = scanner.motions.motions().collect();
        if up < 0.0 {
            flip_upside_down(&mut turns, &mut motions);
        }
        let hold = OdometryHold::find(&self.poses, &motions, &odometry_from_scanner);
        if let Some(hold) = hold {
            self.leave_out_repeats(hold);
        }
        let offset = sure_offset(&self.checks.turns, &turns, false);
        let shift = (source.clock_shift - odometry.clock_shift).seconds();
        let delay = offset.map(|(lag, sigma)| SensorDelay { seconds: lag + shift, sigma });
        let lag = offset.map_or(0.0, |(lag, _)| lag);
        let mut poses = TransformBuffer::default();
        self.poses.iter().for_each(|(time, pose)| poses.push(*time, *pose));
        // A leaning scanner does not measure motion in the plane.
        let is_level = up.abs() > LEVEL;
        let find = || {
            OdometryFault::find(
                (&self.checks.turns, &turns),
                (&poses, &motions),
                (&odometry_from_scanner, lag),
            )
        };
        let fault = is_level.then(find).flatten();
        if is_disturbed {
            let fault = fault.filter(|fault| *fault == OdometryFault::Stands);
            return ScanComparison { fault, ..known };
        }
        let turns_without_repeats = hold.map(|_| std::mem::take(&mut self.checks.turns));
        ScanComparison { delay, fault, hold, turns_without_repeats, ..known }
    }
}

/// Replaces the stamps of rotations by times of measurement.
fn retime(turns: &mut [Turn], times: &BTreeMap<Time, Time>) {
    let time = |stamp: &Time| times.get(stamp).copied().unwrap_or(*stamp);
    for (from, to, _) in turns {
        (*from, *to) = (time(from), time(to));
    }
}

/// Converts measurements of a scanner that is mounted upside down to the view from above.
fn flip_upside_down(turns: &mut [Turn], motions: &mut [TimedMotion]) {
    turns.iter_mut().for_each(|(_, _, turn)| *turn = -*turn);
    for (_, _, motion) in motions {
        *motion = Rigid2::new(motion.translation.x, -motion.translation.y, -motion.angle);
    }
}
